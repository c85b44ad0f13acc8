"""Sends what sensors notice to those who listen; a sensor to which nobody listens costs nothing."""

from __future__ import annotations

import logging
from math import floor
from typing import TYPE_CHECKING, Final

from carla_recap.server import actor_records
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.structs import ActorDescription, ActorRecord, BoxStruct
from carla_recap.server.sensors.feed import number, silent
from carla_recap.server.sensors.kinds import KINDS
from carla_recap.server.streaming.snapshots import sensor_header
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.actor_records import DestroyedActor
    from carla_recap.server.sensors.feed import Feed
    from carla_recap.server.sensors.kinds import Kind
    from carla_recap.server.streaming.streams import Streams
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.world import World

_LOG: Final = logging.getLogger("carla_recap.server")
_ROUNDING: Final = 1e-6  # s
_ENCODE: Final = encoder(ActorRecord)
_WALL_TAG: Final = 4
# A barrier is no actor; CARLA tells what is none as an actor whose id is 0 and whose name begins with static.
_WALL: Final = ActorRecord(
    0, 0, ActorDescription(0, "static.wall", []), BoxStruct(Location(), Vector()), bytes((_WALL_TAG,)), b""
)


class Sensors:
    """The sensors of a world.

    Args:
        world: The world.
        streams: Where their data goes.
        find: Finds an actor by its id, even one that has been destroyed.
    """

    def __init__(self, world: World, streams: Streams, find: Callable[[int], Actor | DestroyedActor]) -> None:
        self._world = world
        self._streams = streams
        self._find = find
        self._feeds: dict[int, Feed] = {}

    def send(self, frame: int) -> None:
        """Send what was noticed in the latest tick, the one of a frame; the streams of sensors that are gone end."""
        subscribed = self._streams.subscribed
        for stream in self._feeds.keys() - set(subscribed):
            del self._feeds[stream]
        for stream in subscribed:
            sensor = self._world.actors.get(actor_records.sensor_of(stream))
            kind = KINDS.get(sensor.type_id) if sensor is not None else None
            if sensor is not None and kind is not None:
                try:
                    self._send(stream, sensor, kind, frame)
                except Exception as error:  # it must cost nobody else the tick
                    _LOG.error("a %s has failed, and sends nothing more: %r", sensor.type_id, error)
                    self._feeds[stream] = silent(sensor, self._tell)  # whoever is cut off connects anew at once
            elif self._feeds.pop(stream, None) is not None:
                self._streams.close(stream)

    def _send(self, stream: int, sensor: Actor, kind: Kind, frame: int) -> None:
        if stream not in self._feeds:
            self._feeds[stream] = kind.make(sensor, self._tell)
        if not kind.by_event and not _is_due(sensor):
            return
        header = b""
        for payload in self._feeds[stream]():
            header = header or sensor_header(kind.number, frame, self._world.elapsed, sensor.transform)
            self._streams.send(stream, header + payload)

    def _tell(self, id: int | None) -> object:
        return _ENCODE(_WALL if id is None else actor_records.record(self._find(id), self._streams))


def _is_due(sensor: Actor) -> bool:
    """Whether a multiple of the interval of a sensor has passed in the latest tick: those of one interval tell together."""
    interval = number(sensor, "sensor_tick")
    if interval <= sensor.context.clock.delta:
        return True
    now = sensor.context.clock.elapsed + _ROUNDING
    return floor(now / interval) > floor((now - sensor.context.clock.delta) / interval)
