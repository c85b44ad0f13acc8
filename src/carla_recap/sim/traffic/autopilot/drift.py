"""Ways from beside a lane onto its middle, without a kink: after a lane change, or when driving begins beside it.

The distance to the right of the middle is a polynomial of the fifth degree of the distance along the lane. It begins where
the vehicle is, in the direction that it has, and ends on the middle and along it, without curvature at either end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.drivers import Drivers

    Floats = NDArray[np.float64]

_DURATION: Final = 3.5  # s: how long a way back to the middle takes
_SLENDER: Final = 3.0  # so many times as long as wide it is at least
_SHORTEST: Final = 6.0  # m


def begin_drift(drivers: Drivers, row: int, along: float, speed: float, offset: float, slope: float) -> None:
    """Begin the way to the middle of the lane.

    Args:
        drivers: The drivers.
        row: Whose vehicle it is.
        along: How far the vehicle has come along its route, in m.
        speed: Of the vehicle, in m/s.
        offset: How far to the right of the middle it is, in m.
        slope: How much more to the right it comes for each m along the lane.
    """
    length = max(_DURATION * speed, _SLENDER * abs(offset), _SHORTEST)
    drivers.drift_from[row], drivers.drift_length[row] = along, length
    drivers.offset[row], drivers.slope[row] = offset, slope * length


def share(drivers: Drivers, along: Floats) -> Floats:
    """Which share of their ways to the middle lies behind the vehicles; from 1 on, a way is over."""
    done: Floats = (along - drivers.drift_from) / drivers.drift_length
    return done


def aside(offset: Floats, slope: Floats, done: Floats) -> Floats:
    """How far to the right of the middle the way is, in m.

    Args:
        offset: Where it begins, in m.
        slope: Where it leads to at first: in m to the right, if it were straight for all its length.
        done: Which share of it lies behind.
    """
    x = np.minimum(np.maximum(done, 0), 1)
    cube = x * x * x
    right: Floats = offset * (1 - cube * (10 - x * (15 - 6 * x))) + slope * (x - cube * (6 - x * (8 - 3 * x)))
    return right


def bend_aside(
    drivers: Drivers, along: Floats, ahead: Floats, places: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats, Floats]:
    """Move places on the middles of lanes to the ways of those who are not there yet.

    Args:
        drivers: The drivers.
        along: How far their vehicles have come, (vehicles,).
        ahead: How far ahead of them the places are, (vehicles, any).
        places: X, y and heading of the places, (vehicles, any) each; they are changed.
    """
    rows = np.flatnonzero(share(drivers, along) < 1)
    if len(rows):
        x, y, heading = places
        length, offset, slope = (column[rows, None] for column in (drivers.drift_length, drivers.offset, drivers.slope))
        done = (along[rows, None] + ahead[rows] - drivers.drift_from[rows, None]) / length
        right = aside(offset, slope, done)
        x[rows] -= right * np.sin(heading[rows])
        y[rows] += right * np.cos(heading[rows])
        heading[rows] += np.arctan(_change(offset, slope, done) / length)
    return places


def _change(offset: Floats, slope: Floats, done: Floats) -> Floats:
    """How fast `aside` changes, in m for the whole length."""
    x = np.minimum(np.maximum(done, 0), 1)
    square = x * x
    change: Floats = -30 * offset * square * (1 - x) ** 2 + slope * (1 - square * (18 - x * (32 - 15 * x)))
    return change
