"""Sensors of a host and listeners of their frames, without a network."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from carla_recap.server.actor_records import stream_of
from carla_recap.server.host import Host
from carla_recap.server.streams import Subscriber
from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.geometry import Transform
from tests.sim.flat import at, flat_world

if TYPE_CHECKING:
    from carla_recap.sim.episode import Actor


HERE = Transform()


HEADER = struct.Struct("<QQd6f")


class Listener(Subscriber):
    """A subscriber of a sensor without a connection."""

    def __init__(self, host: Host, sensor: Actor) -> None:
        super().__init__(host.streams)
        self.frames: list[bytes] = []
        self.closed = False
        self.stream = stream_of(sensor)
        self.id = sensor.id
        host.streams.add(self.stream, self)

    def send(self, frame: bytes) -> None:
        self.frames.append(bytes(frame[4:]))

    def close(self) -> None:
        self.closed = True

    def take(self) -> list[tuple[tuple[Any, ...], bytes]]:
        """Return the headers and payloads since the last call."""
        frames, self.frames = self.frames, []
        return [(HEADER.unpack(frame[: HEADER.size]), frame[HEADER.size :]) for frame in frames]

    def payload(self) -> bytes:
        """Return the payload of the only frame."""
        ((_, payload),) = self.take()
        return payload


def served() -> Host:
    return Host(flat_world())


def vehicle(host: Host, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Vehicle:
    actor = host.world.spawn("vehicle.tesla.model3", at(x, y, yaw))
    assert isinstance(actor, Vehicle)
    return actor


def sensor(
    host: Host, kind: str, parent: Actor | None = None, place: Transform | None = None, **attributes: str
) -> Listener:
    actor = host.world.spawn(f"sensor.{kind}", place or Transform(), parent=parent, **attributes)
    return Listener(host, actor)
