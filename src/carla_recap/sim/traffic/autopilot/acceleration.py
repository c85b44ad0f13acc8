"""The acceleration that drivers desire: for speed limits, curves, obstacles and stop lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot.drivers import EMERGENCY_BRAKING, STANDING_GAP
from carla_recap.sim.traffic.autopilot.lane_changes import transition_progress
from carla_recap.sim.traffic.autopilot.routes import CURVE_BRAKING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
    from carla_recap.sim.traffic.autopilot.perception import Perception
    from carla_recap.sim.traffic.autopilot.routes import LaneNetwork, Routes

    Floats = NDArray[np.float64]

BEFORE_LINE: Final = 0.8  # m between a stop line and a vehicle that stops there
_SLOWING: Final = -3.0  # m/s²: the hardest braking because of a speed above the desired one
_SPEED_GAIN: Final = 2.0  # 1/s: how fast a speed above the desired one is corrected
_FORESIGHT: Final = 0.6  # s ahead, where a driver respects the safe speed
_RETURN_SPEED: Final = 3.0  # m/s: the speed of vehicles that return to the road
_OVERSHOOT: Final = -0.5  # m: vehicles farther beyond their stop line brake as in an emergency
_OFF_ROAD_BRAKING: Final = -3.0  # m/s²: the braking of vehicles that have no lane


def desired_acceleration(
    cars: DrivenVehicles, perception: Perception, drivers: Drivers, routes: Routes, network: LaneNetwork
) -> Floats:
    """Return the acceleration that every driver desires, in m/s²."""
    desired_speed = _desired_speed(cars, drivers, routes, network)
    desired = np.minimum(_free_acceleration(cars.speed, desired_speed, drivers), perception.acceleration_limit)
    stop = np.minimum(
        np.where(drivers.has_reservation, np.inf, drivers.stop_line), np.where(routes.dead_end, routes.ends, np.inf)
    )
    gap = stop - routes.position - cars.half_length - BEFORE_LINE
    stopping = drivers.following_acceleration(gap + STANDING_GAP, drivers.desired_gap(cars.speed, cars.speed))
    desired = np.minimum(desired, np.where(gap < _OVERSHOOT, EMERGENCY_BRAKING, stopping))
    return np.where(drivers.off_road, _OFF_ROAD_BRAKING, desired)


def _free_acceleration(speed: Floats, desired_speed: Floats, drivers: Drivers) -> Floats:
    """Return the acceleration of drivers with nothing ahead, in m/s²."""
    ratio = speed / np.maximum(desired_speed, 0.1)
    accelerating = drivers.max_acceleration * (1 - ratio**4)
    return np.where(ratio <= 1, accelerating, np.maximum(_SPEED_GAIN * (desired_speed - speed), _SLOWING))


def _desired_speed(cars: DrivenVehicles, drivers: Drivers, routes: Routes, network: LaneNetwork) -> Floats:
    """Return the speed that limits and curves allow, here and for what lies ahead, in m/s."""
    soon = _FORESIGHT * cars.speed
    lanes = routes.lanes[:, : routes.known]
    limit = network.limit[lanes] * drivers.speed_factor[:, None]
    entry = np.minimum(limit, network.entry_speed[lanes])
    entry[:, 0] = limit[:, 0]
    to_start = np.maximum(routes.starts[:, : routes.known] - (routes.position + soon)[:, None], 0)
    ahead: Floats = np.sqrt((entry * entry + 2 * CURVE_BRAKING * to_start).min(axis=1))
    lane, s = routes.locate(soon[:, None])
    desired: Floats = np.minimum(ahead, network.safe_speed(network.points(lane[:, 0], s[:, 0])))
    returning = drivers.returning & (transition_progress(drivers, routes.position) < 1)
    return np.minimum(desired, np.where(returning, _RETURN_SPEED, np.inf))
