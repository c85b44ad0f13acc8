"""Sends what sensors notice to those who listen; a sensor to which nobody listens costs nothing."""

from __future__ import annotations

from math import floor
from typing import TYPE_CHECKING, Final

from carla_recap.server import actor_records
from carla_recap.server.sensors.cameras import check_size
from carla_recap.server.sensors.feed import number
from carla_recap.server.sensors.kinds import KINDS
from carla_recap.server.snapshot import sensor_header

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.server.host import Host
    from carla_recap.server.sensors.feed import Feed
    from carla_recap.server.sensors.kinds import Kind
    from carla_recap.sim.actors import Actor

_ROUNDING: Final = 1e-6  # s


class Sensors:
    """The sensors of a world.

    Args:
        host: Who serves it.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._feeds: dict[int, Feed] = {}

    @staticmethod
    def check(type_id: str, attributes: Mapping[str, str]) -> None:
        """Make sure that a sensor can be served.

        Raises:
            CallError: Its images would be too large.
        """
        if type_id.startswith("sensor.camera."):
            check_size(type_id, attributes)

    def send(self) -> None:
        """Send what was noticed in the latest tick; the streams of sensors that are gone end."""
        world, streams = self._host.world, self._host.streams
        subscribed = streams.subscribed
        for stream in self._feeds.keys() - set(subscribed):
            del self._feeds[stream]
        for stream in subscribed:
            sensor = world.actors.get(actor_records.sensor_of(stream))
            kind = KINDS.get(sensor.type_id) if sensor is not None else None
            if sensor is not None and kind is not None:
                self._send(stream, sensor, kind)
            elif self._feeds.pop(stream, None) is not None:
                streams.forget(stream)

    def _send(self, stream: int, sensor: Actor, kind: Kind) -> None:
        if stream not in self._feeds:
            self._feeds[stream] = kind.make(sensor, self._host)
        if not kind.by_event and not _is_due(sensor):
            return
        header = b""
        for payload in self._feeds[stream]():
            header = header or sensor_header(kind.number, self._host.frame, sensor.world.elapsed, sensor.transform)
            self._host.streams.send(stream, header + payload)


def _is_due(sensor: Actor) -> bool:
    """Whether a multiple of the interval of a sensor has passed in the latest tick: those of one interval tell together."""
    interval = number(sensor, "sensor_tick")
    if interval <= sensor.world.delta:
        return True
    now = sensor.world.elapsed + _ROUNDING
    return floor(now / interval) > floor((now - sensor.world.delta) / interval)
