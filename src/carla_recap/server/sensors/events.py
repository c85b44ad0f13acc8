"""Collision sensors and obstacle detectors: frames about two actors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgpack

from carla_recap.server.sensors.feed import flag, number
from carla_recap.server.sensors.rays import ActorBoxes, row, visible_actors
from carla_recap.sim.actors.moving import MovingActor

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.sim.actors.actor import Actor


def collisions(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a collision sensor: for each collision of the parent both actors, and its impulse in N s."""

    def frames() -> Iterable[bytes]:
        for collision in sensor.context.collisions:
            if sensor.parent is not None and collision.actor1 == sensor.parent.id:
                impulse = collision.impulse
                actors = context.actor_record(collision.actor1), context.actor_record(collision.actor2)
                yield _packed(*actors, [impulse.x, impulse.y, impulse.z])

    return frames


def obstacles(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of an obstacle detector: the carrier, the nearest obstacle ahead, and its distance in m, if any."""
    reach, radius = max(number(sensor, "distance"), 0.0), max(number(sensor, "hit_radius"), 0.0)
    only_dynamics = flag(sensor, "only_dynamics")

    def frames() -> Iterable[bytes]:
        found = list(_actors(sensor, reach, radius, only_dynamics=only_dynamics))
        if not only_dynamics:
            found += _barriers(sensor, reach, radius)
        if found:
            distance, other = min(found, key=lambda pair: pair[0])
            own = (sensor.parent or sensor).id
            yield _packed(context.actor_record(own), context.actor_record(other), distance)

    return frames


def _actors(sensor: Actor, reach: float, radius: float, *, only_dynamics: bool) -> Iterator[tuple[float, int | None]]:
    actors = [actor for actor in visible_actors(sensor) if not only_dynamics or isinstance(actor, MovingActor)]
    transform = sensor.transform
    hits = ActorBoxes(actors, margin=radius).cast(row(transform.location), row(transform.forward())[None], reach)
    for box, distance in zip(hits.box.tolist(), hits.distance.tolist(), strict=True):
        yield distance, actors[box].id


def _barriers(sensor: Actor, reach: float, radius: float) -> Iterator[tuple[float, int | None]]:
    start, ahead = sensor.transform.location, sensor.transform.forward()
    end = start.x + reach * ahead.x, start.y + reach * ahead.y, start.z + reach * ahead.z
    hit = sensor.context.plane.first_wall((start.x, start.y, start.z), end, radius)
    if hit is not None:
        body, share = hit
        owner = sensor.context.owner(body)
        yield share * reach, None if owner is None else owner.id


def _packed(*values: Any) -> bytes:
    packed: bytes = msgpack.packb(values, unicode_errors="surrogateescape")
    return packed
