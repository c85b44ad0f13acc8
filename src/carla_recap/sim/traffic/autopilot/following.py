"""How hard to accelerate or brake: the Intelligent Driver Model of Treiber, Hennecke and Helbing (2000).

A driver accelerates towards a wanted speed, and keeps a distance that grows with the own speed, and with how much faster
that is than what is ahead. Speeds are in m/s, accelerations in m/s².
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.drivers import Drivers

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

STANDING_GAP: Final = 2.0  # m
HARDEST: Final = -8.0  # m/s²: how hard drivers brake in an emergency
_SLOWING: Final = -3.0  # m/s²: how hard they brake because they are too fast
_URGENCY: Final = 2.0  # 1/s: how fast they correct a speed above the wanted one
_LEAST_GAP: Final = 0.1  # m


def towards(speed: Floats, wanted: Floats, drivers: Drivers) -> Floats:
    """The acceleration of drivers with nothing ahead, at a speed, towards the one that they want."""
    ratio = speed / np.maximum(wanted, 0.1)
    accelerating = drivers.acceleration * (1 - ratio**4)
    return np.where(ratio <= 1, accelerating, np.maximum(_URGENCY * (wanted - speed), _SLOWING))


def wanted_gap(speed: Floats, closing: Floats, drivers: Drivers, rows: Integers | slice = slice(None)) -> Floats:
    """The distance to what is ahead that drivers feel well with, in m.

    Args:
        speed: The own speed.
        closing: How much faster that is than what is ahead.
        drivers: The drivers.
        rows: Which of them.
    """
    return STANDING_GAP + np.maximum(speed * drivers.headway[rows] + speed * closing / (2 * drivers.comfort[rows]), 0)


def behind(gap: Floats, wanted: Floats, acceleration: Floats) -> Floats:
    """The acceleration that a gap allows a driver.

    Args:
        gap: In m.
        wanted: The gap that the driver wants, in m.
        acceleration: What the driver accelerates with at most.
    """
    return np.maximum(acceleration * (1 - (wanted / np.maximum(gap, _LEAST_GAP)) ** 2), HARDEST)
