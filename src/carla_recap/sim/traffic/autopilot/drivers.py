"""The drivers of the autopilot, and the vehicles that they drive, as arrays with a value for each driver.

Drivers follow what is ahead by the Intelligent Driver Model of Treiber, Hennecke and Helbing (2000): a driver accelerates
towards a desired speed, and keeps a gap that grows with the own speed, and with the difference to the speed ahead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.sim.columns import StructOfArrays, column

if TYPE_CHECKING:
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.util.arrays import Booleans, Floats, Integers


NONE: Final = -1
"""The index that stands for no lane, junction, signal or driver."""
STANDING_GAP: Final = 2.0  # m between standing vehicles
EMERGENCY_BRAKING: Final = -8.0  # m/s²
_LEAST_GAP: Final = 0.1  # m


class DrivenVehicles(NamedTuple):
    """The state of the driven vehicles at the beginning of a step, in the order of their drivers.

    `rows` are those in `Vehicles`; angles are in radians, and speeds in m/s, at least 0.
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

    @classmethod
    def of(cls, vehicles: Vehicles, rows: Integers) -> DrivenVehicles:
        """Return the state of some rows of `Vehicles`."""
        yaw = np.radians(vehicles.rotation[rows, 1])
        return cls(
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


class Drivers(StructOfArrays):
    """The drivers, one for each vehicle that the autopilot drives; positions are along its route, in m."""

    id: Integers = column(np.int64(0))  # the id of the vehicle
    speed_factor: Floats = column(1.0)  # the share of the speed limit that the driver drives
    headway: Floats = column(1.5)  # the time gap that the driver keeps, in s
    max_acceleration: Floats = column(2.0)  # the greatest acceleration of the driver, in m/s²
    comfort: Floats = column(2.0)  # the geometric mean of that and of the driver's comfortable braking, in m/s²
    acceleration: Floats = column(0.0)  # the acceleration that was last asked of the vehicle, in m/s²
    standing_time: Floats = column(0.0)  # how long the vehicle has been standing, in s
    off_road: Booleans = column(False)  # whether no lane is near enough to drive on
    returning: Booleans = column(False)  # whether the vehicle has to return to the road
    lateral_offset: Floats = column(0.0)  # the offset of the vehicle to the right of the lane's centre, in m
    transition_start: Floats = column(0.0)  # the position at which the transition to the lane's centre begins
    transition_length: Floats = column(1.0)  # the length of that transition
    transition_offset: Floats = column(0.0)  # the lateral offset at its start, in m
    transition_slope: Floats = column(0.0)  # the slope at its start, see `routes.lateral_offset`
    stop_line: Floats = column(np.inf)  # the position of the next stop line; infinity if there is none
    lights: Integers = column(np.int64(NONE))  # the number of the group of lights in force there
    must_stop: Booleans = column(False)  # whether there is a stop sign at which the vehicle has not stopped yet
    has_reservation: Booleans = column(False)  # whether the vehicle may pass the stop line
    waiting_since: Floats = column(np.inf)  # the time at which it first asked for that, in s; infinity if it has not
    junction_end: Floats = column(np.inf)
    """The position that the rear end must pass to leave the junction; infinity outside of junctions."""

    def add(self, id: int, random: np.random.Generator) -> None:
        """Add a driver of random characteristics for a vehicle."""
        acceleration, braking = random.uniform(1.6, 2.4), random.uniform(2.5, 3.5)
        self.append_row(
            id=id,
            speed_factor=random.uniform(0.85, 1.05),
            headway=random.uniform(1.1, 1.8),
            max_acceleration=acceleration,
            comfort=(acceleration * braking) ** 0.5,
        )

    def select(self, rows: Integers) -> None:
        """Keep some of the drivers, in a new order."""
        for name in self.COLUMNS:
            setattr(self, name, getattr(self, name)[rows])
        self.count = len(rows)

    def desired_gap(self, speed: Floats, closing_speed: Floats, rows: Integers | slice = slice(None)) -> Floats:
        """Return the gap in m to an obstacle that drivers desire, by their speed, and that at which they close, in m/s."""
        dynamic = speed * self.headway[rows] + speed * closing_speed / (2 * self.comfort[rows])
        return STANDING_GAP + np.maximum(dynamic, 0)

    def following_acceleration(self, gap: Floats, desired_gap: Floats, rows: Integers | slice = slice(None)) -> Floats:
        """Return the acceleration that a gap allows drivers, in m/s²; gaps are in m."""
        share = desired_gap / np.maximum(gap, _LEAST_GAP)
        return np.maximum(self.max_acceleration[rows] * (1 - share**2), EMERGENCY_BRAKING)
