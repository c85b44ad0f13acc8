"""Cameras: what they see in a tick, and how their images go over the wire."""

from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.rendering.camera import Camera, ImageKind
from carla_recap.replay.pose import MIRROR
from carla_recap.sensors.kinds import LARGEST_SIDE, NARROWEST, WIDEST
from carla_recap.server.sensors.dvs import EventDetector
from carla_recap.server.sensors.feed import number
from carla_recap.server.sensors.images import CameraScene, Shot, View
from carla_recap.server.sensors.rays import axes, row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.server.sensors.images import ImageThread
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.world import World

    Image = NDArray[Any]

_SIDES: Final = ("image_size_x", "image_size_y")
# width, height, field of view in degrees
_HEADER: Final = struct.Struct("<IIf")

# The bytes of each pixel: blue, green, red, alpha
_GREY: Final = bytes((128, 128, 128, 255))
_BLANK: Final[Mapping[ImageKind, bytes]] = {
    ImageKind.RGB: _GREY,
    ImageKind.DEPTH: bytes((255, 255, 255, 255)),  # depth is red + 256 green + 65536 blue; all set are 1,000 m
    ImageKind.SEMANTIC: bytes((0, 0, 0, 255)),
    ImageKind.INSTANCE: bytes((0, 0, 0, 255)),
    ImageKind.NORMALS: _GREY,
    ImageKind.FLOW: struct.pack("<2f", 0.0, 0.0),
}


class _ActiveCamera:
    """A camera with subscribers.

    Args:
        sensor: The camera.
        kind: The kind of its images.
        has_events: Whether it sends events instead of images.
    """

    def __init__(self, sensor: Actor, kind: ImageKind, *, has_events: bool) -> None:
        self.sensor = sensor
        self.kind = kind
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
            return self._header, np.ascontiguousarray(image).data.cast("B") if image.size else b""

        return parts


class Cameras:
    """The cameras that clients listen to.

    Args:
        world: The world.
        thread: What draws and sends their images.
        instances: Returns what is drawn of the actors of the world.
    """

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
        """Let a camera take an image, if it is due or one could not be drawn in time.

        Args:
            stream: The stream of the camera.
            sensor: The camera.
            kind: The kind of image.
            header: The header of its frame.
            is_due: Whether the camera ticks.
            has_events: Whether it sends events instead of images.
        """
        active = self._active.get(stream)
        if active is None:
            active = self._active[stream] = _ActiveCamera(sensor, kind, has_events=has_events)
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
    """Return the camera of a sensor's transform.

    Args:
        transform: The transform.
        width: The width of its images, in pixels.
        height: The height, in pixels.
        fov: The horizontal field of view, in degrees.
    """
    rotation = axes(transform) * MIRROR[:, None] * MIRROR  # the second axis is mirrored, too
    return Camera(width, height, fov, row(transform.location) * MIRROR, rotation)


class BlankImages:
    """Draws images without content."""

    def draw(self, view: View) -> Mapping[ImageKind, Image]:
        """See `ImageSource.draw`."""
        return {kind: _blank(kind, view.scene.camera.width, view.scene.camera.height) for kind in view.kinds}

    def close(self) -> None:
        """See `ImageSource.close`."""


def blank(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a camera whose images are grey."""
    width, height = (_side(sensor, key) for key in _SIDES)
    frame = _HEADER.pack(width, height, _fov(sensor)) + _GREY * (width * height)
    return lambda: (frame,)


def _blank(kind: ImageKind, width: int, height: int) -> Image:
    dtype = np.float32 if kind is ImageKind.FLOW else np.uint8
    return np.frombuffer(_BLANK[kind] * (width * height), dtype).reshape(height, width, -1)


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
