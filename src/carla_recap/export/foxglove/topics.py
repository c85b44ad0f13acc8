"""All topics of an export, scene by scene."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

from carla_recap.export.event_text import Level, Teller
from carla_recap.export.foxglove import followed, roads, scene
from carla_recap.export.foxglove.schemas import FrameTransforms, Log, SceneUpdate
from carla_recap.formats.mcap.schema import LogClock
from carla_recap.replay import Played
from carla_recap.v1.followed_pb2 import Followed, ShownLights

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.export.foxglove.file import McapFile
    from carla_recap.maps import RoadMap
    from carla_recap.model.frame import Header
    from carla_recap.replay import Scene

    Floats = NDArray[np.float64]

LOG: Final = "/log"

TOPICS: Final[Mapping[str, type[Message]]] = {
    scene.MOVED: SceneUpdate,
    scene.STILL: SceneUpdate,
    roads.MAP: SceneUpdate,
    followed.TRANSFORMS: FrameTransforms,
    followed.HERO: Followed,
    followed.LIGHTS: ShownLights,
    LOG: Log,
}
"""The message of each topic."""

RATE: Final = 20.0
"""So many times a second a scene is shown at the most, but for those in which somebody comes or goes."""

_TOGETHER: Final = 256  # messages that are serialized at once
_SLACK: Final = 0.9  # frames do not come quite evenly
_LEVELS: Final = {Level.DEBUG: Log.DEBUG, Level.INFO: Log.INFO, Level.WARNING: Log.WARNING, Level.ERROR: Log.ERROR}


class Topics:
    """Writes scenes to a file.

    Args:
        file: Where to; its topics are `TOPICS`.
        header: That of the recording.
        follow: Whom the camera follows.
        road_map: The map, if there is one.
    """

    def __init__(self, file: McapFile, header: Header, follow: int | None, road_map: RoadMap | None) -> None:
        self._file = file
        self._clock = LogClock(header)
        self._follow = follow
        self._road_map = road_map
        self._actors = scene.Actors()
        self._frames = followed.Frames()
        self._hero = followed.Hero()
        self._lights = followed.Lights()
        self._teller = Teller()
        self._due = 0.0  # when the scene is to be shown again, in elapsed seconds
        self._first: Scene | None = None
        self._last: Scene | None = None
        self._count = 0
        self._time = 0  # ns
        self._shown = False
        self._waiting: list[tuple[str, int, bytes | scene.Drawing | followed.View]] = []

    def write(self, moment: Scene) -> None:
        """Add a scene, which comes behind those before.

        Raises:
            RecapError: The disk is full, or broken.
        """
        self._time = time = self._clock.times(moment.time)[0]
        self._count += 1
        self._last = moment
        if self._first is None:
            self._first = moment
            self._put(roads.MAP, time, roads.map_message(self._road_map, time))
        for level, subject, text, _ in self._teller.tell(moment):
            line = Log(level=_LEVELS[level], name=subject, message=text)
            line.timestamp.FromNanoseconds(time)
            self._put(LOG, time, line)
        pose = followed.finite_pose(moment, self._follow)
        if self._follow is not None and pose is not None:
            self._put(followed.HERO, time, self._hero.message(moment, self._follow, pose))
        self._shown = bool(moment.events) or not moment.time < self._due
        if self._shown:
            self._due = moment.time + _SLACK / RATE
            self._show(moment, pose)

    def end(self) -> Played:
        """Add what the last scene is to be left with; says how much was written.

        Raises:
            RecapError: The disk is full, or broken.
        """
        if self._first is None or self._last is None:
            return Played(0, 0.0)
        if not self._shown:
            self._show(self._last, followed.finite_pose(self._last, self._follow))
        if self._lights.told.elapsed != self._last.time:
            self._lights.told.elapsed = self._last.time
            self._put(followed.LIGHTS, self._time, self._lights.told)
        self._flush()
        return Played(self._count, self._last.time - self._first.time)

    def _put(self, topic: str, time: int, message: Message | bytes | scene.Drawing | followed.View) -> None:
        if not isinstance(message, (bytes, scene.Drawing, followed.View)):
            message = message.SerializeToString()
        self._waiting.append((topic, time, message))
        if len(self._waiting) >= _TOGETHER:
            self._flush()

    def _flush(self) -> None:
        """Write what waits, in order; drawings of a topic are serialized together."""
        waiting, self._waiting = self._waiting, []
        drawings: defaultdict[str, list[scene.Drawing]] = defaultdict(list)
        for topic, _, message in waiting:
            if isinstance(message, scene.Drawing):
                drawings[topic].append(message)
        serialized = {topic: scene.serialized(some) for topic, some in drawings.items()}
        views = followed.serialized([message for _, _, message in waiting if isinstance(message, followed.View)])
        for topic, time, message in waiting:
            if isinstance(message, scene.Drawing):
                message = next(serialized[topic])
            elif isinstance(message, followed.View):
                message = next(views)
            self._file.write(topic, time, message)

    def _show(self, moment: Scene, pose: Floats | None) -> None:
        self._put(followed.TRANSFORMS, self._time, self._frames.message(moment, pose, self._time))
        for topic, message in self._actors.messages(moment, self._time):
            self._put(topic, self._time, message)
        if self._lights.look(moment, pose):
            self._put(followed.LIGHTS, self._time, self._lights.told)
