"""The kinds of sensors, and what sends their data to the clients that listen; others cost nothing."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from enum import StrEnum
from math import floor
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from carla_recap.server import actor_records
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.structs import ActorDescription, ActorRecord, BoxStruct
from carla_recap.server.sensors import cameras, events, inertial, rays
from carla_recap.server.sensors.feed import number, silent
from carla_recap.server.sensors.v2x import RadioChannel, message_bytes, v2x
from carla_recap.server.streaming.snapshots import sensor_header
from carla_recap.sim.actors.actor import Sensor
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.server.actor_records import DestroyedActor
    from carla_recap.server.sensors.feed import Feed, MakeFeed, V2xMessage
    from carla_recap.server.streaming.streams import Streams
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.world import World

_LOG: Final = logging.getLogger("carla_recap.server")
_ROUNDING: Final = 1e-6  # s
_ENCODE: Final = encoder(ActorRecord)
_WALL_TAG: Final = 4
# A barrier is no actor; CARLA describes it as an actor whose id is 0 and whose name begins with static.
_WALL: Final = ActorRecord(
    0, 0, ActorDescription(0, "static.wall", []), BoxStruct(Location(), Vector()), bytes((_WALL_TAG,)), b""
)


class Support(StrEnum):
    """How far a kind of sensor is supported."""

    LIVE = "live"
    BLANK = "blank"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class SensorKind:
    """A kind of sensor.

    Attributes:
        number: The number of its data in CARLA's protocol.
        support: How far it is supported.
        what: A description of its data for the documentation.
        make: Makes the feeds of such sensors.
        by_event: Whether it sends what happens at once, whatever its `sensor_tick` is.
    """

    number: int
    support: Support
    what: str
    make: MakeFeed = silent
    by_event: bool = False


_COLLISIONS: Final = "each collision of its parent"
_POSITION: Final = "its position by the map's geo-reference; with noise"
_BOXES: Final = "the boxes of vehicles, walkers and props; neither the ground nor buildings"
_CAM: Final = "cooperative awareness messages of other vehicles in range"

SENSOR_KINDS: Final[Mapping[str, SensorKind]] = MappingProxyType(
    {
        "sensor.camera.cosmos_visualization": SensorKind(16, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.depth": SensorKind(1, Support.BLANK, "all is 1,000 m away", cameras.depth),
        "sensor.camera.dvs": SensorKind(3, Support.BLANK, "no events", cameras.events),
        "sensor.camera.instance_segmentation": SensorKind(15, Support.BLANK, "all is unlabelled", cameras.unlabelled),
        "sensor.camera.normals": SensorKind(2, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.optical_flow": SensorKind(8, Support.BLANK, "nothing moves", cameras.flow),
        "sensor.camera.rgb": SensorKind(13, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.semantic_segmentation": SensorKind(14, Support.BLANK, "all is unlabelled", cameras.unlabelled),
        "sensor.lidar.ray_cast": SensorKind(11, Support.LIVE, _BOXES, rays.lidar),
        "sensor.lidar.ray_cast_semantic": SensorKind(10, Support.LIVE, _BOXES, rays.semantic_lidar),
        "sensor.other.collision": SensorKind(0, Support.LIVE, _COLLISIONS, events.collisions, by_event=True),
        "sensor.other.gnss": SensorKind(4, Support.LIVE, _POSITION, inertial.gnss),
        "sensor.other.imu": SensorKind(5, Support.LIVE, "the motion of its parent; with noise", inertial.imu),
        "sensor.other.lane_invasion": SensorKind(6, Support.LIVE, "found by the client itself"),
        "sensor.other.obstacle": SensorKind(7, Support.LIVE, f"{_BOXES}, but barriers", events.obstacles),
        "sensor.other.radar": SensorKind(9, Support.LIVE, _BOXES, rays.radar),
        "sensor.other.rss": SensorKind(12, Support.SILENT, "needs a client that is built with RSS"),
        "sensor.other.v2x": SensorKind(20, Support.LIVE, _CAM, v2x),
        "sensor.other.v2x_custom": SensorKind(21, Support.LIVE, "messages that other such sensors in range `send`", v2x),
    }
)
"""All kinds of sensors by the names of their blueprints."""


class Sensors:
    """The sensors of a world.

    Args:
        world: The world.
        streams: The streams that their data goes to.
        find: Returns an actor by its id, even one that has been destroyed.
    """

    def __init__(self, world: World, streams: Streams, find: Callable[[int], Actor | DestroyedActor]) -> None:
        self._world = world
        self._streams = streams
        self._find = find
        self._feeds: dict[int, Feed] = {}
        self._first_ticks: WeakKeyDictionary[Actor, float] = WeakKeyDictionary()
        self._radio = RadioChannel()

    def actor_record(self, id: int | None) -> object:
        """Return the record of an actor for msgpack; None stands for a barrier, which is no actor."""
        return _ENCODE(_WALL if id is None else actor_records.record(self._find(id), self._streams))

    def messages(self, type_id: str, receiver: Actor) -> list[V2xMessage]:
        """Return the V2X messages of a kind of sensor in the latest tick, but for those of a receiver."""
        return self._radio.sent(type_id, receiver)

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
        for stream in subscribed:
            sensor = self._world.actors.get(actor_records.sensor_of(stream))
            kind = SENSOR_KINDS.get(sensor.type_id) if sensor is not None else None
            if sensor is not None and kind is not None:
                try:
                    self._send(stream, sensor, kind, frame)
                except Exception as error:  # the tick goes on for all others
                    _LOG.error("a %s has failed, and sends nothing more: %r", sensor.type_id, error)
                    self._feeds[stream] = silent(sensor, self)  # a client that is cut off would subscribe again at once
            elif self._feeds.pop(stream, None) is not None:
                self._streams.close(stream)

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
        self._start(sensor)
        if stream not in self._feeds:
            self._feeds[stream] = kind.make(sensor, self)
        if not kind.by_event and not self._is_due(sensor):
            return
        header = b""
        for payload in self._feeds[stream]():
            header = header or sensor_header(kind.number, frame, self._world.elapsed, sensor.transform)
            self._streams.send(stream, header + payload)

    def _is_due(self, sensor: Actor) -> bool:
        """Return whether a sensor ticks: in its first tick, and whenever a multiple of its interval has passed since."""
        interval, delta = number(sensor, "sensor_tick"), self._world.delta
        if interval <= delta:
            return True
        since = self._world.elapsed - self._first_ticks.get(sensor, self._world.elapsed) + _ROUNDING
        return floor(since / interval) > floor((since - delta) / interval)
