"""An export to Foxglove: an MCAP file with the schemas that its panels show, and layouts for them.

| Topic            | Schema                    | What                                                                    |
|------------------|---------------------------|-------------------------------------------------------------------------|
| `/map`           | foxglove.SceneUpdate      | the surfaces of the town, once; empty without a map                     |
| `/scene/...`     | foxglove.SceneUpdate      | whenever they change: vehicles, walkers, others; lamps and signals that |
|                  |                           | are lit; the light ahead of the followed actor; marks of collisions     |
| `/tf`            | foxglove.FrameTransforms  | from `world` to `followed`, a calm and level frame, and to `hero`       |
| `/tf/actors`     | foxglove.FrameTransforms  | the frames of actors that have moved so far, in each scene              |
| `/tf/still`      | foxglove.FrameTransforms  | the frames of all others, whenever one comes, goes or moves             |
| `/hero`          | carla_recap.v1.Followed   | pose, speed and controls of the followed actor, in each frame           |
| `/lights`        | carla_recap.v1.ShownLights| the traffic light ahead of it, and all traffic lights                   |
| `/log`           | foxglove.Log              | events and incidents, as text                                           |
| `/states`        | carla_recap.v1.ShownStates| to whom incidents of each kind happen, and what breaks a rule           |

Every message is complete: a viewer that seeks reads only the latest message of each topic. Positions are in m, axes
right-handed: x forward, y left, z up.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Final

from carla_recap.editing.convert import check_destination
from carla_recap.formats.mcap.container import MessageFile
from carla_recap.formats.mcap.schema import EXPORT_METADATA, LogClock
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay import Played, Player
from carla_recap.show.foxglove.layouts import connection_hints, has_panels, layout_files, layout_hints, write_layouts
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from carla_recap.formats.base import Reader
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.recording import Recording
    from carla_recap.replay import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap

__all__ = ["connection_hints", "export_foxglove", "layout_files", "layout_hints"]

_COMPRESSION_LEVEL: Final = 1  # the files are as small as those of level 3
_FURTHER: Final = "further"  # the group of messages such as those of sensors


def export_foxglove(
    source: Recording,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    road_map: RoadMap | None = None,
    incidents: IncidentOptions | None = None,
    verdicts: Sequence[Verdict] = (),
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write a recording as an MCAP file for Foxglove and Lichtblick, whose layouts follow an actor; see `export`.

    Of a recording with images or points of sensors, or with verdicts, layouts that show them are written beside it. Return
    the number of scenes, and the seconds that they span.
    """
    from carla_recap.show.foxglove.topics import TOPICS, RecordingMessages, passed_topics

    reader = source.reader
    check_destination(reader.location, destination, force=force)
    player = Player(source, start=start, duration=duration, follow=follow)
    messages = RecordingMessages(source, player, road_map, incidents, verdicts=verdicts)
    further, clock = passed_topics(reader), LogClock(reader.header)
    names = [topic.name for topic in further]
    start, stop = player.start, player.stop + 2 * SAME_TIME
    earlier = [each for each in reader.latest_messages(names, start) if each.elapsed < start - SAME_TIME] if names else []
    passed = chain((each._replace(elapsed=start) for each in earlier), reader.further_messages(names, start, stop))
    about = {EXPORT_METADATA: _description(reader, player)}
    with MessageFile(destination, [*TOPICS, *further], about, level=_COMPRESSION_LEVEL, force=force) as file:
        for part in messages.scenes(progress):
            for time, topic, data, _ in part.in_order():
                file.write(topic, time, data)
        for topic, elapsed, data in passed:
            file.write(topic, clock.at(elapsed) or 0, data, group=_FURTHER)
        file.end_chunk()
        for time, topic, data, _ in messages.incidents().in_order():
            file.write(topic, time, data)
    if verdicts or has_panels(further):
        write_layouts(destination, further, [verdict.rule for verdict in verdicts])
    return messages.played


def _description(reader: Reader, player: Player) -> dict[str, str]:
    header = reader.header
    return {
        "source": reader.path.name,
        "map": readable(header.map_name),
        "date": str(header.date),
        "start": repr(player.start),
        "stop": repr(player.stop),
        "followed": "" if player.followed is None else str(player.followed),
    }
