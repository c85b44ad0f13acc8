"""The acceleration that drivers desire, and the controls that follow from it and from routes: pedals, steering, lights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.lamps import BRAKE, BRAKING, LEFT_BLINKER, RIGHT_BLINKER
from carla_recap.sim.physics.vehicles import same_everywhere
from carla_recap.sim.traffic.autopilot.drivers import EMERGENCY_BRAKING, STANDING_GAP
from carla_recap.sim.traffic.autopilot.routes import CURVE_BRAKING, shift_poses, transition_progress

if TYPE_CHECKING:
    from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
    from carla_recap.sim.traffic.autopilot.perception import Perception
    from carla_recap.sim.traffic.autopilot.routes import AutopilotState
    from carla_recap.util.arrays import Floats


_OWN_LIGHTS: Final = np.uint32(BRAKE | RIGHT_BLINKER | LEFT_BLINKER)
_INDICATION: Final = 30.0  # m before a turn
_LANE_CHANGE: Final = 1.0  # m: transitions from a greater lateral offset are indicated
_JERK: Final = 3.0  # m/s³ of the throttle
_BRAKE_JERK: Final = 25.0  # m/s³
_RELEASE: Final = -1.0  # m/s²: from harder braking, drivers release the brake at once
_RESUMED: Final = 0.2  # throttle: drivers who brake press no less against the drag of an engine, which shifts change
_STANDING: Final = 0.15  # m/s
_START: Final = 0.25  # m/s²: standing vehicles start for no smaller desired acceleration
_HOLD: Final = 0.4  # brake of standing vehicles
_PREVIEW: Final = 0.12  # s: the delay of the front wheels
_CROSS_TRACK_GAIN: Final = 1.5  # 1/s
_SOFTENING: Final = 1.0  # m/s: keeps the steering calm at low speed
_MAX_SWING: Final = 0.8  # m that the front axle swings out at most, so that the rear does not cut the curve
_LONG_WHEELBASE: Final = 3.1  # m, from which on a vehicle counts as long
_LATERAL_ACCELERATION: Final = 3.0  # m/s² at most, to return to the path
BEFORE_LINE: Final = 0.8  # m between a stop line and a vehicle that stops there
_SLOWING: Final = -3.0  # m/s²: the hardest braking because of a speed above the desired one
_SPEED_GAIN: Final = 2.0  # 1/s: how fast a speed above the desired one is corrected
_FORESIGHT: Final = 0.6  # s ahead, where a driver respects the safe speed
_RETURN_SPEED: Final = 3.0  # m/s: the speed of vehicles that return to the road
_OVERSHOOT: Final = -0.5  # m: vehicles farther beyond their stop line brake as in an emergency
_OFF_ROAD_BRAKING: Final = -3.0  # m/s²: the braking of vehicles that have no lane


def set_pedals(state: AutopilotState, desired: Floats, delta: float) -> None:
    """Set throttle and brake for desired accelerations in m/s², and count how long, in s, vehicles have been standing."""
    cars, drivers, vehicles = state.cars, state.drivers, state.vehicles
    least = drivers.acceleration - _BRAKE_JERK * delta
    most = np.maximum(drivers.acceleration, _RELEASE) + _JERK * delta
    drivers.acceleration = np.minimum(np.maximum(desired, least), most)
    throttle, brake = vehicles.pedals(cars.rows, drivers.acceleration)
    throttle[(vehicles.throttle[cars.rows] == 0) & (throttle < _RESUMED) & (drivers.acceleration < 0)] = 0.0
    standing = cars.speed < _STANDING
    drivers.standing_time = np.where(standing, drivers.standing_time + delta, 0.0)
    held = standing & (desired < _START)
    throttle[held], brake[held] = 0.0, _HOLD
    vehicles.throttle[cars.rows] = throttle
    vehicles.brake[cars.rows] = brake
    for flag in (vehicles.hand_brake, vehicles.reverse, vehicles.manual):
        flag[cars.rows] = False


def set_steering(state: AutopilotState) -> None:
    """Steer the driven vehicles along their routes."""
    cars, drivers, routes, network, vehicles = state
    front = cars.wheelbase / 2
    ahead = np.array((front, front + _PREVIEW * cars.speed)).T
    points = network.points(*routes.locate(ahead))
    x, y, heading = shift_poses(drivers, routes.position, ahead, network.poses(points))
    away_x, away_y = cars.x + front * cars.cos - x[:, 0], cars.y + front * cars.sin - y[:, 0]
    offset = away_y * np.cos(heading[:, 0]) - away_x * np.sin(heading[:, 0])
    angle = _steering_angle(cars, offset, heading[:, 1] - cars.yaw, network.curvature[points[0]][:, 1])
    vehicles.steer[cars.rows] = same_everywhere(np.clip(angle / vehicles.steer_limit[cars.rows], -1, 1))


def _steering_angle(cars: DrivenVehicles, offset: Floats, heading_error: Floats, curvature: Floats) -> Floats:
    """Return the angle of the front wheels in radians, positive to the right.

    This is the control law of Stanley (Hoffmann and others, 2007). In a curve, the middle of a car runs on the path. A long
    vehicle takes as much room on one side of the path as on the other. The offset of the front axle in m, and the curvature
    in 1/m are positive to the right; the error is the heading of the path less that of the vehicle, in radians.
    """
    # If the rear axle runs at a radius of r, a point at a distance of d ahead of it runs at about r + d² / 2r.
    speed, wheelbase = cars.speed, cars.wheelbase
    axle, middle, bumper = wheelbase**2 / 2, wheelbase**2 / 8, (wheelbase / 2 + cars.half_length) ** 2 / 2
    swing = -curvature * (axle - np.where(wheelbase < _LONG_WHEELBASE, middle, bumper / 2))
    swing = np.minimum(np.maximum(swing, -_MAX_SWING), _MAX_SWING)
    correction = np.arctan2(_CROSS_TRACK_GAIN * (offset - swing), np.abs(speed) + _SOFTENING)
    most = np.arctan(_LATERAL_ACCELERATION * wheelbase / np.maximum(speed * speed, 1.0))
    angle: Floats = wrap_angle(heading_error) - np.minimum(np.maximum(correction, -most), most)
    return angle


def wrap_angle(angle: Floats) -> Floats:
    """Return angles in radians as equal ones within ±π."""
    wrapped: Floats = (angle + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def set_lights(state: AutopilotState) -> None:
    """Switch brake lights and blinkers; other lights stay as they are."""
    cars, drivers, routes, network, vehicles = state
    turns = network.turn[routes.lanes[:, : routes.known]]
    near = (turns != 0) & (routes.starts[:, : routes.known] < (routes.position + cars.half_length + _INDICATION)[:, None])
    side = np.where(near.any(axis=1), turns[np.arange(len(turns)), near.argmax(axis=1)], 0)
    changing = (transition_progress(drivers, routes.position) < 1) & (np.abs(drivers.transition_offset) > _LANE_CHANGE)
    side = np.where(changing, -np.sign(drivers.transition_offset), side)
    lights = BRAKE * (vehicles.brake[cars.rows] > BRAKING) + RIGHT_BLINKER * (side > 0) + LEFT_BLINKER * (side < 0)
    vehicles.light_state[cars.rows] = (vehicles.light_state[cars.rows] & ~_OWN_LIGHTS) | lights.astype(np.uint32)


def desired_acceleration(state: AutopilotState, perception: Perception) -> Floats:
    """Return the acceleration that every driver desires, in m/s²."""
    cars, drivers, routes = state.cars, state.drivers, state.routes
    desired_speed = _desired_speed(state)
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


def _desired_speed(state: AutopilotState) -> Floats:
    """Return the speed that limits and curves allow, here and for what lies ahead, in m/s."""
    cars, drivers, routes, network, _ = state
    soon = _FORESIGHT * cars.speed
    lanes = routes.lanes[:, : routes.known]
    entry = np.minimum(network.entry_limit[lanes] * drivers.speed_factor[:, None], network.entry_speed[lanes])
    entry[:, 0] = network.limit(lanes[:, 0], routes.position - routes.starts[:, 0]) * drivers.speed_factor
    to_start = np.maximum(routes.starts[:, : routes.known] - (routes.position + soon)[:, None], 0)
    ahead: Floats = np.sqrt((entry * entry + 2 * CURVE_BRAKING * to_start).min(axis=1))
    lane, s = routes.locate(soon[:, None])
    desired: Floats = np.minimum(ahead, network.safe_speed(network.points(lane[:, 0], s[:, 0])))
    returning = drivers.returning & (transition_progress(drivers, routes.position) < 1)
    return np.minimum(desired, np.where(returning, _RETURN_SPEED, np.inf))
