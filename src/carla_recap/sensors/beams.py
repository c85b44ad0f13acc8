"""The rays of lidars and radars, and what they measure of what the rays hit.

Axes are CARLA's: x forward, y right, z up.
"""

from __future__ import annotations

from math import radians, tan, tau
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sensors.kinds import MOST_CHANNELS, WIDEST_RADAR
from carla_recap.sensors.noise import generator

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.rendering.rays import SurfaceHits
    from carla_recap.sensors.noise import Numbers
    from carla_recap.util.arrays import Floats, Integers

    Warn = Callable[[str], None]

MOST_LIDAR_RAYS: Final = 200_000
"""The greatest number of rays of a lidar in a frame."""
MOST_RADAR_RAYS: Final = 100_000
"""The greatest number of rays of a radar in a frame."""


class _Rays:
    """What the rays of lidars and radars share: how many there are in a frame.

    `warn` is called with a text when an attribute asks for more than is simulated, once for each attribute.
    """

    def __init__(self, numbers: Numbers, most: int, warn: Warn) -> None:
        self._numbers = numbers
        self._most = most
        self._warn = warn
        self._warned = False

    def _count(self, seconds: float) -> int:
        """Return the number of rays in a time in s."""
        rate = self._numbers("points_per_second")
        if rate * seconds > self._most and not self._warned:
            self._warned = True
            self._warn(f"points_per_second is {rate:.0f}: of {rate * seconds:.0f} rays in a frame, {self._most} are cast")
        return int(np.clip(rate * seconds, 0, self._most))


class LidarBeams(_Rays):
    """The rays of a lidar: they sweep around, channel by channel.

    Attributes:
        channels: The number of channels.
        angle: The horizontal angle at the end of the latest frame, in radians.
        reach: The length of the rays in m.
    """

    def __init__(self, numbers: Numbers, warn: Warn) -> None:
        super().__init__(numbers, MOST_LIDAR_RAYS, warn)
        channels = numbers("channels")
        if channels > MOST_CHANNELS:
            warn(f"channels is {channels:.0f}: {MOST_CHANNELS} are simulated")
        self.channels = int(np.clip(channels, 1, MOST_CHANNELS))
        self.angle = 0.0
        self.reach = numbers("range")
        self._pitches = np.radians(np.linspace(numbers("upper_fov"), numbers("lower_fov"), self.channels))
        self._sector = radians(numbers("horizontal_fov"))

    def rays(self, seconds: float) -> Floats:
        """Turn, and return the directions of the rays in the axes of the lidar, equally many of each channel, (n, 3)."""
        count = self._count(seconds) // self.channels
        turn = tau * self._numbers("rotation_frequency") * seconds
        begin, self.angle = self.angle, (self.angle + turn) % tau
        turned = (begin + turn * np.arange(count) / max(count, 1)) % tau
        yaws = turned / tau * self._sector - self._sector / 2
        rays = np.empty((self.channels, count, 3))
        level = np.cos(self._pitches)[:, None]
        rays[..., 0], rays[..., 1], rays[..., 2] = level * np.cos(yaws), level * np.sin(yaws), np.sin(self._pitches)[:, None]
        return rays.reshape(-1, 3)

    def points_of_channels(self, hits: SurfaceHits, rays: Floats) -> Integers:
        """Return how many hits of rays each channel has, (channels,)."""
        channel = hits.ray // max(len(rays) // self.channels, 1)
        return np.bincount(channel, minlength=self.channels)


class LidarReturns:
    """What comes back of the rays of a lidar: it has an intensity, and some is dropped at random."""

    def __init__(self, numbers: Numbers) -> None:
        self._random = generator(numbers("noise_seed"))
        self._attenuation, self._drop_rate = numbers("atmosphere_attenuation_rate"), numbers("dropoff_general_rate")
        self._limit, self._drop_at_zero = numbers("dropoff_intensity_limit"), numbers("dropoff_zero_intensity")
        self._deviation = abs(numbers("noise_stddev"))

    def of(self, hits: SurfaceHits) -> tuple[SurfaceHits, Floats]:
        """Return the hits that are not dropped, with noise in their distances, and their intensities from 0 to 1, (n,)."""
        intensity = np.exp(-self._attenuation * hits.distance)
        keep = self._random.random(len(intensity)) >= self._drop_rate
        if self._limit > 0 and self._drop_at_zero > 0:
            share = 1 - self._drop_at_zero + self._drop_at_zero / self._limit * intensity
            keep &= (intensity > self._limit) | (self._random.random(len(intensity)) < share)
        kept = hits.take(keep)
        if self._deviation:
            kept = kept._replace(distance=kept.distance + self._random.normal(0.0, self._deviation, len(kept.distance)))
        return kept, intensity[keep]


class RadarBeams(_Rays):
    """The rays of a radar, at random in a cone.

    Attributes:
        reach: The length of the rays in m.
    """

    def __init__(self, numbers: Numbers, warn: Warn) -> None:
        super().__init__(numbers, MOST_RADAR_RAYS, warn)
        self.reach = numbers("range")
        self._random = generator(numbers("noise_seed"))
        self._width, self._height = (
            tan(radians(min(numbers(f"{side}_fov"), WIDEST_RADAR)) / 2) for side in ("horizontal", "vertical")
        )

    def rays(self, seconds: float) -> Floats:
        """Return the directions of the rays in the axes of the radar.

        The time is since the frame before, in s; directions have the length 1, (n, 3).
        """
        count = self._count(seconds)
        radius, angle = self._random.random(count), self._random.random(count) * tau
        across, up = self._width * radius * np.cos(angle), self._height * radius * np.sin(angle)
        rays = np.stack((np.ones(count), across, up), axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays


def detections(hits: SurfaceHits, rays: Floats, axes: Floats, velocities: Floats) -> Floats:
    """Return what a radar measures of hits: velocity away in m/s, azimuth and altitude in radians, depth in m, (hits, 4).

    Rays are the directions of all, in the axes of the radar, whose columns point forward, to the right and upwards in the
    world; velocities, (hits, 3) in m/s, are relative to the radar, in the axes of the world.
    """
    directions = rays[hits.ray] @ axes.T
    away = (velocities * directions).sum(axis=1)
    x, y, z = rays[hits.ray].T
    return np.stack((away, np.arctan2(y, x), np.arcsin(z), hits.distance), axis=1)
