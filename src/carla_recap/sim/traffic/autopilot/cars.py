"""The vehicles that the autopilot drives, as it finds them at the beginning of a step."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]


class Cars(NamedTuple):
    """Vehicles in the order of their drivers; arrays with a value for each.

    Attributes:
        rows: Of `Vehicles`.
        x: Of the middle, in m.
        y: Of the middle.
        yaw: In radians.
        cos: Of the yaw.
        sin: Of the yaw.
        speed: Forward, in m/s, at least 0.
        half_length: In m.
        half_width: In m.
        wheelbase: In m.
    """

    rows: Integers
    x: Floats
    y: Floats
    yaw: Floats
    cos: Floats
    sin: Floats
    speed: Floats
    half_length: Floats
    half_width: Floats
    wheelbase: Floats


def find(vehicles: Vehicles, rows: Integers) -> Cars:
    """Some of the vehicles."""
    yaw = np.radians(vehicles.rotation[rows, 1])
    return Cars(
        rows,
        vehicles.position[rows, 0],
        vehicles.position[rows, 1],
        yaw,
        np.cos(yaw),
        np.sin(yaw),
        np.maximum(vehicles.speed[rows], 0),
        vehicles.half_length[rows],
        vehicles.half_width[rows],
        vehicles.wheelbase[rows],
    )
