"""Everything that is shown of a recording, or of a world as it goes on, scene after scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from carla_recap.export.rerun import roads
from carla_recap.export.rerun.actors import Actors
from carla_recap.export.rerun.ego import Ego
from carla_recap.export.rerun.events import Chronicle
from carla_recap.export.rerun.signals import Signals
from carla_recap.export.rerun.stream import Moment, Stream
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.export.rerun.stream import Part
    from carla_recap.maps import RoadMap
    from carla_recap.model.frame import Header
    from carla_recap.replay import Scene

_LATEST: Final = 9_000_000_000  # s; what fits into 64 bits of nanoseconds


def introduce(stream: rr.RecordingStream, header: Header, name: str, source: str) -> None:
    """Say what recording this is."""
    stream.send_recording_name(readable(name))
    if 0 <= header.date <= _LATEST:
        stream.send_recording_start_time_nanos(header.date * 1_000_000_000)
    about = rr.AnyValues(map=readable(header.map_name), source=readable(source), recorder_version=header.version)
    stream.send_property("recording", about)


class Stage:
    """Writes scenes.

    Args:
        stream: Where to.
        followed: Whom the camera follows; None: nobody.
        road_map: The map of the town.
        cameras: Ids of others who get the axes of a camera, too.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        *,
        followed: int | None = None,
        road_map: RoadMap | None = None,
        cameras: Iterable[int] = (),
    ) -> None:
        self._stream = Stream(stream)
        self._has_roads = road_map is not None
        if road_map is not None:
            roads.draw(self._stream, road_map)
        self._actors = Actors(self._stream, followed, roads=self._has_roads, cameras=cameras)
        self._parts: list[Part] = [self._actors, Signals(self._stream), Chronicle(self._stream)]
        self._ego: Ego | None = None
        if followed is not None:
            self.follow(followed)

    def follow(self, id: int) -> None:
        """Let the camera follow somebody from the next scene on."""
        if self._ego is not None:
            self._ego.flush()
            self._parts.remove(self._ego)
        self._actors.follow(id)
        self._ego = Ego(self._stream, id, ground=not self._has_roads)
        self._parts.append(self._ego)

    def enter(self, scene: Scene) -> None:
        """Take a scene in."""
        moment = Moment.of(scene)
        for part in self._parts:
            part.enter(scene, moment)

    def flush(self) -> None:
        """Write what is held back."""
        for part in self._parts:
            part.flush()

    def close(self) -> None:
        """Write what is held back, and what is known only at the end.

        Warns:
            RecapWarning: There are too many actors to show all of them.
        """
        self.flush()
        self._actors.close()
