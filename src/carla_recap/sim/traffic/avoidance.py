"""How walkers get past vehicles that are in their way: they wait for those that move, and walk around those that stand."""

from __future__ import annotations

from math import copysign
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.movers import Floats
    from carla_recap.sim.physics.vehicles import Vehicles

_LOOK_AHEAD: Final = 0.6  # m
_MARGIN: Final = 0.45  # m: between the middle of a walker and a vehicle
_STANDING: Final = 0.3  # m/s


def evade(places: Floats, ahead: Floats, turns: NDArray[np.int64], vehicles: Vehicles) -> Floats:
    """Where to walk so as not to walk into vehicles.

    Args:
        places: Of some walkers, (k, 2) in m.
        ahead: Where they want to walk, of length 1, (k, 2).
        turns: The way around vehicles that each has taken: 1 to the right, -1 to the left, 0 none yet, (k,). Those that
            take one are changed, and should stay with it until they are across the road.
        vehicles: All vehicles.

    Returns:
        Where they should walk, of length 1, or 0 to wait, (k, 2).
    """
    if not len(vehicles):
        return ahead
    yaw = np.radians(vehicles.yaw)
    along = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    across = np.stack((-along[:, 1], along[:, 0]), axis=1)
    size = np.stack((vehicles.half_length, vehicles.half_width), axis=1) + _MARGIN
    there = places[:, None] - vehicles.position[:, :2]
    local = np.stack(((there * along).sum(axis=2), (there * across).sum(axis=2)), axis=2)
    step = _LOOK_AHEAD * np.stack((ahead @ along.T, ahead @ across.T), axis=2)
    off, soon = ((np.abs(point) - size).max(axis=2) for point in (local, local + step))
    blocking = (soon < 0) & (soon < off)
    evading = ahead.copy()
    for walker in np.flatnonzero(blocking.any(axis=1)).tolist():
        vehicle = int(blocking[walker].argmax())
        evading[walker] = 0.0
        if abs(vehicles.speed[vehicle]) < _STANDING:
            (x, y), (length, width) = local[walker, vehicle].tolist(), size[vehicle].tolist()
            way, turns[walker] = _around(x, y, length, width, int(turns[walker]))
            evading[walker] = way[0] * along[vehicle] + way[1] * across[vehicle]
    return evading


def _around(x: float, y: float, length: float, width: float, turn: int) -> tuple[tuple[float, float], int]:
    """Which way to walk along a box, and the turn that is taken; at first, to the nearest corner."""
    if abs(y) - width > abs(x) - length:
        side = copysign(1, y)
        turn = turn or int(-side * copysign(1, x))
        return (-turn * side, 0.0), turn
    side = copysign(1, x)
    turn = turn or int(side * copysign(1, y))
    return (0.0, turn * side), turn
