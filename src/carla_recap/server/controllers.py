"""Controllers of vehicles on behalf of clients: Ackermann control and constant velocity.

CARLA runs PID controllers for Ackermann control. Here the throttle or brake is computed that gives a vehicle the desired
acceleration in gear, and throttle is added while it stays behind that, as when the clutch slips; the gains that clients set
are only kept.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from carla_recap.sim.actors.moving import VehicleControl
from carla_recap.sim.geometry import Location, Transform, Vector

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.world import World

T = TypeVar("T")

_RESPONSE: Final = 0.3  # s: the time constant of the speed
_MOST: Final = 8.0  # m/s²: the default limit
_HALT: Final = 0.1  # m/s: below it, a vehicle that is to stand is braked
_GAIN: Final = 0.1  # of the throttle, in 1/s for each m/s² that is missing
_LOG: Final = logging.getLogger(__name__)


@dataclass(slots=True)
class AckermannControl:
    """CARLA's VehicleAckermannControl.

    The angle of the front wheels is in radians, positive to the right, the speed in m/s, negative backwards, the largest
    acceleration in m/s², 0 for the default. Their rates, in rad/s and m/s³, are 0 for an immediate change.
    """

    steer: float = 0.0
    steer_speed: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0


@dataclass(slots=True)
class AckermannSettings:
    """The gains of CARLA's controllers, with CARLA's defaults."""

    speed_kp: float = 0.15
    speed_ki: float = 0.0
    speed_kd: float = 0.25
    accel_kp: float = 0.01
    accel_ki: float = 0.0
    accel_kd: float = 0.01


@dataclass(slots=True)
class _AckermannState:
    control: AckermannControl
    angle: float = 0.0
    acceleration: float = 0.0
    speed: float = 0.0
    added: float = 0.0  # to the throttle


class AckermannController:
    """Drives vehicles to a speed and a steering angle."""

    def __init__(self) -> None:
        self._states: dict[Vehicle, _AckermannState] = {}
        self._settings: WeakKeyDictionary[Vehicle, AckermannSettings] = WeakKeyDictionary()

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick; see `World.controllers`."""
        _for_each(self._states, lambda vehicle, state: vehicle.apply_control(_control(vehicle, state, delta)))

    def drive(self, vehicle: Vehicle, control: AckermannControl) -> None:
        """Drive a vehicle from now on."""
        if vehicle in self._states:
            self._states[vehicle].control = control
        else:
            rows, row = vehicle.rows, vehicle.row
            self._states[vehicle] = _AckermannState(control, rows.steer_angle[row].item(), speed=rows.speed[row].item())

    def release(self, vehicle: Vehicle) -> None:
        """Stop driving a vehicle."""
        self._states.pop(vehicle, None)

    def settings(self, vehicle: Vehicle) -> AckermannSettings:
        """Return the gains of a vehicle."""
        return self._settings.get(vehicle, AckermannSettings())

    def set_settings(self, vehicle: Vehicle, settings: AckermannSettings) -> None:
        """Set the gains of a vehicle; they have no effect."""
        self._settings[vehicle] = settings


def _control(vehicle: Vehicle, state: _AckermannState, delta: float) -> VehicleControl:
    """Return the control that gives a vehicle the desired acceleration."""
    rows, row, wanted = vehicle.rows, vehicle.row, state.control
    speed = rows.speed[row].item()
    missing = abs(state.acceleration) - abs(speed - state.speed) / delta  # in the latest tick
    state.speed = speed
    most = wanted.acceleration or _MOST
    acceleration = _limited((wanted.speed - speed) / _RESPONSE, 0.0, abs(most))
    state.acceleration = _limited(acceleration, state.acceleration, abs(wanted.jerk) * delta or float("inf"))
    state.angle = _limited(wanted.steer, state.angle, abs(wanted.steer_speed) * delta or float("inf"))
    limit = rows.steer_limit[row].item()
    steer = state.angle / limit if limit else 0.0
    backwards = wanted.speed < 0
    forward = -state.acceleration if backwards else state.acceleration  # in the desired direction
    if wanted.speed == 0 and abs(speed) < _HALT:
        return VehicleControl(steer=steer, brake=1.0)
    throttle, brake = rows.pedals(np.array([row]), np.array([forward]), backwards)
    state.added = min(max(state.added + _GAIN * missing * delta, 0.0), 1.0) if forward > 0 else 0.0
    return VehicleControl(min(throttle.item() + state.added, 1.0), steer, brake.item(), reverse=backwards)


def _for_each(states: dict[Vehicle, T], act: Callable[[Vehicle, T], None]) -> None:
    """Act for each vehicle that still exists; one whose action raises is left alone from now on."""
    for vehicle, state in tuple(states.items()):
        try:
            if vehicle.is_alive:
                act(vehicle, state)
                continue
        except Exception:
            _LOG.exception("%r: its control ends here", vehicle)
        del states[vehicle]


def _limited(value: float, around: float, most: float) -> float:
    return min(max(value, around - most), around + most)


class ConstantVelocity:
    """Holds the velocity of vehicles constant, as CARLA's `enable_constant_velocity` does.

    At the end of each tick, the vehicles get back the velocity that brakes, tyres and drag have taken.
    """

    def __init__(self) -> None:
        self._velocities: dict[Vehicle, Vector] = {}

    def __call__(self) -> None:
        """Act at the end of a tick; see `World.listeners`."""
        _for_each(self._velocities, _set_velocity)

    def hold(self, vehicle: Vehicle, velocity: Vector) -> None:
        """Hold the velocity of a vehicle, in its own axes and m/s."""
        _set_velocity(vehicle, velocity)
        self._velocities[vehicle] = velocity

    def release(self, vehicle: Vehicle) -> None:
        """Stop holding the velocity of a vehicle."""
        self._velocities.pop(vehicle, None)


class Takeover:
    """Ends the server's autopilot of vehicles that clients drive.

    The server's autopilot drives the vehicles of a replay that has ended. As in CARLA, the control of a client counts more.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._is_logged = False

    def begin_replay(self) -> None:
        """Log the first vehicle of a new replay that a client tries to drive."""
        self._is_logged = False

    def take(self, vehicle: Vehicle) -> bool:
        """End the server's autopilot of a vehicle, and return whether it drove; one that follows a recording goes on."""
        if not vehicle.simulates_physics and self._world.replayer.follows(vehicle):
            if not self._is_logged:
                why = "controls and autopilots of clients have no effect on replayed vehicles until the replay ends"
                _LOG.warning("%r follows a recording: %s", vehicle, why)
            self._is_logged = True
            return False
        was_driven = vehicle.autopilot
        if was_driven:
            vehicle.set_autopilot(False)
        return was_driven


def _set_velocity(vehicle: Vehicle, velocity: Vector) -> None:
    rotated = Transform(rotation=vehicle.transform.rotation).transform(Location(velocity.x, velocity.y, velocity.z))
    vehicle.set_target_velocity(Vector(rotated.x, rotated.y, rotated.z))
