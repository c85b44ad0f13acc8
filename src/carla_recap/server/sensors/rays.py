"""Rays of sensors in the world, and the feeds of those that cast them: lidars, radars and obstacle detectors."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.rays import OrientedBoxes, SurfaceHits
from carla_recap.replay.pose import MIRROR
from carla_recap.scene.materials import Tag
from carla_recap.sensors.beams import LidarBeams, LidarReturns, RadarBeams, detections
from carla_recap.server import actor_records
from carla_recap.server.sensors.feeds import axes, flag, interval, number, numbers, packed, row, warn_of
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.actors.props import Prop
from carla_recap.sim.episode import transforms
from carla_recap.sim.geometry import Vector

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.server.sensors.feeds import Feed, FeedContext
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Location
    from carla_recap.util.arrays import Floats


# horizontal angle in radians, channels; then the number of points of each channel
_LIDAR_HEADER: Final = struct.Struct("<fI")
_POINT: Final = np.dtype([("location", "<(3,)f4"), ("intensity", "<f4")])
_SEMANTIC_POINT: Final = np.dtype([("location", "<(3,)f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
_LEAST_COSINE: Final = 1e-3
_Obstacle = tuple[float, int | None, int]
"""A distance in m, the id of an actor, and the semantic tag of what is no actor."""


def rows(values: Iterable[Location | Vector]) -> Floats:
    """Return locations or directions as (n, 3)."""
    return np.array([(value.x, value.y, value.z) for value in values], np.float64).reshape(-1, 3)


def cast(sensor: Actor, context: FeedContext, rays: Floats, reach: float) -> SurfaceHits:
    """Return what rays from a sensor meet first, but for its carrier: the town and the models of actors.

    Rays are directions in the axes of the sensor, (n, 3), of length 1, and reach some m. Without Embree, and while the town
    is being loaded, they meet the boxes of actors alone.
    """
    transform, scene = sensor.transform, context.ray_scene()
    origin, directions = row(transform.location), rays @ axes(transform).T
    if scene is None:
        boxes = ActorBoxes(visible_actors(sensor))
        hits = boxes.cast(origin, directions, reach)
        ids = np.array([actor.id for actor in boxes.actors], np.int64)
        tags = np.array([actor_records.tag(actor) for actor in boxes.actors], np.int64)
        return SurfaceHits(hits.ray, ids[hits.box], hits.distance, hits.cosine, tags[hits.box])
    instances = context.instances()
    others = ~np.isin(instances.ids, [actor.id for actor in _own_actors(sensor)])
    return scene.cast(origin * MIRROR, directions * MIRROR, reach, instances.take(others))


def visible_actors(sensor: Actor) -> list[Actor]:
    """Return all actors with a box, but for the carrier of a sensor and what else is attached to that."""
    own = _own_actors(sensor)
    return [other for other in solid_actors(sensor.episode.actors.values()) if other not in own]


def solid_actors(actors: Iterable[Actor]) -> list[Actor]:
    """Return the vehicles, walkers and props that have a size."""
    return [actor for actor in actors if isinstance(actor, (MovingActor, Prop)) and actor.box.extent.length()]


def _own_actors(sensor: Actor) -> set[Actor]:
    """Return the carrier of a sensor and what else is attached to that."""
    carrier = sensor
    while carrier.parent is not None:
        carrier = carrier.parent
    own: set[Actor] = set()
    remaining = [carrier]
    while remaining:
        actor = remaining.pop()
        own.add(actor)
        remaining += actor.children
    return own


class ActorBoxes(OrientedBoxes):
    """The boxes of actors in the world, in three dimensions, enlarged by a margin in m on each side."""

    def __init__(self, actors: Sequence[Actor], margin: float = 0.0) -> None:
        self.actors = actors
        places = transforms(actors)
        centres = [place.transform(actor.box.location) for place, actor in zip(places, actors, strict=True)]
        axes = np.array([place.rotation.matrix() for place in places]).reshape(-1, 3, 3)
        super().__init__(rows(centres), axes, rows(actor.box.extent for actor in actors) + margin)


class Lidar:
    """A lidar in the world."""

    def __init__(self, sensor: Actor, context: FeedContext) -> None:
        self._sensor = sensor
        self._context = context
        self._beams = LidarBeams(numbers(sensor), warn_of(sensor))

    def sweep(self) -> tuple[SurfaceHits, Floats]:
        """Return the hits of the rays since the last frame, and the rays in the axes of the sensor."""
        rays = self._beams.rays(interval(self._sensor))
        return cast(self._sensor, self._context, rays, self._beams.reach), rays

    def frame(self, hits: SurfaceHits, rays: Floats, points: NDArray[np.void]) -> bytes:
        """Return the frame of some hits and their points."""
        counts = self._beams.points_of_channels(hits, rays).astype("<u4")
        return _LIDAR_HEADER.pack(self._beams.angle, self._beams.channels) + counts.tobytes() + points.tobytes()


def lidar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a lidar whose points have an intensity; some are dropped, as the attributes say."""
    own, returns = Lidar(sensor, context), LidarReturns(numbers(sensor))

    def frames() -> Iterable[bytes]:
        hits, rays = own.sweep()
        kept, intensity = returns.of(hits)
        points = np.zeros(len(kept.ray), _POINT)
        points["location"] = rays[kept.ray] * kept.distance[:, None]
        points["intensity"] = intensity
        yield own.frame(kept, rays, points)

    return frames


def semantic_lidar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a lidar whose points have the id and the semantic class of an actor."""
    own = Lidar(sensor, context)

    def frames() -> Iterable[bytes]:
        hits, rays = own.sweep()
        points = np.zeros(len(hits.ray), _SEMANTIC_POINT)
        points["location"] = rays[hits.ray] * hits.distance[:, None]
        points["cosine"] = hits.cosine
        points["actor"], points["tag"] = hits.actor, context.release.relabelled(hits.tag)
        yield own.frame(hits, rays, points)

    return frames


def radar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a radar: random rays in a cone; see `detections`."""
    beams = RadarBeams(numbers(sensor), warn_of(sensor))

    def frames() -> Iterable[bytes]:
        rays = beams.rays(interval(sensor))
        hits = cast(sensor, context, rays, beams.reach)
        velocities = _velocities(sensor, hits) - row(sensor.velocity)
        yield detections(hits, rays, axes(sensor.transform), velocities).astype("<f4").tobytes()

    return frames


def _velocities(sensor: Actor, hits: SurfaceHits) -> Floats:
    """Return the velocity of what each ray hits, in m/s, (hits, 3)."""
    met, index = np.unique(hits.actor, return_inverse=True)
    actors = [sensor.episode.actors.get(id) for id in met.tolist()]
    return rows(Vector() if actor is None else actor.velocity for actor in actors)[index]


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
            yield packed(context.actor_record(own), context.actor_record(other, tag), distance)

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
    hit = sensor.episode.plane.first_wall((start.x, start.y, start.z), end, radius)
    if hit is not None:
        body, share = hit
        owner = sensor.episode.owners.get(body)
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
