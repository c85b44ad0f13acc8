"""Lidars: rays around and around, and where they hit."""

from __future__ import annotations

import struct
from math import radians, tau
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server.actor_records import tag
from carla_recap.server.sensors.feed import number
from carla_recap.server.sensors.rays import Boxes, axes, row, seen_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.server.sensors.rays import Hits
    from carla_recap.sim.actors.actor import Actor

    Floats = NDArray[np.float64]
    Points = Callable[[Actor, Boxes, Hits, Floats], NDArray[np.void]]

# horizontal angle in radians, channels; then how many points each channel has
_HEADER: Final = struct.Struct("<fI")
_POINT: Final = np.dtype([("place", "<(3,)f4"), ("intensity", "<f4")])
_SEMANTIC_POINT: Final = np.dtype([("place", "<(3,)f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
_MOST_CHANNELS: Final = 512
_MOST: Final = 200_000  # rays in a tick


class _Lidar:
    """The feed of a lidar.

    Args:
        sensor: The lidar.
        points: What makes the points of hits, which are given in m, in the axes of the sensor, too.
    """

    def __init__(self, sensor: Actor, points: Points) -> None:
        self._sensor = sensor
        self._points = points
        self._channels = int(np.clip(number(sensor, "channels"), 1, _MOST_CHANNELS))
        self._heights = np.radians(np.linspace(number(sensor, "upper_fov"), number(sensor, "lower_fov"), self._channels))
        self._around = radians(number(sensor, "horizontal_fov"))
        self._angle = 0.0

    def __call__(self) -> Iterable[bytes]:
        """What the lidar sees in a tick: one frame."""
        sensor, yaws = self._sensor, self._sweep()
        rays = _directions(self._heights, yaws)
        place, boxes = sensor.transform, Boxes(seen_by(sensor))
        hits = boxes.cast(row(place.location), rays @ axes(place).T, number(sensor, "range"))
        counts = np.bincount(hits.ray // max(len(yaws), 1), minlength=self._channels).astype("<u4")
        points = self._points(sensor, boxes, hits, rays[hits.ray] * hits.distance[:, None])
        yield _HEADER.pack(self._angle, self._channels) + counts.tobytes() + points.tobytes()

    def _sweep(self) -> Floats:
        """Turn for a tick; returns the yaws of the rays of each channel, in radians."""
        sensor = self._sensor
        seconds = max(sensor.context.clock.delta, number(sensor, "sensor_tick"))
        count = int(np.clip(number(sensor, "points_per_second") * seconds, 0, _MOST)) // self._channels
        turn = tau * number(sensor, "rotation_frequency") * seconds
        begin, self._angle = self._angle, (self._angle + turn) % tau
        turned = (begin + turn * np.arange(count) / max(count, 1)) % tau
        yaws: Floats = turned / tau * self._around - self._around / 2
        return yaws


def plain(sensor: Actor, tell: Tell) -> Feed:
    """A lidar whose points have an intensity."""
    return _Lidar(sensor, _with_intensity)


def semantic(sensor: Actor, tell: Tell) -> Feed:
    """A lidar whose points tell of whom they are."""
    return _Lidar(sensor, _with_owner)


def _directions(heights: Floats, yaws: Floats) -> Floats:
    """Rays in the axes of the sensor, channel by channel."""
    up, around = (values.ravel() for values in np.meshgrid(heights, yaws, indexing="ij"))
    return np.stack((np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), axis=1)


def _with_intensity(sensor: Actor, boxes: Boxes, hits: Hits, places: Floats) -> NDArray[np.void]:
    rows = np.zeros(len(places), _POINT)
    rows["place"] = places
    rows["intensity"] = np.exp(-number(sensor, "atmosphere_attenuation_rate") * hits.distance)
    return rows


def _with_owner(sensor: Actor, boxes: Boxes, hits: Hits, places: Floats) -> NDArray[np.void]:
    rows = np.zeros(len(places), _SEMANTIC_POINT)
    rows["place"] = places
    rows["cosine"] = hits.cosine
    rows["actor"] = np.array([actor.id for actor in boxes.actors], np.uint32)[hits.box]
    rows["tag"] = np.array([tag(actor) for actor in boxes.actors], np.uint32)[hits.box]
    return rows
