"""The followed actor: the frames that a view is fixed to, its motion, and the traffic lights ahead of it."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.export.foxglove.messages import (
    WORLD,
    FrameTransform,
    FrameTransforms,
    Messages,
    Part,
    Template,
    fill_pose,
    numbers,
    pose_numbers,
    single,
    timestamp,
    timestamps,
)
from carla_recap.export.foxglove.scene import entity_id
from carla_recap.model.records import CM
from carla_recap.replay import calm_heading, level, quaternions, right_handed
from carla_recap.replay.pose import JUMP, LOCATION, TOP_SPEED, YAW
from carla_recap.v1.followed_pb2 import Followed, ShownLight, ShownLights
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN, TrafficLightColor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.export.foxglove.messages import Floats, Indices, Times
    from carla_recap.replay.scene import SceneBatch

TRANSFORMS: Final = "/tf"
HERO: Final = "/hero"
LIGHTS: Final = "/lights"

_FOLLOWED_FRAME: Final = "followed"
_HERO_FRAME: Final = "hero"

_KMH: Final = 3.6  # in a m/s
_AHEAD: Final = 6000.0  # cm; traffic lights farther away are not ahead
_ASIDE: Final = math.cos(math.radians(30))  # nor those farther to the side

_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_CONTROL: Final = ("throttle", "brake", "steer", "hand_brake", "gear")


class FinitePoses(NamedTuple):
    """The poses of an actor in the scenes of a batch in which they are known and finite.

    Attributes:
        rows: The positions of these scenes.
        time: Their moments, in elapsed seconds.
        poses: The poses, in cm and degrees, (scenes, 6).
    """

    rows: Indices
    time: Floats
    poses: Floats

    def among(self, rows: Indices) -> FinitePoses:
        """Return those in some scenes."""
        kept = np.isin(self.rows, rows)
        return FinitePoses(self.rows[kept], self.time[kept], self.poses[kept])


def finite_poses(batch: SceneBatch, id: int | None) -> FinitePoses:
    """Return the poses of an actor, if any."""
    poses = None if id is None else batch.pose_of(id)
    if poses is None:
        poses = np.full((len(batch), 6), np.nan)
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1))
    return FinitePoses(rows, batch.time[rows], poses[rows])


class _Path:
    """The path of an actor from scene to scene."""

    def __init__(self) -> None:
        self._last: tuple[float, list[float]] | None = None

    def steps(self, found: FinitePoses) -> Iterator[tuple[float, float | None]]:
        """Yield the seconds since the previous pose and the distance to it in cm, None for the first and after a jump."""
        for time, location in zip(found.time.tolist(), found.poses[:, LOCATION].tolist(), strict=True):
            before, self._last = self._last, (time, location)
            if before is None:
                yield 0.0, None
                continue
            seconds, distance = time - before[0], math.dist(before[1], location)
            yield seconds, distance if distance <= max(JUMP, TOP_SPEED * seconds) else None


class ViewFrames:
    """The frames that views are fixed to.

    `followed` is at the followed actor, but with a level horizon and a calm heading; at the origin before that actor
    appears, and where no actor is followed. `hero` is the pose of the hero.
    """

    def __init__(self) -> None:
        self._hero: int | None = None
        self._view = np.zeros(6)
        self._path = _Path()

    def messages(self, batch: SceneBatch, rows: Indices, times: Times, followed: FinitePoses) -> Iterator[Messages]:
        """Yield the messages of some scenes of a batch.

        Args:
            batch: The scenes.
            rows: The positions of the scenes that are shown.
            times: The time of each of these, in ns since 1970.
            followed: The followed actor in these.
        """
        if batch.events and not rows[0]:
            self._hero = next((actor.id for actor in batch.actors.values() if actor.is_hero), None)
        views = self._views(rows, followed)
        hero = finite_poses(batch, self._hero).among(rows)
        with_hero = np.isin(rows, hero.rows)
        for some, poses in (
            (~with_hero, {_FOLLOWED_FRAME: views[~with_hero]}),
            (with_hero, {_FOLLOWED_FRAME: views[with_hero], _HERO_FRAME: hero.poses}),
        ):
            if some.any():
                yield _transforms(rows[some], timestamps(times[some]), poses)

    def _views(self, rows: Indices, followed: FinitePoses) -> Floats:
        """Return the poses of the calm frame; the previous one where that of the actor is unknown."""
        heading = float(self._view[YAW])
        headings = []
        for (seconds, distance), yaw in zip(self._path.steps(followed), followed.poses[:, YAW].tolist(), strict=True):
            heading = calm_heading(yaw, None if distance is None else heading, seconds)
            headings.append(heading)
        views = np.concatenate((self._view[None], level(followed.poses, headings)))
        views = views[np.searchsorted(followed.rows, rows, side="right")]
        self._view = views[-1]
        return views


class FollowedMotion:
    """The motion of the followed actor."""

    def __init__(self) -> None:
        self._path = _Path()

    def messages(self, batch: SceneBatch, id: int, found: FinitePoses) -> Iterator[Messages]:
        """Yield the messages of a batch.

        Args:
            batch: The scenes.
            id: The followed actor.
            found: Its poses.
        """
        actor = batch.actors.get(id)
        type_id = None if actor is None else actor.type_id
        values = {"elapsed": found.time, "id": np.full(len(found.rows), id)}
        values |= dict(zip(_POSE, right_handed(found.poses).T, strict=True))
        control = _records_of(batch, "vehicle_controls", id)
        if control is not None:
            values |= {name: control[name][found.rows] for name in _CONTROL}
            values["hand_brake"] = values["hand_brake"] != 0
        speeds = self._speeds(batch, id, found)
        known = ~np.isnan(speeds)
        for some, columns in ((~known, values), (known, values | {"speed": speeds, "speed_kmh": speeds * _KMH})):
            if some.any():
                messages, rows = _followed_template(tuple(columns), type_id).messages(HERO, found.rows[some])
                for name, column in columns.items():
                    rows[name] = column[some]
                yield messages

    def _speeds(self, batch: SceneBatch, id: int, found: FinitePoses) -> Floats:
        """Return speeds in m/s: as recorded, or else from the distance to the previous pose; NaN after a jump."""
        steps = list(self._path.steps(found))
        velocity = _records_of(batch, "velocities", id)
        if velocity is None:
            speeds = [math.nan if d is None or seconds <= 0 else d * CM / seconds for seconds, d in steps]
        else:
            speeds = list(map(math.hypot, *(velocity[name][found.rows].tolist() for name in "xyz")))
        return np.array([speed if math.isfinite(speed) else math.nan for speed in speeds])


class LightMessages:
    """The states of the traffic lights.

    Attributes:
        latest: The latest message.
    """

    def __init__(self) -> None:
        self.latest = ShownLights()
        self._ids = b""
        self._locations: Floats = np.zeros((0, 2))  # cm
        self._shown: tuple[bytes, int] | None = None  # the latest states, and the index of the light ahead

    def messages(self, batch: SceneBatch, rows: Indices, followed: FinitePoses) -> Iterator[Messages]:
        """Yield a message for each of some scenes in which a light has changed, or another light is ahead.

        Args:
            batch: The scenes.
            rows: The positions of the scenes that are shown.
            followed: The followed actor in these.
        """
        lights = batch.light_states[rows]
        ids = lights["id"][0]
        if ids.tobytes() != self._ids or self._shown is None:
            self._ids, self._shown = ids.tobytes(), None
            poses = [batch.pose_of(id, int(rows[0])) for id in ids.tolist()]
            self._locations = np.array([(np.nan, np.nan) if pose is None else pose[:2] for pose in poses]).reshape(-1, 2)
        ahead = np.full(len(rows), -1)
        ahead[np.isin(rows, followed.rows)] = self._lights_ahead(followed.poses)
        states = lights["state"]
        changed = (states[1:] != states[:-1]).any(axis=1) | (ahead[1:] != ahead[:-1])
        for row in (0, *(np.flatnonzero(changed) + 1).tolist()):
            shown = (states[row].tobytes(), int(ahead[row]))
            if shown != self._shown:
                self._shown = shown
                self.latest = _shown_lights(batch.time[rows[row]].item(), ids, states[row], shown[1])
                yield single(LIGHTS, int(rows[row]), self.latest)

    def _lights_ahead(self, poses: Floats) -> Indices:
        """Return the index of the nearest light ahead of each pose; -1 without one."""
        if not len(self._locations):
            return np.full(len(poses), -1)
        ways = self._locations - poses[:, None, :2]
        distances = np.hypot(ways[..., 0], ways[..., 1])
        yaw = np.radians(poses[:, YAW, None])
        forward = ways[..., 0] * np.cos(yaw) + ways[..., 1] * np.sin(yaw)
        distances[~((distances < _AHEAD) & (forward > _ASIDE * distances))] = np.inf
        nearest: Indices = np.where(np.isfinite(distances).any(axis=1), distances.argmin(axis=1), -1)
        return nearest


def _shown_lights(elapsed: float, ids: NDArray[np.integer], states: NDArray[np.integer], ahead: int) -> ShownLights:
    lights = [
        ShownLight(id=id, state=_color_name(state), entity=entity_id(id))
        for id, state in zip(ids.tolist(), states.tolist(), strict=True)
    ]
    none = ShownLight(id=0, state=TRAFFIC_LIGHT_COLOR_UNKNOWN, entity="")
    return ShownLights(elapsed=elapsed, ahead=none if ahead < 0 else lights[ahead], lights=lights)


def _color_name(state: int) -> str:
    """Return the name of a traffic light's state."""
    return TrafficLightColor.Name(state if 0 <= state < TRAFFIC_LIGHT_COLOR_UNKNOWN else TRAFFIC_LIGHT_COLOR_UNKNOWN)


def _records_of(batch: SceneBatch, name: str, id: int) -> NDArray[np.void] | None:
    """Return the records of an actor, (scenes,); None if it has none."""
    records = batch.records(name)
    index = int(np.searchsorted(records["id"][0], id))
    return records[:, index] if index < records.shape[1] and records["id"][0, index] == id else None


@cache
def _transforms_template(frames: tuple[str, ...]) -> Template:
    return Template(*(_transform_part(frame) for frame in frames))


def _transform_part(frame: str) -> Part:
    constant = FrameTransform(parent_frame_id=WORLD, child_frame_id=frame).SerializeToString()
    stamp = timestamp(FrameTransform.TIMESTAMP_FIELD_NUMBER, frame)
    pose = pose_numbers(FrameTransform.TRANSLATION_FIELD_NUMBER, FrameTransform.ROTATION_FIELD_NUMBER, frame)
    return (Part(constant) + stamp + pose).within(FrameTransforms.TRANSFORMS_FIELD_NUMBER)


def _transforms(rows: Indices, stamps: NDArray[np.uint8], frames: dict[str, Floats]) -> Messages:
    """Return messages with the poses of some frames, in cm and degrees, by name."""
    messages, transforms = _transforms_template(tuple(frames)).messages(TRANSFORMS, rows)
    for frame, poses in frames.items():
        poses = right_handed(poses)
        transforms[f"{frame}timestamp"] = stamps
        fill_pose(transforms, poses[:, LOCATION], quaternions(poses), frame)
    return messages


@cache
def _followed_template(names: tuple[str, ...], type_id: str | None) -> Template:
    return Template(Part(Followed(type_id=type_id).SerializeToString()), numbers(Followed, names))
