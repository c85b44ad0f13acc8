"""Vehicles that are told how fast to go and how far to turn their wheels, instead of what to do with the pedals.

CARLA runs PID controllers for that. The simulator knows its vehicles well enough to say at once which throttle or brake
gives the acceleration that is wanted, so that there is nothing to be tuned; gains are kept for who asks for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.physics.drivetrain import SPEEDS

if TYPE_CHECKING:
    from carla_recap.sim.actors.actors import Vehicle
    from carla_recap.sim.world import World

_RESPONSE: Final = 0.3  # s: in about so much a vehicle reaches a speed that is near
_MOST: Final = 8.0  # m/s²: where nobody says how much
_RESISTANCE: Final = 0.013 * 9.81  # m/s², of rolling tyres
_COASTING: Final = 0.5 + _RESISTANCE  # m/s²: so much a vehicle loses without throttle
_HALT: Final = 0.1  # m/s: who is to stand, and is slower, is braked to a halt


@dataclass(slots=True)
class AckermannControl:
    """What a vehicle is to do, with CARLA's names and order.

    Attributes:
        steer: The angle of the front wheels in radians, positive to the right.
        steer_speed: How fast they turn, in rad/s; 0 for at once.
        speed: In m/s; negative backwards.
        acceleration: The most, in m/s²; 0 for as much as there is.
        jerk: How fast the acceleration changes, in m/s³; 0 for at once.
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
class _Drive:
    control: AckermannControl
    angle: float = 0.0
    acceleration: float = 0.0


class Ackermann:
    """Drives vehicles as they have been told, tick by tick.

    Args:
        world: Where they are.
    """

    def __init__(self, world: World) -> None:
        self._drives: dict[Vehicle, _Drive] = {}
        self._settings: WeakKeyDictionary[Vehicle, AckermannSettings] = WeakKeyDictionary()
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick; see `World.controllers`."""
        for vehicle, drive in tuple(self._drives.items()):
            if vehicle.is_alive:
                vehicle.apply_control(_control(vehicle, drive, delta))
            else:
                del self._drives[vehicle]

    def drive(self, vehicle: Vehicle, control: AckermannControl) -> None:
        """Drive a vehicle from now on."""
        if vehicle in self._drives:
            self._drives[vehicle].control = control
        else:
            self._drives[vehicle] = _Drive(control, vehicle.rows.steer_angle[vehicle.row].item())

    def release(self, vehicle: Vehicle) -> None:
        """Leave a vehicle to its pedals."""
        self._drives.pop(vehicle, None)

    def settings(self, vehicle: Vehicle) -> AckermannSettings:
        """The gains that a vehicle has been given."""
        return self._settings.get(vehicle, AckermannSettings())

    def set_settings(self, vehicle: Vehicle, settings: AckermannSettings) -> None:
        """Keep gains for a vehicle."""
        self._settings[vehicle] = settings


def _control(vehicle: Vehicle, drive: _Drive, delta: float) -> VehicleControl:
    """The pedals that give a vehicle the acceleration that is wanted."""
    fleet, row, wanted = vehicle.rows, vehicle.row, drive.control
    speed, mass = fleet.speed[row].item(), fleet.mass[row].item()
    most = wanted.acceleration or _MOST
    acceleration = _limited((wanted.speed - speed) / _RESPONSE, 0.0, abs(most))
    drive.acceleration = _limited(acceleration, drive.acceleration, abs(wanted.jerk) * delta or float("inf"))
    drive.angle = _limited(wanted.steer, drive.angle, abs(wanted.steer_speed) * delta or float("inf"))
    limit = fleet.steer_limit[row].item()
    steer = drive.angle / limit if limit else 0.0
    backwards = wanted.speed < 0
    push = -drive.acceleration if backwards else drive.acceleration  # along the way that it is to go
    if wanted.speed == 0 and abs(speed) < _HALT:
        return VehicleControl(steer=steer, brake=1.0)
    air = fleet.air[row].item() * speed * speed / mass
    if push > -_COASTING - air:
        column = min(int(abs(speed) / SPEEDS[1]), len(SPEEDS) - 1)
        force = (fleet.forces[row, -1, column] if backwards else fleet.best_force[row, column]).item()
        throttle = max(push + _RESISTANCE + air, 0.0) * mass / force if force else 0.0
        return VehicleControl(throttle, steer, reverse=backwards)
    brakes = (fleet.front_brake[row] + fleet.rear_brake[row]).item() / mass
    brake = (-push - _COASTING - air) / brakes if brakes else 0.0
    return VehicleControl(steer=steer, brake=brake, reverse=backwards)


def _limited(value: float, around: float, most: float) -> float:
    return min(max(value, around - most), around + most)
