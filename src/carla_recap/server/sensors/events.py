"""Collision sensors and obstacle detectors: frames about two actors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import msgpack

from carla_recap.replay.pose import MIRROR
from carla_recap.scene.materials import Tag
from carla_recap.server.sensors.feed import flag, number
from carla_recap.server.sensors.rays import ActorBoxes, row, visible_actors
from carla_recap.sim.actors.moving import MovingActor

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.sim.actors.actor import Actor

_LEAST_COSINE: Final = 1e-3
_Obstacle = tuple[float, int | None, int]
"""A distance in m, the id of an actor, and the semantic tag of what is no actor."""


def collisions(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a collision sensor: for each collision of the parent both actors, and its impulse in N s."""

    def frames() -> Iterable[bytes]:
        for collision in sensor.context.events.collisions:
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
            found += [*_barriers(sensor, reach, radius), *_surfaces(sensor, context, reach, radius)]
        if found:
            distance, other, tag = min(found, key=lambda obstacle: obstacle[0])
            own = (sensor.parent or sensor).id
            yield _packed(context.actor_record(own), context.actor_record(other, tag), distance)

    return frames


def _actors(sensor: Actor, reach: float, radius: float, *, only_dynamics: bool) -> Iterator[_Obstacle]:
    actors = [actor for actor in visible_actors(sensor) if not only_dynamics or isinstance(actor, MovingActor)]
    transform = sensor.transform
    hits = ActorBoxes(actors, margin=radius).cast(row(transform.location), row(transform.forward())[None], reach)
    for box, distance in zip(hits.box.tolist(), hits.distance.tolist(), strict=True):
        yield distance, actors[box].id, Tag.UNLABELLED


def _barriers(sensor: Actor, reach: float, radius: float) -> Iterator[_Obstacle]:
    start, ahead = sensor.transform.location, sensor.transform.forward()
    end = start.x + reach * ahead.x, start.y + reach * ahead.y, start.z + reach * ahead.z
    hit = sensor.context.plane.first_wall((start.x, start.y, start.z), end, radius)
    if hit is not None:
        body, share = hit
        owner = sensor.context.owner(body)
        yield share * reach, None if owner is None else owner.id, Tag.WALLS


def _surfaces(sensor: Actor, context: FeedContext, reach: float, radius: float) -> Iterator[_Obstacle]:
    """Yield the surface that a ball meets whose middle moves ahead, such as a road that rises, if there is one."""
    scene = context.ray_scene()
    if scene is None:
        return
    origin, ahead = row(sensor.transform.location) * MIRROR, row(sensor.transform.forward()) * MIRROR
    hits = scene.cast(origin, ahead[None], reach + radius)
    for distance, cosine, tag in zip(hits.distance.tolist(), hits.cosine.tolist(), hits.tag.tolist(), strict=True):
        until = max(distance - radius / max(cosine, _LEAST_COSINE), 0.0)
        if until <= reach:
            yield until, None, tag


def _packed(*values: Any) -> bytes:
    packed: bytes = msgpack.packb(values, unicode_errors="surrogateescape")
    return packed
