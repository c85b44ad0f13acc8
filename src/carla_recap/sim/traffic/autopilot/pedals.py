"""Which pedals give an acceleration: the vehicle's own tables of forces, read backwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.physics.drivetrain import GRAVITY, SPEEDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_ROLLING: Final = 0.013  # rolling resistance, as a share of the weight
_COASTING: Final = -0.4  # m/s²: what a vehicle slows down by without any pedal, about


def pedals(vehicles: Vehicles, rows: Integers, acceleration: Floats) -> tuple[Floats, Floats]:
    """Throttle and brake, from 0 to 1 each, of which one is 0.

    Args:
        vehicles: All vehicles.
        rows: Those to drive.
        acceleration: What is wanted of each of these, in m/s².
    """
    speed, mass = np.maximum(vehicles.speed[rows], 0), vehicles.mass[rows]
    column = np.minimum((speed / SPEEDS[1]).astype(np.int64), len(SPEEDS) - 1)
    resistance = vehicles.air[rows] * speed * speed + mass * (GRAVITY * _ROLLING)
    coasting = mass * _COASTING - resistance
    force = mass * acceleration
    best = np.maximum(vehicles.best_force[rows, column], 1.0)
    throttle = np.clip((force + resistance) / best, 0, 1)
    brakes = np.maximum(vehicles.front_brake[rows] + vehicles.rear_brake[rows], 1.0)
    brake = np.clip((coasting - force) / brakes, 0, 1)
    slowing = acceleration < 0
    return np.where(slowing, np.where(force > coasting, throttle, 0), throttle), np.where(slowing, brake, 0)
