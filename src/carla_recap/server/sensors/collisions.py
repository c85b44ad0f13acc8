"""Collision sensors: who has pushed their parents, and how hard."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgpack

from carla_recap.server.actor_records import record
from carla_recap.server.structs import ActorDescription, ActorRecord, BoundingBox
from carla_recap.server.wire import encoder
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.host import Host
    from carla_recap.server.sensors.feed import Feed
    from carla_recap.sim.actors import Actor

_ENCODE: Final = encoder(ActorRecord)
_WALL_TAG: Final = 4
# A barrier is no actor; CARLA tells what is none as an actor whose id is 0 and whose name begins with static.
_WALL: Final = ActorRecord(
    0, 0, ActorDescription(0, "static.wall", []), BoundingBox(Location(), Vector()), bytes((_WALL_TAG,)), b""
)


def told(host: Host, id: int | None) -> object:
    """An actor as clients are told of it in an event, for msgpack; None for a barrier, which is no actor."""
    return _ENCODE(_WALL if id is None else record(host.actor_or_ghost(id), host.streams))


def collisions(sensor: Actor, host: Host) -> Feed:
    """A frame for each collision of the parent: both actors, and what the parent got, in N s."""

    def frames() -> Iterable[bytes]:
        for collision in host.world.events.collisions:
            if sensor.parent is not None and collision.actor1 == sensor.parent.id:
                impulse = collision.impulse
                actors = told(host, collision.actor1), told(host, collision.actor2)
                yield msgpack.packb([*actors, [impulse.x, impulse.y, impulse.z]], unicode_errors="surrogateescape")

    return frames
