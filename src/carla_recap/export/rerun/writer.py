"""A recording into a Rerun stream, and into an .rrd."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.export.rerun import roads
from carla_recap.export.rerun.actors import MOVERS
from carla_recap.export.rerun.blueprint import View, blueprint, first_places
from carla_recap.export.rerun.rrd import piped, rbl
from carla_recap.export.rerun.stage import Stage, introduce
from carla_recap.queries.actors import actors
from carla_recap.recording import Recording
from carla_recap.replay import Played, Player
from carla_recap.util.files import WholeFile, check_folder, new_folder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    import rerun as rr

    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.replay import Scene
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress

MOST_CAMERAS: Final = 500
"""So many actors get a camera."""


def write(
    stream: rr.RecordingStream,
    player: Player,
    *,
    road_map: RoadMap | None = None,
    progress: Progress | None = None,
    cameras: Collection[int] = (),
) -> Played:
    """Play a recording into a stream, which has to be flushed afterwards.

    Args:
        stream: A file, a viewer or a pipe.
        player: Plays it.
        road_map: The map of the town.
        progress: Is given the stream of scenes and their player, and passes the scenes on.
        cameras: Ids of others than the followed actor who get the axes of a camera, too.

    Warns:
        RecapWarning: The map is that of another town, or there are too many actors to show all of them.

    Raises:
        FormatError: The file contradicts its format.
    """
    reader = player.reader
    introduce(stream, reader.header, reader.path.name, str(reader.path))
    if road_map is not None and roads.lies_elsewhere(road_map, first_places(player)):
        warnings.warn(f"{road_map.name}: no actor is near this map, which is left out", RecapWarning, stacklevel=2)
        road_map = None
    stage = Stage(stream, followed=player.followed, road_map=road_map, cameras=cameras)
    scenes: Iterable[Scene] = player.scenes()
    count = 0
    for scene in progress(scenes, player) if progress else scenes:
        stage.enter(scene)
        count += 1
    stage.close()
    return Played(count, player.stop - player.start)


def export_rerun(
    source: Recording | Reader,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    view: View = "chase",
    road_map: RoadMap | None = None,
    cameras: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write an .rrd, which Rerun's viewer opens with a camera behind the followed actor.

    Args:
        source: The recording.
        destination: The .rrd; it appears when it is complete.
        follow: Whom the camera follows: an id or "hero"; None: see `choose_followed`.
        start: Where to begin, in elapsed seconds; negative: so long before the end.
        duration: How many seconds; 0: all of the rest.
        view: Which camera is shown first.
        road_map: The map of the town.
        cameras: A folder for a blueprint of each vehicle and walker, `follow_<id>.rbl`: opened together with the .rrd, it
            makes the camera follow that actor.
        force: Overwrite what is there.
        progress: See `write`.

    Raises:
        RecapError: There is no such actor or time, or the destination cannot be written.
        FormatError: The file contradicts its format.
    """
    reader = source.reader if isinstance(source, Recording) else source
    check_destination(reader.path, destination, force=force)
    if cameras is not None:
        check_folder(cameras, force=force)
        if Path(cameras).absolute() == Path(destination).absolute():
            raise RecapError(f"{cameras}: is the destination itself; a folder was expected")
    player = Player(reader, start=start, duration=duration, follow=follow)
    filmed = [] if cameras is None else _filmed(player)
    with (
        nullcontext(Path()) if cameras is None else new_folder(cameras) as room,
        WholeFile(destination) as file,
    ):
        with piped(blueprint(player, view=view), file.write) as stream:
            played = write(stream, player, road_map=road_map, progress=progress, cameras=filmed)
        for id in filmed:
            (room / f"follow_{id}.rbl").write_bytes(rbl(blueprint(player, view=view, followed=id)))
    return played


def _filmed(player: Player) -> list[int]:
    """Who gets a camera: vehicles and walkers that are there while it plays; of many, the first ones."""
    kinds = {kind.name.lower() for kind in MOVERS}
    ids: dict[int, None] = {}  # in their order, each once
    for actor in actors(player.reader):
        gone = actor.destroyed_at is not None and actor.destroyed_at <= player.start
        if actor.kind in kinds and actor.spawned_at <= player.stop and not gone:
            ids[actor.id] = None
    if len(ids) > MOST_CAMERAS:
        warnings.warn(
            f"{player.reader.path}: only {MOST_CAMERAS} of {len(ids)} actors get a camera", RecapWarning, stacklevel=3
        )
    return list(ids)[:MOST_CAMERAS]
