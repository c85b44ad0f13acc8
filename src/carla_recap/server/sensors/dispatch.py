"""The kinds of sensors, and what sends their data to the clients that listen; others cost nothing."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from importlib.util import find_spec
from math import floor
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from carla_recap.rendering.camera import ImageKind
from carla_recap.scene.materials import Tag
from carla_recap.server import actor_records
from carla_recap.server.protocol.releases import Labels
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.structs import ActorDescription, ActorRecord, BoxStruct
from carla_recap.server.sensors import active_cameras, feeds, rays
from carla_recap.server.sensors.active_cameras import Cameras
from carla_recap.server.sensors.feeds import FeedContext, number, silent
from carla_recap.server.sensors.images import ImageThread
from carla_recap.server.sensors.surfaces import DrawnImages, TownSurfaces
from carla_recap.server.sensors.v2x import RadioChannel, message_bytes, v2x
from carla_recap.server.snapshots import sensor_header
from carla_recap.sim.actors.props import Sensor
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Future

    from carla_recap.rendering.camera import Quality
    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.instances import Instances
    from carla_recap.server.actor_records import DestroyedActor
    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.sensors.drawn_actors import WorldActors
    from carla_recap.server.sensors.feeds import Feed, MakeFeed
    from carla_recap.server.streams import Streams
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.world import World

_LOG: Final = logging.getLogger(__name__)
_ROUNDING: Final = 1e-6  # s
_SPAWN_PATIENCE: Final = 1.5  # s: calls of many scripts time out after 2 s
_TICK_PATIENCE: Final = 0.8  # s: the tick itself takes time, too
_NEEDING_SURFACES: Final = ("moderngl", "embreex")
_CAMERA: Final = "sensor.camera."
_STATIC: Final = {
    Tag.ROADS: "road",
    Tag.SIDEWALKS: "sidewalk",
    Tag.WALLS: "wall",
    Tag.POLES: "pole",
    Tag.TRAFFIC_SIGNS: "trafficsign",
    Tag.TERRAIN: "terrain",
    Tag.ROAD_LINES: "roadline",
    Tag.GROUND: "ground",
    Tag.BRIDGE: "bridge",
}
"""CARLA's names of what is no actor, by its semantic tag."""


class Support(StrEnum):
    """How far a kind of sensor is supported."""

    LIVE = "live"
    BLANK = "blank"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class SensorKind:
    """A kind of sensor.

    Attributes:
        what: A description of its data for the documentation.
        by_event: Whether it sends what happens at once, whatever its `sensor_tick` is.
        image: The kind of image that it takes, for cameras that are drawn.
        has_events: Whether it sends the changes of its images.
        casts: Whether it needs the surfaces of the town.
    """

    support: Support
    what: str
    make: MakeFeed = silent
    by_event: bool = False
    image: ImageKind | None = None
    has_events: bool = False
    casts: bool = False


def _camera(image: ImageKind, what: str) -> SensorKind:
    return SensorKind(Support.LIVE, what, image=image)


_COLLISIONS: Final = "each collision of its parent"
_POSITION: Final = "its position by the map's geo-reference; with noise"
_SURFACES: Final = "the ground, trees, signs, lights, vehicles, walkers and props; no buildings"
_CAM: Final = "cooperative awareness messages of other vehicles in range"

SENSOR_KINDS: Final[Mapping[str, SensorKind]] = MappingProxyType(
    {
        "sensor.camera.cosmos_visualization": SensorKind(Support.BLANK, "grey", active_cameras.blank),
        "sensor.camera.depth": _camera(ImageKind.DEPTH, "the depth along the axis of view, up to 1,000 m"),
        "sensor.camera.dvs": SensorKind(
            Support.LIVE, "changes of brightness between two images", image=ImageKind.RGB, has_events=True
        ),
        "sensor.camera.instance_segmentation": _camera(ImageKind.INSTANCE, "semantic tags and actor ids"),
        "sensor.camera.normals": _camera(ImageKind.NORMALS, "normals of surfaces, in the axes of the world"),
        "sensor.camera.optical_flow": _camera(ImageKind.FLOW, "motion since the image before"),
        "sensor.camera.rgb": _camera(ImageKind.RGB, "the scene with sky, light and weather"),
        "sensor.camera.semantic_segmentation": _camera(ImageKind.SEMANTIC, "CARLA's semantic tags"),
        "sensor.lidar.ray_cast": SensorKind(Support.LIVE, _SURFACES, rays.lidar, casts=True),
        "sensor.lidar.ray_cast_semantic": SensorKind(Support.LIVE, _SURFACES, rays.semantic_lidar, casts=True),
        "sensor.other.collision": SensorKind(Support.LIVE, _COLLISIONS, feeds.collisions, by_event=True),
        "sensor.other.gnss": SensorKind(Support.LIVE, _POSITION, feeds.gnss),
        "sensor.other.imu": SensorKind(Support.LIVE, "the motion of its parent; with noise", feeds.imu),
        "sensor.other.lane_invasion": SensorKind(Support.LIVE, "found by the client itself"),
        "sensor.other.obstacle": SensorKind(Support.LIVE, f"{_SURFACES}; and barriers", rays.obstacles, casts=True),
        "sensor.other.radar": SensorKind(Support.LIVE, _SURFACES, rays.radar, casts=True),
        "sensor.other.rss": SensorKind(Support.SILENT, "needs a client that is built with RSS"),
        "sensor.other.v2x": SensorKind(Support.LIVE, _CAM, v2x),
        "sensor.other.v2x_custom": SensorKind(Support.LIVE, "messages that other such sensors in range `send`", v2x),
    }
)
"""All kinds of sensors by the names of their blueprints."""


class Sensors:
    """The sensors of a world; `find` returns an actor by its id, even one that has been destroyed."""

    def __init__(
        self, world: World, streams: Streams, find: Callable[[int], Actor | DestroyedActor], quality: Quality = "epic"
    ) -> None:
        self._world = world
        self._streams = streams
        self._find = find
        self._feeds: dict[int, Feed] = {}
        self._first_ticks: WeakKeyDictionary[Actor, float] = WeakKeyDictionary()
        self._radio = RadioChannel()
        self._surfaces = TownSurfaces()
        self._images = ImageThread(streams, partial(DrawnImages, self._surfaces, quality))
        self._cameras = Cameras(world, self._images, self.instances)
        self._loading: list[Future[Any]] = []

    def instances(self) -> Instances:
        """Return what is drawn of the actors after the latest tick."""
        return self._actors.instances()

    @cached_property
    def _actors(self) -> WorldActors:
        from carla_recap.server.sensors.drawn_actors import WorldActors  # it imports the models

        return WorldActors(self._world)

    def ray_scene(self) -> RayScene | None:
        """Return the surfaces that rays meet; None if there are none but boxes, or none yet."""
        return self._surfaces.ready_rays(self._world.town)

    def load_ahead(self) -> None:
        """Begin to load the surfaces of the town, before a sensor needs them, if there is what draws or casts rays."""
        if self._world.town.opendrive and any(find_spec(package) for package in _NEEDING_SURFACES):
            self._surfaces.mesh(self._world.town)

    def prepare(self, sensor: Actor) -> None:
        """Load what a new sensor needs, if that takes time."""
        kind, town = SENSOR_KINDS.get(sensor.type_id), self._world.town
        if kind is not None and kind.image is not None:
            self._loading.append(self._images.prepare(town))
        elif kind is not None and kind.casts:
            self._loading.append(self._surfaces.rays(town))

    def is_ready(self, sensor: Actor) -> bool:
        """Return whether nothing is being loaded that a sensor needs."""
        kind = SENSOR_KINDS.get(sensor.type_id)
        return kind is None or not (kind.image or kind.casts) or not self._unloaded()

    async def loaded(self) -> None:
        """Wait until what sensors need is loaded, 1.5 s at most."""
        if loading := self._unloaded():
            await asyncio.wait([_end_of(loading)], timeout=_SPAWN_PATIENCE)

    def pending(self) -> list[asyncio.Future[Any]]:
        """Return what the next tick waits for, so that in synchronous mode no data are lost; not for longer than 0.8 s."""
        pending: list[asyncio.Future[Any]] = [*self._images.pending(), *self._streams.behind(self._feeds)]
        pending += [_end_of(loading)] if (loading := self._unloaded()) else []
        return [asyncio.ensure_future(asyncio.wait(pending, timeout=_TICK_PATIENCE))] if pending else []

    def _unloaded(self) -> list[Future[Any]]:
        self._loading = [work for work in self._loading if not work.done()]
        return self._loading

    def close(self) -> None:
        """End what draws images."""
        self._images.close()

    def _actor_record(self, release: Release, id: int | None, tag: int = Tag.WALLS) -> object:
        """See `FeedContext.actor_record`."""
        record = _static(tag) if id is None else actor_records.record(self._find(id), self._streams, release)
        return encoder(ActorRecord, release)(record)

    def queue_message(self, sensor: Actor, message: Any) -> None:
        """Have a V2X sensor send a client's message in the next tick."""
        self._radio.queue(sensor, message_bytes(message))

    def send(self, frame: int) -> None:
        """Send the data of the latest tick, the one of a frame, and close the streams of destroyed sensors."""
        for actor in self._world.events.spawned:
            if isinstance(actor, Sensor):
                self._start(actor)
        self._exchange_messages()
        subscribed = self._streams.subscribed
        for stream in self._feeds.keys() - set(subscribed):
            del self._feeds[stream]
        self._cameras.keep(self._feeds)
        for stream in subscribed:
            sensor = self._world.actors.get(actor_records.sensor_of(stream))
            kind = SENSOR_KINDS.get(sensor.type_id) if sensor is not None else None
            if sensor is not None and kind is not None:
                try:
                    self._send(stream, sensor, kind, frame)
                except Exception as error:  # the tick goes on for all others
                    _LOG.error("a %s has failed, and sends nothing more: %r", sensor.type_id, error)
                    self._feeds[stream] = lambda: ()  # a client that is cut off would subscribe again at once
            elif self._feeds.pop(stream, None) is not None:
                self._streams.close(stream)
        try:
            self._cameras.submit()
        except Exception as error:
            _LOG.error("images are lost: %r", error)

    def end_episode(self) -> None:
        """Close the streams of all sensors, which are destroyed: images that are still being drawn are not sent."""
        for stream in self._feeds:
            self._streams.close(stream)
        self._feeds.clear()

    def _start(self, sensor: Actor) -> None:
        """Begin to count the ticks of a new sensor."""
        if sensor not in self._first_ticks:
            self._first_ticks[sensor] = self._world.elapsed
            self._radio.add(sensor)

    def _exchange_messages(self) -> None:
        try:
            self._radio.exchange([sensor for sensor in self._radio.stations() if self._is_due(sensor)])
        except Exception as error:
            _LOG.error("V2X messages are lost: %r", error)

    def _send(self, stream: int, sensor: Actor, kind: SensorKind, frame: int) -> None:
        release = actor_records.release_of(stream)
        data = release.number(sensor.type_id)
        if data is None:
            return
        self._start(sensor)
        if stream not in self._feeds:
            record = partial(self._actor_record, release)
            context = FeedContext(release, self._radio.sent, self.instances, self.ray_scene, record)
            self._feeds[stream] = kind.make(sensor, context)
        if self._world.settings.no_rendering_mode and sensor.type_id.startswith(_CAMERA):
            return
        is_due = kind.by_event or self._is_due(sensor)
        if kind.image is not None:
            header = self._header(sensor, data, frame)
            self._cameras.take(stream, sensor, kind.image, header, is_due=is_due, has_events=kind.has_events)
        elif is_due:
            header = b""
            for payload in self._feeds[stream]():
                header = header or self._header(sensor, data, frame)
                self._streams.send(stream, header + payload)

    def _header(self, sensor: Actor, data: int, frame: int) -> bytes:
        return sensor_header(data, frame, self._world.elapsed, sensor.transform)

    def _is_due(self, sensor: Actor) -> bool:
        """Return whether a sensor ticks: in its first tick, and whenever a multiple of its interval has passed since."""
        interval, delta = number(sensor, "sensor_tick"), self._world.delta
        if interval <= delta:
            return True
        since = self._world.elapsed - self._first_ticks.get(sensor, self._world.elapsed) + _ROUNDING
        return floor(since / interval) > floor((since - delta) / interval)


def _static(tag: int) -> ActorRecord:
    """Return the record of what is no actor, as CARLA describes it: its id is 0, and its name begins with static."""
    description = ActorDescription(0, f"static.{_STATIC.get(Tag(tag), 'other')}", [])
    return ActorRecord(0, 0, description, BoxStruct(Location(), Vector()), Labels(bytes((tag,))), b"")


def _end_of(loading: list[Future[Any]]) -> asyncio.Future[Any]:
    """Return a future that is done when work in threads is, also if that has failed."""
    return asyncio.gather(*map(asyncio.wrap_future, loading), return_exceptions=True)
