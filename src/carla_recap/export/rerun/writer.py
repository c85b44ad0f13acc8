"""A recording into a Rerun stream, and into an .rrd."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import rerun as rr

from carla_recap.conversion import check_destination
from carla_recap.errors import RecapError
from carla_recap.export.rerun import roads
from carla_recap.export.rerun.actors import MOVERS, Actors
from carla_recap.export.rerun.blueprint import View, blueprint
from carla_recap.export.rerun.ego import Ego
from carla_recap.export.rerun.events import Chronicle
from carla_recap.export.rerun.signals import Signals
from carla_recap.export.rerun.stream import Moment, Stream
from carla_recap.formats.atomic import AtomicFile
from carla_recap.queries.actors import actors
from carla_recap.recording import Recording
from carla_recap.replay import Played, Player
from carla_recap.texts import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    import rerun.blueprint as rrb

    from carla_recap.export.rerun.stream import Part
    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.replay import Scene
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress

APPLICATION: Final = "carla_recap"
"""The kind of data, by which the viewer knows which blueprints fit."""

_LATEST: Final = 9_000_000_000  # s; what fits into 64 bits of nanoseconds


def write(
    stream: rr.RecordingStream,
    player: Player,
    *,
    road_map: RoadMap | None = None,
    progress: Progress | None = None,
    cameras: bool = False,
) -> Played:
    """Play a recording into a stream, which has to be flushed afterwards.

    Args:
        stream: A file, a viewer or a pipe.
        player: Plays it.
        road_map: The map of the town.
        progress: Is given the stream of scenes and their player, and passes the scenes on.
        cameras: Write the axes of a camera for each vehicle and walker, not for the followed actor alone.

    Raises:
        FormatError: The file contradicts its format.
    """
    sink = Stream(stream)
    _introduce(stream, player.reader)
    if road_map is not None:
        roads.draw(sink, road_map)
    followed = player.followed
    parts: list[Part] = [Actors(sink, followed, roads=road_map is not None, cameras=cameras), Signals(sink), Chronicle(sink)]
    if followed is not None:
        parts.append(Ego(sink, followed, ground=road_map is None))
    scenes: Iterable[Scene] = player.scenes()
    count = 0
    for scene in progress(scenes, player) if progress else scenes:
        moment = Moment.of(scene)
        for part in parts:
            part.enter(scene, moment)
        count += 1
    for part in parts:
        part.close()
    return Played(count, player.stop - player.start)


def _introduce(stream: rr.RecordingStream, reader: Reader) -> None:
    """Say what recording this is."""
    header = reader.header
    stream.send_recording_name(readable(reader.path.name))
    if 0 <= header.date <= _LATEST:
        stream.send_recording_start_time_nanos(header.date * 1_000_000_000)
    about = rr.AnyValues(map=readable(header.map_name), source=readable(str(reader.path)), recorder_version=header.version)
    stream.send_property("recording", about)


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
    for target in (destination, cameras):
        if target is not None:
            check_destination(reader.path, target, force=force)
    player = Player(reader, start=start, duration=duration, follow=follow)
    with _RrdFile(destination, blueprint(player, view=view)) as file:
        played = write(file.stream, player, road_map=road_map, progress=progress, cameras=cameras is not None)
        if cameras is not None:
            _save_cameras(player, Path(cameras), view)
    return played


class _RrdFile(AtomicFile):
    """An .rrd, which appears under its name only when it is complete.

    Attributes:
        stream: Writes to it.
    """

    def __init__(self, path: Path | str, arrangement: rrb.Blueprint) -> None:
        super().__init__(path)
        self.stream = rr.RecordingStream(APPLICATION, send_properties=False)
        self._begin(lambda: self.stream.save(self._partial, default_blueprint=arrangement))

    def abort(self) -> None:
        """Give the file up, and remove what was written."""
        self.stream.disconnect()
        super().abort()

    def _finish(self) -> None:
        try:
            self.stream.flush()
        except RuntimeError as error:
            raise RecapError(f"{self.path}: cannot be written: {error}") from None
        self.stream.disconnect()


def _save_cameras(player: Player, folder: Path, view: View) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecapError(f"{folder}: cannot be written: {error.strerror}") from None
    kinds = {kind.name.lower() for kind in MOVERS}
    for actor in actors(player.reader):
        gone = actor.destroyed_at is not None and actor.destroyed_at <= player.start
        if actor.kind in kinds and actor.spawned_at <= player.stop and not gone:
            arrangement = blueprint(player, view=view, followed=actor.id)
            arrangement.save(APPLICATION, str(folder / f"follow_{actor.id}.rbl"))
