"""Rays of sensors, and those that cast them: lidars and radars."""

from __future__ import annotations

import struct
from math import radians, tan, tau
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.rays import OrientedBoxes, SurfaceHits
from carla_recap.server.actor_records import tag
from carla_recap.server.sensors.feed import generator, interval, number
from carla_recap.sim.actors.actor import Prop
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.geometry import Vector

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.geometry import Location, Transform

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

# horizontal angle in radians, channels; then the number of points of each channel
_LIDAR_HEADER: Final = struct.Struct("<fI")
_POINT: Final = np.dtype([("location", "<(3,)f4"), ("intensity", "<f4")])
_SEMANTIC_POINT: Final = np.dtype([("location", "<(3,)f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
_MOST_CHANNELS: Final = 512
_MOST_LIDAR_RAYS: Final = 200_000  # in a frame
_MOST_RADAR_RAYS: Final = 100_000
_WIDEST: Final = 179.0  # degrees
MIRROR: Final = np.array((1.0, -1.0, 1.0))
"""The factors of coordinates between CARLA's axes and right-handed ones."""


def axes(transform: Transform) -> Floats:
    """Return the axes of a transform, (3, 3); see `Rotation.matrix`."""
    return np.array(transform.rotation.matrix())


def row(value: Location | Vector) -> Floats:
    """Return a location or a direction as (3,)."""
    return np.array((value.x, value.y, value.z))


def rows(values: Iterable[Location | Vector]) -> Floats:
    """Return locations or directions as (n, 3)."""
    return np.array([(value.x, value.y, value.z) for value in values], np.float64).reshape(-1, 3)


def cast(sensor: Actor, context: FeedContext, rays: Floats, reach: float) -> SurfaceHits:
    """Return what rays from a sensor meet first, but for its carrier: the town and the models of actors.

    Without Embree, and while the town is being loaded, these are the boxes of actors alone.

    Args:
        sensor: The sensor.
        context: What is around it.
        rays: The directions in the axes of the sensor, (n, 3), of length 1.
        reach: The length of the rays in m.
    """
    transform, scene = sensor.transform, context.ray_scene()
    origin, directions = row(transform.location), rays @ axes(transform).T
    if scene is None:
        boxes = ActorBoxes(visible_actors(sensor))
        hits = boxes.cast(origin, directions, reach)
        ids = np.array([actor.id for actor in boxes.actors], np.int64)
        tags = np.array([tag(actor) for actor in boxes.actors], np.int64)
        return SurfaceHits(hits.ray, ids[hits.box], hits.distance, hits.cosine, tags[hits.box])
    instances = context.instances()
    others = ~np.isin(instances.ids, [actor.id for actor in _own_actors(sensor)])
    return scene.cast(origin * MIRROR, directions * MIRROR, reach, instances.take(others))


def visible_actors(sensor: Actor) -> list[Actor]:
    """Return all actors with a box, but for the carrier of a sensor and what else is attached to that."""
    own = _own_actors(sensor)
    return [other for other in solid_actors(sensor.context.actors.values()) if other not in own]


def solid_actors(actors: Iterable[Actor]) -> list[Actor]:
    """Return the vehicles, walkers and props that have a size."""
    return [actor for actor in actors if isinstance(actor, (MovingActor, Prop)) and actor.box.extent.length()]


def _own_actors(sensor: Actor) -> set[Actor]:
    """Return the carrier of a sensor and what else is attached to that."""
    carrier = sensor
    while carrier.parent is not None:
        carrier = carrier.parent
    return _with_children(carrier)


def _with_children(actor: Actor) -> set[Actor]:
    return {actor}.union(*map(_with_children, actor.children))


class ActorBoxes(OrientedBoxes):
    """The boxes of actors in the world, in three dimensions.

    Args:
        actors: The actors.
        margin: The width in m by which each box is enlarged on each side.

    Attributes:
        actors: The actors.
    """

    def __init__(self, actors: Sequence[Actor], margin: float = 0.0) -> None:
        self.actors = actors
        transforms = [actor.transform for actor in actors]
        centres = [transform.transform(actor.box.location) for transform, actor in zip(transforms, actors, strict=True)]
        axes = np.array([transform.rotation.matrix() for transform in transforms]).reshape(-1, 3, 3)
        super().__init__(rows(centres), axes, rows(actor.box.extent for actor in actors) + margin)


class Lidar:
    """The rays of a lidar: they sweep around, channel by channel.

    Args:
        sensor: The lidar.
        context: What is around it.
    """

    def __init__(self, sensor: Actor, context: FeedContext) -> None:
        self._sensor = sensor
        self._context = context
        self._channels = int(np.clip(number(sensor, "channels"), 1, _MOST_CHANNELS))
        self._pitches = np.radians(np.linspace(number(sensor, "upper_fov"), number(sensor, "lower_fov"), self._channels))
        self._sector = radians(number(sensor, "horizontal_fov"))
        self._angle = 0.0

    def sweep(self) -> tuple[SurfaceHits, Floats]:
        """Return the hits of the rays since the last frame, and the rays in the axes of the sensor."""
        rays = self._rays()
        return cast(self._sensor, self._context, rays, number(self._sensor, "range")), rays

    def frame(self, hits: SurfaceHits, rays: Floats, points: NDArray[np.void]) -> bytes:
        """Return the frame of some hits and their points."""
        channel = hits.ray // max(len(rays) // self._channels, 1)
        counts = np.bincount(channel, minlength=self._channels).astype("<u4")
        return _LIDAR_HEADER.pack(self._angle, self._channels) + counts.tobytes() + points.tobytes()

    def _rays(self) -> Floats:
        """Turn, and return the directions of the rays in the axes of the sensor, channel by channel."""
        seconds = interval(self._sensor)
        count = int(np.clip(number(self._sensor, "points_per_second") * seconds, 0, _MOST_LIDAR_RAYS)) // self._channels
        turn = tau * number(self._sensor, "rotation_frequency") * seconds
        begin, self._angle = self._angle, (self._angle + turn) % tau
        turned = (begin + turn * np.arange(count) / max(count, 1)) % tau
        yaws = turned / tau * self._sector - self._sector / 2
        pitch, yaw = (values.ravel() for values in np.meshgrid(self._pitches, yaws, indexing="ij"))
        return np.stack((np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)), axis=1)


def lidar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a lidar whose points have an intensity; some are dropped, as the attributes say."""
    beams, random = Lidar(sensor, context), generator(sensor)
    attenuation, drop_rate = number(sensor, "atmosphere_attenuation_rate"), number(sensor, "dropoff_general_rate")
    limit, drop_at_zero = number(sensor, "dropoff_intensity_limit"), number(sensor, "dropoff_zero_intensity")
    deviation = abs(number(sensor, "noise_stddev"))

    def frames() -> Iterable[bytes]:
        hits, rays = beams.sweep()
        intensity = np.exp(-attenuation * hits.distance)
        keep = random.random(len(intensity)) >= drop_rate
        if limit > 0 and drop_at_zero > 0:
            share = 1 - drop_at_zero + drop_at_zero / limit * intensity
            keep &= (intensity > limit) | (random.random(len(intensity)) < share)
        kept, points = hits.take(keep), np.zeros(int(keep.sum()), _POINT)
        distance = kept.distance + (random.normal(0.0, deviation, len(kept.distance)) if deviation else 0.0)
        points["location"] = rays[kept.ray] * distance[:, None]
        points["intensity"] = intensity[keep]
        yield beams.frame(kept, rays, points)

    return frames


def semantic_lidar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a lidar whose points have the id and the semantic class of an actor."""
    beams = Lidar(sensor, context)

    def frames() -> Iterable[bytes]:
        hits, rays = beams.sweep()
        points = np.zeros(len(hits.ray), _SEMANTIC_POINT)
        points["location"] = rays[hits.ray] * hits.distance[:, None]
        points["cosine"] = hits.cosine
        points["actor"], points["tag"] = hits.actor, hits.tag
        yield beams.frame(hits, rays, points)

    return frames


def radar(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a radar: random rays in a cone.

    A detection is a velocity in m/s, positive if the target moves away, azimuth and altitude in radians, and depth in m.
    """
    width, height = (tan(radians(min(number(sensor, f"{side}_fov"), _WIDEST)) / 2) for side in ("horizontal", "vertical"))
    reach, random = number(sensor, "range"), generator(sensor)

    def frames() -> Iterable[bytes]:
        count = int(np.clip(number(sensor, "points_per_second") * interval(sensor), 0, _MOST_RADAR_RAYS))
        radius, angle = random.random(count), random.random(count) * tau
        rays = np.stack((np.ones(count), width * radius * np.cos(angle), height * radius * np.sin(angle)), axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        yield _detections(sensor, context, rays, reach).astype("<f4").tobytes()

    return frames


def _detections(sensor: Actor, context: FeedContext, rays: Floats, reach: float) -> Floats:
    hits = cast(sensor, context, rays, reach)
    met, index = np.unique(hits.actor, return_inverse=True)
    actors = [sensor.context.actors.get(id) for id in met.tolist()]
    velocities = rows(Vector() if actor is None else actor.velocity for actor in actors)[index]
    directions = rays[hits.ray] @ axes(sensor.transform).T
    away = ((velocities - row(sensor.velocity)) * directions).sum(axis=1)
    x, y, z = rays[hits.ray].T
    return np.stack((away, np.arctan2(y, x), np.arcsin(z), hits.distance), axis=1)
