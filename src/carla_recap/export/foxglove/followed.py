"""The followed actor: the frames that a view is fixed to, what it does, and the traffic lights before it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.export.foxglove.entities import WORLD
from carla_recap.export.foxglove.scene import entity
from carla_recap.export.foxglove.schemas import FrameTransform, FrameTransforms, Quaternion, Vector3
from carla_recap.model.records import CM
from carla_recap.replay import calm_heading, level, quaternions, right_handed
from carla_recap.replay.motion import JUMP, TOP_SPEED
from carla_recap.replay.pose import LOCATION, YAW
from carla_recap.v1.followed_pb2 import Followed, ShownLight, ShownLights
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN, TrafficLightColor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.replay import Scene

    Floats = NDArray[np.float64]

TRANSFORMS: Final = "/tf"
HERO: Final = "/hero"
LIGHTS: Final = "/lights"

FOLLOWED_FRAME: Final = "followed"
HERO_FRAME: Final = "hero"

_KMH: Final = 3.6  # in a m/s
_AHEAD: Final = 6000.0  # cm; traffic lights farther away do not count
_ASIDE: Final = math.cos(math.radians(30))  # nor those that are farther to the side


class View(NamedTuple):
    """Frames at a moment, by name: poses in cm and degrees; and its time in nanoseconds since 1970."""

    frames: dict[str, Floats]
    time: int


def serialized(views: Sequence[View]) -> Iterator[bytes]:
    """Yield the serialized `FrameTransforms` of each view; what there is to calculate, for all together."""
    poses = right_handed(np.array([pose for view in views for pose in view.frames.values()]).reshape(-1, 6))
    rows = zip(poses[:, LOCATION].tolist(), quaternions(poses).tolist(), strict=True)
    for view in views:
        transforms = [_transform(name, *next(rows), view.time) for name in view.frames]
        yield FrameTransforms(transforms=transforms).SerializeToString()


class Frames:
    """Where views are fixed to, as frames in the world.

    `followed` is where the followed actor is, but with a level horizon and a calm heading; before the actor appears, and
    where there is none, at the origin. `hero` is the pose of the hero.
    """

    def __init__(self) -> None:
        self._hero: int | None = None
        self._view = np.zeros(6)
        self._before: tuple[float, Floats] | None = None

    def message(self, scene: Scene, pose: Floats | None, time: int) -> View:
        """The frames at a moment, still to be serialized.

        Args:
            scene: What is to be shown.
            pose: That of the followed actor.
            time: The same moment in nanoseconds since 1970.
        """
        if pose is not None:
            self._turn(scene.time, pose)
        if scene.events:
            self._hero = next((actor.id for actor in scene.actors.values() if actor.is_hero), None)
        frames = {FOLLOWED_FRAME: self._view}
        hero = finite_pose(scene, self._hero)
        if hero is not None:
            frames[HERO_FRAME] = hero
        return View(frames, time)

    def _turn(self, seconds: float, pose: Floats) -> None:
        heading, delta = None, 0.0
        if self._before is not None:
            delta = seconds - self._before[0]
            heading = float(self._view[YAW]) if possible(self._before[1], pose, delta) else None
        self._view = level(pose, calm_heading(float(pose[YAW]), heading, delta))
        self._before = (seconds, pose)


class Hero:
    """What the followed actor does."""

    def __init__(self) -> None:
        self._before: tuple[float, Floats] | None = None

    def message(self, scene: Scene, id: int, pose: Floats) -> Followed:
        """What it does at a moment.

        Args:
            scene: The moment.
            id: Who it is.
            pose: Where it is.
        """
        x, y, z, roll, pitch, yaw = right_handed(pose).tolist()
        actor = scene.actors.get(id)
        type_id = None if actor is None else actor.type_id
        message = Followed(elapsed=scene.time, id=id, type_id=type_id, x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)
        speed = self._speed(scene, id, pose)
        if speed is not None:
            message.speed, message.speed_kmh = speed, speed * _KMH
        control = _row(scene.vehicle_controls, id)
        if control is not None:
            for name in ("throttle", "brake", "steer", "gear"):
                setattr(message, name, control[name].item())
            message.hand_brake = bool(control["hand_brake"])
        return message

    def _speed(self, scene: Scene, id: int, pose: Floats) -> float | None:
        """In m/s: as recorded, or else from the way since the scene before; None after a jump."""
        before, self._before = self._before, (scene.time, pose)
        velocity = _row(scene.velocities, id)
        if velocity is not None:
            speed = math.hypot(velocity["x"], velocity["y"], velocity["z"])
            return speed if math.isfinite(speed) else None
        if before is None:
            return None
        delta = scene.time - before[0]
        if delta <= 0 or not possible(before[1], pose, delta):
            return None
        return math.dist(pose[LOCATION], before[1][LOCATION]) * CM / delta


class Lights:
    """What the traffic lights show.

    Attributes:
        told: What they showed when they last changed.
    """

    def __init__(self) -> None:
        self.told = ShownLights()
        self._shown: tuple[bytes, bytes] | None = None  # ids and states
        self._places: Floats = np.zeros((0, 2))  # cm
        self._ahead: int | None = None

    def look(self, scene: Scene, pose: Floats | None) -> bool:
        """Take in a moment; says whether anything has changed.

        Args:
            scene: The moment.
            pose: That of the followed actor.
        """
        states = scene.light_states
        before, ahead = self._shown, self._ahead
        ids, shown = states["id"].tobytes(), states["state"].tobytes()
        if before is None or ids != before[0]:
            before = None
            poses = [scene.pose_of(id) for id in states["id"].tolist()]
            self._places = np.array([(np.nan, np.nan) if pose is None else pose[:2] for pose in poses]).reshape(-1, 2)
        self._shown, self._ahead = (ids, shown), self._find_ahead(pose)
        if before is not None and ahead == self._ahead and shown == before[1]:
            return False
        lights = [
            ShownLight(id=id, state=_color(state), entity=entity(id))
            for id, state in zip(states["id"].tolist(), states["state"].tolist(), strict=True)
        ]
        none = ShownLight(id=0, state=TRAFFIC_LIGHT_COLOR_UNKNOWN, entity="")
        ahead_light = none if self._ahead is None else lights[self._ahead]
        self.told = ShownLights(elapsed=scene.time, ahead=ahead_light, lights=lights)
        return True

    def _find_ahead(self, pose: Floats | None) -> int | None:
        """The place of the nearest light before the followed actor."""
        if pose is None or not len(self._places):
            return None
        ways = self._places - pose[:2]
        distances = np.hypot(ways[:, 0], ways[:, 1])
        yaw = math.radians(pose[YAW])
        forward = ways @ (math.cos(yaw), math.sin(yaw))
        candidates = np.flatnonzero((distances < _AHEAD) & (forward > _ASIDE * distances))
        return int(candidates[distances[candidates].argmin()]) if len(candidates) else None


def finite_pose(scene: Scene, id: int | None) -> Floats | None:
    """Where an actor is; None where nothing tells, or no number does."""
    pose = None if id is None else scene.pose_of(id)
    return pose if pose is not None and np.isfinite(pose).all() else None


def possible(before: Floats, pose: Floats, delta: float) -> bool:
    """Whether an actor can have come from one pose to another in some seconds, without a jump."""
    return math.dist(before[LOCATION], pose[LOCATION]) <= max(JUMP, TOP_SPEED * delta)


def _color(state: int) -> str:
    """The name of a traffic light's state."""
    return TrafficLightColor.Name(state if 0 <= state < TRAFFIC_LIGHT_COLOR_UNKNOWN else TRAFFIC_LIGHT_COLOR_UNKNOWN)


def _row(records: NDArray[np.void], id: int) -> np.void | None:
    """The record of an id among records that ascend by it."""
    place = int(np.searchsorted(records["id"], id))
    return records[place] if place < len(records) and records["id"][place] == id else None


def _transform(frame: str, place: list[float], rotation: list[float], time: int) -> FrameTransform:
    x, y, z = place
    qx, qy, qz, qw = rotation
    transform = FrameTransform(
        parent_frame_id=WORLD,
        child_frame_id=frame,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
    transform.timestamp.FromNanoseconds(time)
    return transform
