"""Collision sensors: who has pushed their parents, and how hard."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgpack

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.sim.actors.actor import Actor


def collisions(sensor: Actor, tell: Tell) -> Feed:
    """A frame for each collision of the parent: both actors, and what the parent got, in N s."""

    def frames() -> Iterable[bytes]:
        for collision in sensor.context.collisions:
            if sensor.parent is not None and collision.actor1 == sensor.parent.id:
                impulse = collision.impulse
                actors = tell(collision.actor1), tell(collision.actor2)
                yield msgpack.packb([*actors, [impulse.x, impulse.y, impulse.z]], unicode_errors="surrogateescape")

    return frames
