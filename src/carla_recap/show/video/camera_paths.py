"""The paths of the camera of a video, and the actors that are made see-through, so that nothing hides the followed one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.rendering.camera import Camera
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.replay.selection import index_in
from carla_recap.scene.opacity import SeenBoxes, is_flat, is_near, wanted_opacities

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import Scene
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.scene.instances import Instances
    from carla_recap.show.video.encoding import Size
    from carla_recap.util.arrays import Floats


VideoView = Literal["chase", "top", "driver"] | int
"""The view of a video: from behind, from above, that of the driver, or that of a recorded camera, by its id."""

_FOV: Final = 70.0  # degrees, horizontal
_TALLEST: Final = 58.0  # degrees; the largest vertical field of view
_HORIZON: Final = 0.31  # of the height of the picture, from its upper edge
_FEET: Final = 0.91  # of the height; the rear end of the followed actor touches the ground not below it
_STEEPEST: Final = 0.51  # the tangent of the largest angle at which the camera looks down at it
_CALM_ZOOM: Final = 1.5  # s; that of the scale of a picture from above
_TOP_SPAN: Final = 42.0  # m, from the lower to the upper edge of a picture from above, of an actor that stands
_TOP_AHEAD: Final = 2.2  # s; the distance of this time is added
_TOP_SHIFT: Final = 0.16  # of the span; the actor is below the middle, since what matters is ahead of it
_FADE: Final = 0.25  # s; the time constant of a change of opacity


@dataclass(frozen=True, eq=False)
class Subject:
    """The followed actor at a moment, in m, right-handed."""

    ground: Floats  # the point below its centre, at the bottom of its box
    rotation: Floats  # a matrix whose columns point forward, left and up
    half: Floats  # half the size of its box
    body: Floats  # the same as `rotation`, but of the body as it is drawn: that of a walker that has fallen lies
    heading: float  # the yaw of a calm camera, in degrees
    speed: float | None  # its speed in m/s; None if unknown
    two_wheeled: bool = False  # whether its rider is not inside of it
    is_walker: bool = False  # whether it is a walker


def subject_of(id: int, scene: Scene, instances: Instances, series: FollowedSeries) -> Subject | None:
    """Return the followed actor in a scene; None if it has no finite pose then."""
    pose, actor = scene.pose_of(id), scene.actors.get(id)
    if pose is None or actor is None:
        return None
    placed = right_handed(pose)
    rotation = body = rotations(placed)
    index = index_in(instances.ids, id)
    if index is not None:
        centre, half = instances.locations[index], instances.half_extents[index].astype(np.float64)
        body = instances.rotations[index].astype(np.float64)
    else:
        box = box_of(actor)
        half = np.array((box.extent_x, box.extent_y, box.extent_z))
        centre = placed[LOCATION] + rotation @ np.array((box.x, box.y, box.z))
    if not (np.isfinite(centre).all() and np.isfinite(rotation).all() and np.isfinite(half).all()):
        return None
    return Subject(
        centre - np.array((0.0, 0.0, np.abs(body[2]) @ half)),
        rotation,
        half,
        body,
        -series.heading_at(scene.time),
        number_or_none(series.speed[series.row_at(scene.time)]),
        actor.spawn.attribute("number_of_wheels") == "2",
        actor.kind == "walker",
    )


def number_or_none(value: float) -> float | None:
    """Return a number; None for one that is not finite."""
    return float(value) if math.isfinite(value) else None


def camera_path(view: VideoView, size: Size) -> _ChasePath | _TopPath | _DriverPath | _RecordedPath:
    """Return the path of the camera of a view, for pictures of a size; its `camera` gets the scenes in order."""
    if isinstance(view, int):
        return _RecordedPath(view, size)
    if view == "driver":
        return _DriverPath(size)
    return _TopPath(size) if view == "top" else _ChasePath(size)


class _Lens(NamedTuple):
    """The size of the pictures and the horizontal field of view in degrees."""

    width: int
    height: int
    fov: float

    @classmethod
    def fitted(cls, size: Size, fov: float = _FOV) -> _Lens:
        """Return a lens whose vertical field of view is not too large for high pictures."""
        width, height = size
        widest = 2 * math.degrees(math.atan(math.tan(math.radians(_TALLEST) / 2) * width / height))
        return cls(width, height, min(fov, widest))

    @property
    def focal_length(self) -> float:
        return self.width / 2 / math.tan(math.radians(self.fov) / 2)

    def tilt(self, horizon: float) -> float:
        """Return the pitch in degrees, upwards, at which the horizon is at a part of the height, from the upper edge."""
        return -math.degrees(math.atan((0.5 - horizon) * self.height / self.focal_length))

    def camera(self, location: Floats, heading: float, pitch: float, roll: float = 0.0) -> Camera:
        """Return a camera; the angles are in degrees, and a positive pitch is upwards."""
        pose = np.array((0, 0, 0, roll, -pitch, heading), np.float64)
        return Camera(self.width, self.height, self.fov, location, rotations(pose))


class _ChasePath:
    """A camera behind and above the followed actor: the farther the larger it is, with the horizon in the upper third."""

    def __init__(self, size: Size) -> None:
        self._lens = _Lens.fitted(size)
        self._tilt = self._lens.tilt(_HORIZON)
        lowest = self._tilt - self._lens.tilt(_FEET)  # the pitch of what is seen at that height
        self._steepness = min(-math.tan(math.radians(lowest)), _STEEPEST)

    def camera(self, scene: Scene, instances: Instances, subject: Subject | None) -> Camera:
        if subject is None:
            return _overview(self._lens, instances, pitch=-35.0)
        length, height = 2 * float(subject.half[0]), 2 * float(subject.half[2])
        distance = 3.2 + 0.35 * length + 1.6 * height  # from its rear
        back, yaw = distance + length / 2, math.radians(subject.heading)
        offset = np.array((-back * math.cos(yaw), -back * math.sin(yaw), self._steepness * distance))
        return self._lens.camera(subject.ground + offset, subject.heading, self._tilt)


class _TopPath:
    """A camera above the followed actor, whose heading is upwards; the faster the actor, the more it shows."""

    def __init__(self, size: Size) -> None:
        self._lens = _Lens.fitted(size, 50.0)
        self._span: float | None = None
        self._time = 0.0

    def camera(self, scene: Scene, instances: Instances, subject: Subject | None) -> Camera:
        if subject is None:
            return _overview(self._lens, instances, pitch=-90.0)
        span = max(_TOP_SPAN, 5 * float(subject.half[0])) + _TOP_AHEAD * (subject.speed or 0.0)
        if self._span is not None:
            share = -math.expm1(-max(scene.time - self._time, 0.0) / _CALM_ZOOM)
            span = self._span + share * (span - self._span)
        self._span, self._time = span, scene.time
        yaw = math.radians(subject.heading)
        up = span * self._lens.focal_length / self._lens.height
        shift = _TOP_SHIFT * span
        offset = np.array((shift * math.cos(yaw), shift * math.sin(yaw), up))
        return self._lens.camera(subject.ground + offset, subject.heading, -90.0)


class _DriverPath:
    """A camera at the eyes of the driver, rider or walker, in front of what would be in the way."""

    def __init__(self, size: Size) -> None:
        self._lens = _Lens.fitted(size, 78.0)
        self._tilt = self._lens.tilt(0.42)

    def camera(self, scene: Scene, instances: Instances, subject: Subject | None) -> Camera:
        if subject is None:
            return _overview(self._lens, instances, pitch=-35.0)
        half = subject.half
        ahead, up = _eye(subject)
        location = subject.ground + (0, 0, half[2]) + subject.rotation @ np.array((ahead, 0.0, up - half[2]))
        forward, left = subject.rotation[:, 0], subject.rotation[:, 1]
        heading = math.degrees(math.atan2(forward[1], forward[0]))
        pitch = math.degrees(math.asin(max(-1.0, min(1.0, float(forward[2])))))
        roll = math.degrees(math.asin(max(-1.0, min(1.0, float(left[2])))))
        return self._lens.camera(location, heading, pitch + self._tilt, roll)


def _eye(subject: Subject) -> tuple[float, float]:
    """Return how far ahead of the centre of an actor, and how high above the ground, its driver's view is best."""
    length, height = float(subject.half[0]), 2 * float(subject.half[2])
    if subject.is_walker:
        return length + 0.1, 0.93 * height
    if subject.two_wheeled:
        return 0.35 * length, 0.95 * height
    if height > 2.0:  # of vans, trucks and buses: at the windscreen
        return length + 0.05, 0.7 * height
    return 0.42 * length, 0.84 * height


class _RecordedPath:
    """The camera that a recorded sensor was."""

    def __init__(self, id: int, size: Size) -> None:
        self._id = id
        self._size = size
        self._camera: Camera | None = None

    def camera(self, scene: Scene, instances: Instances, subject: Subject | None) -> Camera:
        actor, pose = scene.actors.get(self._id), scene.pose_of(self._id)
        if actor is not None and pose is not None and np.isfinite(pose).all():
            placed = right_handed(pose)
            self._camera = Camera(*self._size, camera_fov(actor), placed[LOCATION], rotations(placed))
        return self._camera or _overview(_Lens.fitted(self._size), instances, pitch=-35.0)


def camera_fov(actor: ActorLife) -> float:
    """Return the recorded field of view of a camera sensor, in degrees."""
    fov = _number(actor.spawn.attribute("fov"))
    return fov if 1 <= fov <= 170 else 90.0


def camera_size(attributes: Mapping[str, str]) -> Size | None:
    """Return the recorded size of the images of a camera sensor, in pixels; None without one."""
    width, height = (_number(attributes.get(f"image_size_{axis}")) for axis in "xy")
    return (int(width), int(height)) if width >= 1 and height >= 1 and max(width, height) < math.inf else None


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


def _overview(lens: _Lens, instances: Instances, *, pitch: float) -> Camera:
    """Return a camera that shows most of the actors, if none is followed."""
    finite = instances.locations[np.isfinite(instances.locations).all(axis=1)]
    centre = np.median(finite, axis=0) if len(finite) else np.zeros(3)
    span = np.quantile(np.hypot(*(finite - centre)[:, :2].T), 0.8) if len(finite) else 0.0
    distance = min(max(2.4 * float(span), 40.0), 400.0) * lens.focal_length / lens.height
    offset = -np.array((math.cos(math.radians(pitch)), 0.0, math.sin(math.radians(pitch))))
    return lens.camera(centre + distance * offset, 0.0, pitch)


def pixels_per_metre(camera: Camera, ground: float) -> float | None:
    """Return the scale of the ground at a height in m, in a picture from above; None in another view."""
    distance = float(camera.location[2]) - ground
    return camera.focal_length / distance if camera.rotation[2, 0] < -0.99 and distance > 0 else None


def covered_by(camera: Camera, subject: Subject) -> tuple[float, float, float, float] | None:
    """Return the pixels that the box of the followed actor covers: left, top, right, bottom; None if it is not seen."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * subject.half
    centre = subject.ground + np.array((0.0, 0.0, np.abs(subject.body[2]) @ subject.half))
    x, y, depth = camera.project(centre + corners @ subject.body.T).T
    return (float(x.min()), float(y.min()), float(x.max()), float(y.max())) if depth.min() > 0 else None


class Transparency:
    """Makes actors see-through that hide the followed one, and the followed one where it hides an actor."""

    def __init__(self) -> None:
        self._opacity: dict[int, float] = {}
        self._time = -math.inf

    def apply(self, camera: Camera, instances: Instances, followed: int | None, seconds: float) -> Instances:
        """Return instances with their opacities for a camera.

        `seconds` is the time of the video since the last picture.
        """
        wanted = self._wanted(camera, instances, followed)
        share = -math.expm1(-seconds / _FADE)
        for id in {*self._opacity, *wanted}:
            now, goal = self._opacity.get(id, 1.0), wanted.get(id, 1.0)
            self._opacity[id] = now + share * (goal - now)
        self._opacity = {id: value for id, value in self._opacity.items() if id in wanted or value < 0.99}
        changed = [
            (index, value) for id, value in self._opacity.items() if (index := index_in(instances.ids, id)) is not None
        ]
        if not changed:
            return instances
        opacity = instances.opacity.copy()
        for index, value in changed:
            opacity[index] = min(opacity[index], value)
        return replace(instances, opacity=opacity)

    def _wanted(self, camera: Camera, instances: Instances, followed: int | None) -> dict[int, float]:
        """Return the opacities of the actors that should be see-through."""
        own = None if followed is None else index_in(instances.ids, followed)
        if own is None or not np.isfinite(instances.locations[own]).all():
            return {}
        seen = ~is_flat(instances.half_extents.astype(np.float64)) & is_near(instances.locations, camera.location)
        seen[own] = False
        others = np.flatnonzero(seen)
        opacity, other_opacity = wanted_opacities(
            camera.location[None],
            camera.rotation[None],
            _boxes(instances, np.array([own])),
            _boxes(instances, others),
            np.zeros(len(others), np.intp),
        )
        rows, values = np.append(own, others), np.append(opacity, other_opacity)
        return {int(instances.ids[rows[index]]): float(values[index]) for index in np.flatnonzero(values < 1)}


def _boxes(instances: Instances, rows: NDArray[np.intp]) -> SeenBoxes:
    rotations, half_extents = (column[rows].astype(np.float64) for column in (instances.rotations, instances.half_extents))
    return SeenBoxes(instances.locations[rows], rotations, half_extents)
