"""Obstacle detectors: what is next ahead, within a tube."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgpack
import pymunk

from carla_recap.server.sensors.feed import flag, number
from carla_recap.server.sensors.rays import Boxes, row, seen_by
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.physics.plane import WALL

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.sim.actors.actor import Actor

_WALLS: Final = pymunk.ShapeFilter(mask=WALL)


def obstacles(sensor: Actor, tell: Tell) -> Feed:
    """A frame where there is an obstacle: who carries the sensor, the obstacle, and how far away it is, in m."""
    reach, radius = max(number(sensor, "distance"), 0.0), max(number(sensor, "hit_radius"), 0.0)
    only_dynamics = flag(sensor, "only_dynamics")

    def frames() -> Iterable[bytes]:
        found = list(_actors(sensor, reach, radius, only_dynamics=only_dynamics))
        if not only_dynamics:
            found += _barriers(sensor, reach, radius)
        if found:
            distance, other = min(found, key=lambda pair: pair[0])
            own = (sensor.parent or sensor).id
            yield msgpack.packb([tell(own), tell(other), distance], unicode_errors="surrogateescape")

    return frames


def _actors(sensor: Actor, reach: float, radius: float, *, only_dynamics: bool) -> Iterator[tuple[float, int | None]]:
    actors = [actor for actor in seen_by(sensor) if not only_dynamics or isinstance(actor, MovingActor)]
    boxes = Boxes(actors, margin=radius)
    place = sensor.transform
    hits = boxes.cast(row(place.location), row(place.forward())[None], reach)
    for box, distance in zip(hits.box.tolist(), hits.distance.tolist(), strict=True):
        yield distance, actors[box].id


def _barriers(sensor: Actor, reach: float, radius: float) -> Iterator[tuple[float, int | None]]:
    context, place, ahead = sensor.context, sensor.transform.location, sensor.transform.forward()
    end = place.x + reach * ahead.x, place.y + reach * ahead.y
    hit = context.plane.space.segment_query_first((place.x, place.y), end, radius, _WALLS)
    if hit is not None and hit.shape is not None and hit.shape.body is not None:
        owner = context.owner(hit.shape.body.id)
        yield hit.alpha * reach, None if owner is None else owner.id
