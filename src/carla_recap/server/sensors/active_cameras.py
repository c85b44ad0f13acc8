"""Cameras: what they see in a tick, how their images go over the wire, and the events of event cameras (DVS)."""

from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.rendering.camera import Camera, ImageKind
from carla_recap.replay.pose import MIRROR
from carla_recap.sensors.kinds import LARGEST_SIDE, NARROWEST, WIDEST
from carla_recap.server.actor_records import release_of
from carla_recap.server.sensors.feeds import axes, flag, number, row, warn_of
from carla_recap.server.sensors.images import GREY, CameraScene, Shot, View

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.sensors.feeds import Feed, FeedContext
    from carla_recap.server.sensors.images import ImageThread
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.world import World

    Image = NDArray[Any]
    Floats = NDArray[np.float32]

_SIDES: Final = ("image_size_x", "image_size_y")
# width, height, field of view in degrees
_HEADER: Final = struct.Struct("<IIf")

_RED: Final = 2  # where the semantic tag is
_EVENT: Final = np.dtype([("x", "<u2"), ("y", "<u2"), ("time", "<i8"), ("polarity", "?")])
_LUMINANCE: Final = np.array([0.114, 0.587, 0.2989], np.float32)  # of blue, green and red
_LEAST_THRESHOLD: Final = 0.01  # as in CARLA
_LEAST_EPSILON: Final = 1e-6
_MOST_EVENTS: Final = 1 << 22  # of an image; those of the lowest pixels are lost, and the log says so
_NS: Final = 1e9  # in a second


class _ActiveCamera:
    """A camera with subscribers."""

    def __init__(self, sensor: Actor, kind: ImageKind, *, has_events: bool, release: Release) -> None:
        self.sensor = sensor
        self.kind = kind
        self._release = release
        self.width, self.height = (_side(sensor, key) for key in _SIDES)
        self.fov = _fov(sensor)
        self.is_owed = False
        self.previous: CameraScene | None = None
        self._header = _HEADER.pack(self.width, self.height, self.fov)
        self._events = EventDetector(sensor) if has_events else None

    def encode(self, elapsed: float) -> Callable[[Image], Iterable[bytes | memoryview]]:
        """Return what turns an image of a time in s into the parts of a frame."""

        def parts(image: Image) -> Iterable[bytes | memoryview]:
            if self._events is not None:
                image = self._events.detect(image, elapsed)
            elif self._release.labels and self.kind in (ImageKind.SEMANTIC, ImageKind.INSTANCE):
                image = image.copy()
                image[..., _RED] = self._release.relabelled(image[..., _RED])
            return self._header, np.ascontiguousarray(image).data.cast("B") if image.size else b""

        return parts


class Cameras:
    """The cameras that clients listen to."""

    def __init__(self, world: World, thread: ImageThread, instances: Callable[[], Instances]) -> None:
        self._world = world
        self._thread = thread
        self._instances = instances
        self._active: dict[int, _ActiveCamera] = {}
        self._due: dict[int, bytes] = {}

    def keep(self, streams: Iterable[int]) -> None:
        """Forget the cameras of all other streams; with the last one goes the memory that large images take."""
        for stream in self._active.keys() - set(streams):
            del self._active[stream]
            if not self._active:
                self._thread.release()

    def take(self, stream: int, sensor: Actor, kind: ImageKind, header: bytes, *, is_due: bool, has_events: bool) -> None:
        """Let a camera take an image, if it is due or one could not be drawn in time."""
        active = self._active.get(stream)
        if active is None:
            release = release_of(stream)
            active = self._active[stream] = _ActiveCamera(sensor, kind, has_events=has_events, release=release)
        active.is_owed |= is_due
        if active.is_owed:
            self._due[stream] = header

    def submit(self) -> None:
        """Have the images of the tick drawn, those of cameras of the same pose, size and field of view together.

        In asynchronous mode they wait for a later tick while those of an earlier one are drawn.
        """
        due, self._due = self._due, {}
        if not due:
            return
        loop, keeps_all = asyncio.get_running_loop(), self._world.settings.synchronous_mode
        self._thread.prepare(self._world.town)
        if keeps_all or not self._thread.is_busy:
            self._thread.submit(self._world.town, self._views(due), loop, keeps_all=keeps_all)

    def _views(self, due: Mapping[int, bytes]) -> list[View]:
        views: dict[tuple[object, ...], View] = {}
        found: list[View] = []
        everything = self._instances()
        for stream in sorted(due, key=lambda stream: self._active[stream].kind is not ImageKind.FLOW):
            active = self._active[stream]
            active.is_owed = False
            transform, hidden = active.sensor.transform, _surrounding(active.sensor)
            location, turn = transform.location, transform.rotation
            pose = (location.x, location.y, location.z, turn.pitch, turn.yaw, turn.roll)
            key = (*pose, active.width, active.height, active.fov, hidden)
            view = views.get(key)
            if view is None or (active.kind is ImageKind.FLOW and view.previous is not active.previous):
                scene = CameraScene(camera_at(transform, active.width, active.height, active.fov), everything)
                view = View(scene, active.previous, hidden, self._world.weather, [])
                views.setdefault(key, view)
                found.append(view)
            view.shots.append(Shot(stream, due[stream], active.kind, active.encode(self._world.elapsed)))
            if active.kind is ImageKind.FLOW:
                active.previous = view.scene
        return found


def camera_at(transform: Transform, width: int, height: int, fov: float) -> Camera:
    """Return the camera of a sensor's transform: width and height are in pixels, the horizontal field of view in degrees."""
    rotation = axes(transform) * MIRROR[:, None] * MIRROR  # the second axis is mirrored, too
    return Camera(width, height, fov, row(transform.location) * MIRROR, rotation)


def blank(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a camera whose images are grey."""
    width, height = (_side(sensor, key) for key in _SIDES)
    frame = _HEADER.pack(width, height, _fov(sensor)) + GREY * (width * height)
    return lambda: (frame,)


def _side(sensor: Actor, key: str) -> int:
    return int(min(max(number(sensor, key), 1), LARGEST_SIDE))


def _fov(sensor: Actor) -> float:
    """Return the field of view that is drawn, in degrees."""
    return min(max(number(sensor, "fov"), NARROWEST), WIDEST)


def _surrounding(sensor: Actor) -> frozenset[int]:
    """Return the carriers of a camera whose boxes it is inside of: they would hide everything."""
    found, carrier = set(), sensor.parent
    location = row(sensor.transform.location)
    while carrier is not None:
        transform, extent = carrier.transform, row(carrier.box.extent)
        if (np.abs((location - row(transform.transform(carrier.box.location))) @ axes(transform)) < extent).all():
            found.add(carrier.id)
        carrier = carrier.parent
    return frozenset(found)


class EventDetector:
    """Compares each image of an event camera with the one before, as CARLA does, but without noise.

    The brightness is supposed to change evenly between two images. A pixel has an event whenever its brightness has changed
    by a threshold since its last event.
    """

    def __init__(self, sensor: Actor) -> None:
        self._rising = max(number(sensor, "positive_threshold"), _LEAST_THRESHOLD)
        self._falling = max(number(sensor, "negative_threshold"), _LEAST_THRESHOLD)
        self._is_logarithmic = flag(sensor, "use_log")
        self._epsilon = max(number(sensor, "log_eps"), _LEAST_EPSILON)
        self._warn: Callable[[str], None] | None = warn_of(sensor)
        self._last: Floats | None = None
        self._reference = np.empty(0, np.float32)
        self._time = 0.0

    def detect(self, image: NDArray[Any], time: float) -> NDArray[np.void]:
        """Return the events of an image, (height, width, 4), at some s, since the one before, ordered by time."""
        brightness = (image[..., :3].astype(np.float32) @ _LUMINANCE).ravel()
        if self._is_logarithmic:
            brightness = np.log(self._epsilon + brightness / 255)
        last, before = self._last, self._time
        self._last, self._time = brightness, time
        if last is None or len(last) != len(brightness):
            self._reference = brightness.copy()
            return np.empty(0, _EVENT)
        changed = np.flatnonzero(brightness != last)
        old, new, reference = last[changed], brightness[changed], self._reference[changed]
        rises = new > old
        sign = np.where(rises, 1, -1).astype(np.float32)
        step = np.where(rises, self._rising, self._falling).astype(np.float32)
        most = np.floor(sign * (new - reference) / step).astype(np.int64)  # crossings of thresholds until now
        least = np.maximum(np.floor(sign * (old - reference) / step).astype(np.int64), 0)  # those before
        crossed = np.flatnonzero(most > least)
        self._reference[changed[crossed]] += sign[crossed] * step[crossed] * most[crossed]
        counts = most[crossed] - least[crossed]
        kept = counts[np.cumsum(counts) <= _MOST_EVENTS]
        if len(kept) < len(counts) and self._warn is not None:
            self._warn(f"at {time:.2f} s, expected at most {_MOST_EVENTS} events in an image, found {counts.sum()}")
            self._warn = None
        counts = kept
        crossed = crossed[: len(counts)]
        row = np.repeat(crossed, counts)
        number_of = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + least[row] + 1
        level = reference[row] + sign[row] * step[row] * number_of
        share = np.clip((level - old[row]) / (new[row] - old[row]), 0.0, 1.0)
        events = np.zeros(len(row), _EVENT)
        events["y"], events["x"] = np.divmod(changed[row], image.shape[1])
        events["time"] = (before + share.astype(np.float64) * (time - before)) * _NS
        events["polarity"] = rises[row]
        return events[np.argsort(events["time"], kind="stable")]
