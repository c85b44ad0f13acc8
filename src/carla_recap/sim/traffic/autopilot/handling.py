"""From what drivers want to what their vehicles do: pedals, steering wheel and lights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot.drift import bend_aside, share
from carla_recap.sim.traffic.autopilot.pedals import pedals
from carla_recap.sim.traffic.autopilot.steering import PREVIEW, steer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.traffic.autopilot.cars import Cars
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes

    Floats = NDArray[np.float64]

BRAKE, RIGHT_BLINKER, LEFT_BLINKER = 8, 16, 32
"""Bits of CARLA's VehicleLightState."""
_OURS: Final = np.uint32(BRAKE | RIGHT_BLINKER | LEFT_BLINKER)
_INDICATING: Final = 30.0  # m before a turn
_CHANGING: Final = 1.0  # m: who goes so far aside indicates it
_JERK: Final = 3.0  # m/s³: how fast drivers press the throttle
_BRAKE_JERK: Final = 25.0  # m/s³: and the brake
_ROLLING: Final = -1.0  # m/s²: from harder braking, drivers take their foot away at once
_STANDING: Final = 0.15  # m/s
_START: Final = 0.25  # m/s²: who stands and wishes for less stays there
_HOLD: Final = 0.4  # of the brake, to stand


def press(cars: Cars, drivers: Drivers, vehicles: Vehicles, wish: Floats, delta: float) -> None:
    """Set throttle and brake, and note who stands.

    Args:
        cars: The vehicles.
        drivers: Their drivers.
        vehicles: All vehicles.
        wish: The accelerations that the drivers would like to have, in m/s².
        delta: The time since they did this before, in s.
    """
    least, most = drivers.wish - _BRAKE_JERK * delta, np.maximum(drivers.wish, _ROLLING) + _JERK * delta
    drivers.wish = np.minimum(np.maximum(wish, least), most)
    throttle, brake = pedals(vehicles, cars.rows, drivers.wish)
    standing = cars.speed < _STANDING
    drivers.stood = np.where(standing, drivers.stood + delta, 0.0)
    held = standing & (wish < _START)
    throttle[held], brake[held] = 0.0, _HOLD
    vehicles.throttle[cars.rows] = throttle
    vehicles.brake[cars.rows] = brake
    for flag in (vehicles.hand_brake, vehicles.reverse, vehicles.manual):
        flag[cars.rows] = False


def turn_wheel(cars: Cars, drivers: Drivers, routes: Routes, network: Network, vehicles: Vehicles) -> None:
    """Set the steering."""
    front = cars.wheelbase / 2
    ahead = np.stack((front, front + PREVIEW * cars.speed), axis=1)
    spot = network.spot(*routes.locate(ahead))
    x, y, heading = bend_aside(drivers, routes.along, ahead, network.places(spot))
    away_x, away_y = cars.x + front * cars.cos - x[:, 0], cars.y + front * cars.sin - y[:, 0]
    beside = away_y * np.cos(heading[:, 0]) - away_x * np.sin(heading[:, 0])
    angle = steer(cars.speed, cars.wheelbase, cars.half_length, beside, heading[:, 1] - cars.yaw, network.bend(spot)[:, 1])
    vehicles.steer[cars.rows] = np.clip(angle / vehicles.steer_limit[cars.rows], -1, 1)


def indicate(cars: Cars, drivers: Drivers, routes: Routes, network: Network, vehicles: Vehicles) -> None:
    """Switch brake lights and blinkers; other lights stay as they are."""
    turns = network.turn[routes.lanes[:, : routes.known]]
    near = (turns != 0) & (routes.starts[:, : routes.known] < (routes.along + cars.half_length + _INDICATING)[:, None])
    side = np.where(near.any(axis=1), turns[np.arange(len(turns)), near.argmax(axis=1)], 0)
    changing = (share(drivers, routes.along) < 1) & (np.abs(drivers.offset) > _CHANGING)
    side = np.where(changing, -np.sign(drivers.offset), side)
    lights = BRAKE * (vehicles.brake[cars.rows] > 0) + RIGHT_BLINKER * (side > 0) + LEFT_BLINKER * (side < 0)
    vehicles.light_state[cars.rows] = (vehicles.light_state[cars.rows] & ~_OURS) | lights.astype(np.uint32)
