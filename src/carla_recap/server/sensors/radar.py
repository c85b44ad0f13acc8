"""Radars: random rays into a cone, and what comes back."""

from __future__ import annotations

from math import radians, tan, tau
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server.sensors.feed import number, random_numbers
from carla_recap.server.sensors.rays import Boxes, axes, row, rows, seen_by

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.sim.actors.actor import Actor

    Floats = NDArray[np.float64]

_MOST: Final = 100_000  # rays in a tick


def radar(sensor: Actor, tell: Tell) -> Feed:
    """For each detection: velocity in m/s (positive: it goes away), azimuth and altitude in radians, depth in m."""
    width, height = (tan(radians(min(number(sensor, f"{way}_fov"), 179.0)) / 2) for way in ("horizontal", "vertical"))
    reach = number(sensor, "range")
    random = random_numbers(sensor)

    def frames() -> Iterable[bytes]:
        count = int(np.clip(number(sensor, "points_per_second") * sensor.context.clock.delta, 0, _MOST))
        aside, angle = random.random(count), random.random(count) * tau
        own = np.stack((np.ones(count), width * aside * np.cos(angle), height * aside * np.sin(angle)), axis=1)
        own /= np.linalg.norm(own, axis=1, keepdims=True)
        yield _detections(sensor, own, reach).astype("<f4").tobytes()

    return frames


def _detections(sensor: Actor, rays: Floats, reach: float) -> Floats:
    place = sensor.transform
    boxes = Boxes(seen_by(sensor))
    directions = rays @ axes(place).T
    hits = boxes.cast(row(place.location), directions, reach)
    velocities = rows(actor.velocity for actor in boxes.actors)[hits.box]
    away = ((velocities - row(sensor.velocity)) * directions[hits.ray]).sum(axis=1)
    x, y, z = rays[hits.ray].T
    return np.stack((away, np.arctan2(y, x), np.arcsin(z), hits.distance), axis=1)
