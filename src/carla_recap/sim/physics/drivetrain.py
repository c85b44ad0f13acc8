"""The forces that follow from a physics control: of engine and brakes, grip, drag, steering.

The wheels of an axle act as one: each adds the load that it carries times its own friction, and its own brake. Along the
vehicle, a tyre also gives no more than its longitudinal stiffness allows at a large slip.
"""

from __future__ import annotations

from math import pi, radians
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.motion import GRAVITY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.geometry import Box
    from carla_recap.sim.physics.physics_control import PhysicsControl, WheelPhysics

    Floats = NDArray[np.float64]

SPEEDS: Final = np.arange(0.0, 120.0, 0.5)  # m/s: the columns of the tables
GEARS: Final = 14  # rows of the table of forces: neutral, the forward gears, and reverse as the last
DRY_ASPHALT: Final = 3.5  # the tyre friction of CARLA's cars, in the scale of its physics; here a friction coefficient of 1
_AIR: Final = 1.2  # kg/m³
_FRONT_AREA: Final = 0.85  # of the rectangle around it (Hucho, Aerodynamics of Road Vehicles)
_EFFICIENCY: Final = 0.9  # between engine and wheels
_DRIVEN: Final = 0.6  # the share of the weight that the driven wheels carry in acceleration
_IDLE: Final = 0.12  # of the most revolutions: below, the clutch slips
_FASTEST_REVERSE: Final = 12.0  # m/s, where the gears would allow more
_MOST_SLIP: Final = 2.0  # of a wheel that spins, relative to the speed of the vehicle
_CM: Final = 0.01  # m
_LEAST_LEVER: Final = 0.05  # m, between the centre of a vehicle and an axle: where all wheels steer, their mean is 0


def columns(control: PhysicsControl, box: Box, *, weightless: bool = False) -> dict[str, Any]:
    """Return the columns of `Vehicles` that follow from a physics control, which may be incomplete.

    Args:
        control: The physics control.
        box: The box of the vehicle: it has the area of the front, and the positions of the wheels if there are none.
        weightless: Whether there is no gravity, so that the tyres have no grip.
    """
    wheels = control.wheels
    steering = [wheel for wheel in wheels if wheel.max_steer_angle]
    fixed = [wheel for wheel in wheels if not wheel.max_steer_angle]
    front = _mean([wheel.position.x * _CM for wheel in steering], 0.6 * box.extent.x)
    rear = -_mean([wheel.position.x * _CM for wheel in fixed], -0.6 * box.extent.x)
    front, rear = (lever if abs(lever) > _LEAST_LEVER else _LEAST_LEVER for lever in (front, rear))
    radius = max(_mean([wheel.radius * _CM for wheel in wheels], 0.35), 0.05)
    mass = max(control.mass, 1.0)
    forces, gear = _forces(control, radius)
    speeds, shares = zip(*(control.steering_curve or ((0.0, 1.0),)), strict=True)
    wheelbase = max(front + rear, 0.1)
    load = 0.0 if weightless else 1.0
    front_grip, rear_grip = load * _grip(steering or wheels), load * _grip(fixed or wheels)
    hold = load * _mean([min(_grip([wheel]), _stiffness(wheel) / mass * len(wheels)) for wheel in wheels], 1.0)
    stiffness = _mean([wheel.lat_stiff_value for wheel in wheels], 20.0)
    weight = mass * GRAVITY / wheelbase
    return {
        "mass": mass,
        "moment": mass * ((2 * box.extent.x) ** 2 + (2 * box.extent.y) ** 2) / 12,
        "wheelbase": wheelbase,
        "front": front,
        "rear": rear,
        "traction": _DRIVEN * hold * mass * GRAVITY,
        "front_grip": weight * rear * front_grip,
        "rear_grip": weight * front * rear_grip,
        "softness": wheelbase / (stiffness * GRAVITY * mass),
        "air": 0.5 * _AIR * control.drag_coefficient * _FRONT_AREA * 4 * box.extent.y * box.extent.z,
        "front_brake": _braking(steering, radius),
        "rear_brake": _braking(fixed, radius),
        "full_lock": radians(_mean([wheel.max_steer_angle for wheel in steering], 70.0)),
        "forces": forces,
        "best_force": forces[1:-1].max(axis=0),
        "usual_gear": gear,
        "lock_share": np.interp(SPEEDS * 3.6, speeds, shares),
    }


def _forces(control: PhysicsControl, radius: float) -> tuple[Floats, NDArray[np.int64]]:
    """Return the greatest force at the wheels by gear and speed, and the gear of moderate driving by speed."""
    forces = np.zeros((GEARS, len(SPEEDS)))
    gears = control.forward_gears[: GEARS - 2]
    usual = np.ones(len(SPEEDS), np.int64)
    turns, torques = zip(*(control.torque_curve or ((0.0, 0.0),)), strict=True)
    for number, gear in enumerate(gears, 1):
        ratio = gear.ratio * control.final_ratio
        rpm = SPEEDS / radius * ratio * 60 / (2 * pi)
        torque = np.interp(np.maximum(rpm, _IDLE * control.max_rpm), turns, torques)
        forces[number] = np.where(rpm <= control.max_rpm, torque * ratio / radius * _EFFICIENCY, 0.0)
        usual[rpm > gear.up_ratio * control.max_rpm] = min(number + 1, len(gears))
    forces[-1] = np.where(SPEEDS <= _FASTEST_REVERSE, forces[1], 0.0)
    return forces, usual


def _braking(wheels: list[WheelPhysics], radius: float) -> float:
    """Return the greatest force of the brakes of an axle, in N."""
    if all(wheel.max_brake_torque <= _stiffness(wheel) * GRAVITY * radius for wheel in wheels):
        return sum(wheel.max_brake_torque for wheel in wheels) / radius
    return sum(min(wheel.max_brake_torque / radius, _stiffness(wheel) * GRAVITY) for wheel in wheels)


def _grip(wheels: list[WheelPhysics]) -> float:
    """Return the friction coefficient of an axle."""
    return _mean([wheel.tire_friction for wheel in wheels], DRY_ASPHALT) / DRY_ASPHALT


def _stiffness(wheel: WheelPhysics) -> float:
    """Return the greatest force along a tyre per unit of gravity, in kg."""
    return wheel.long_stiff_value * _MOST_SLIP


def _mean(values: list[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise
