"""An export to ASAM OSI: an MCAP trace of `osi3.GroundTruth`, a message for each frame, and the map.

The file follows the multi-trace format of OSI 3.7: topics `ground_truth` and `ground_truth_map`, the version of OSI and of
protobuf in the metadata `net.asam.osi.trace` and in those of the channels. Message times begin at 0.
"""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.editing.convert import check_destination
from carla_recap.files.osi.ground_truth import GroundTruths
from carla_recap.files.osi.message_types import GROUND_TRUTH, MAP, VERSION, message_class
from carla_recap.formats.mcap.container import MessageFile, message_topic
from carla_recap.formats.mcap.schema import EXPORT_METADATA
from carla_recap.replay import Played, Player
from carla_recap.roads.files import read_text
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.model.frame import Header
    from carla_recap.recording import Recording
    from carla_recap.replay import Follow
    from carla_recap.replay.player import Progress

__all__ = ["export_osi"]

_LEVEL: Final = 3
_METADATA: Final = "net.asam.osi.trace"
_OSI: Final = ".".join(map(str, VERSION))
_TRUTHS, _MAP = "ground_truth", "ground_truth_map"


def export_osi(
    source: Recording,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    opendrive: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write a recording as an OSI trace.

    Args:
        source: The recording.
        destination: The file; it appears when it is complete.
        follow: The host vehicle: an id or "hero"; None: the hero, if there is one.
        start: The beginning, in elapsed seconds; negative: in seconds before the end.
        duration: The number of seconds to export; 0: all of the rest.
        opendrive: The map of the town, an OpenDRIVE file, which the trace then contains.
        force: Overwrite the file if it exists.
        progress: Is given the stream of scenes and their player, and passes the scenes on.

    Returns:
        The number of messages, and the seconds that they span.

    Raises:
        MissingExtra: The extra `osi` is not installed.
        RecapError: The recording has no such time or no such actor, or a file cannot be read or written.
    """
    reader = source.reader
    check_destination(reader.location, destination, force=force)
    content = None if opendrive is None else read_text(Path(opendrive))
    heroes = [actor.id for actor in source.heroes]
    player = Player(source, start=start, duration=duration, follow=follow)
    host = player.followed if follow is not None else next(iter(heroes), None)
    name = readable(reader.header.map_name)
    truths = GroundTruths(host, name if content is not None else "")
    of_channel = {f"{_METADATA}.channel.osi_version": _OSI, f"{_METADATA}.channel.protobuf_version": version("protobuf")}
    messages = {_TRUTHS: GROUND_TRUTH} | ({} if content is None else {_MAP: MAP})
    topics = [message_topic(topic, message_class(message), of_channel) for topic, message in messages.items()]
    times: list[int] = []
    with MessageFile(destination, topics, _about(reader.header, reader.path.name), level=_LEVEL, force=force) as file:
        if content is not None:
            file.write(_MAP, 0, message_class(MAP)(map_reference=name, open_drive_xml_content=content).SerializeToString())
        for batch in player.batches(progress):
            for time, message in truths.messages(batch):
                if not times or time > times[-1]:
                    file.write(_TRUTHS, time, message.SerializeToString())
                    times.append(time)
    return Played(len(times), (times[-1] - times[0]) / 1e9 if times else 0.0)


def _about(header: Header, name: str) -> dict[str, dict[str, str]]:
    """Return the metadata of a trace by their names."""
    protobuf = version("protobuf")
    trace = {
        "version": "1.0.0",
        "min_osi_version": _OSI,
        "max_osi_version": _OSI,
        "min_protobuf_version": protobuf,
        "max_protobuf_version": protobuf,
        "zero_time": _iso(header.date),
        "creation_time": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "description": f"{name}, a recording of CARLA in {readable(header.map_name)}",
        "data_sources": f"carla-recap {version('carla-recap')}",
    }
    return {_METADATA: trace, EXPORT_METADATA: {"viewer": "osi"}}


def _iso(seconds: int) -> str:
    """Return a time as ISO 8601; that of 1970 for one that is out of range."""
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (OverflowError, OSError, ValueError):
        return "1970-01-01T00:00:00Z"
