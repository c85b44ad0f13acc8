"""What a physics control means for a vehicle as a whole: forces of engine and brakes, grip, drag, steering."""

from __future__ import annotations

from math import pi, radians
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.geometry import Box
    from carla_recap.sim.physics.physics_control import PhysicsControl, WheelPhysics

    Floats = NDArray[np.float64]

GRAVITY: Final = 9.81  # m/s²
SPEEDS: Final = np.arange(0.0, 120.0, 0.5)  # m/s: the columns of the tables
GEARS: Final = 14  # the rows of the table of forces: neutral, the forward gears, and reverse as the last
DRY_ASPHALT: Final = 3.5  # the tyre friction of CARLA's cars, in the scale of its physics; here a friction coefficient of 1
_AIR: Final = 1.2  # kg/m³
_FRONT_AREA: Final = 0.85  # of the rectangle around it (Hucho, Aerodynamics of Road Vehicles)
_EFFICIENCY: Final = 0.9  # between engine and wheels
_DRIVEN: Final = 0.6  # the share of the weight that the driven wheels carry in acceleration
_IDLE: Final = 0.12  # of the most revolutions: below, the clutch slips
_FASTEST_REVERSE: Final = 12.0  # m/s, where the gears would allow more
_CM: Final = 0.01  # m


def columns(control: PhysicsControl, box: Box) -> dict[str, Any]:
    """The columns of `Vehicles` that follow from a physics control, which may be incomplete.

    Args:
        control: The physics control.
        box: The box of the vehicle: where no wheels are named, its size tells where they are; and how large its front is.
    """
    wheels = control.wheels
    steering = [wheel for wheel in wheels if wheel.max_steer_angle]
    fixed = [wheel for wheel in wheels if not wheel.max_steer_angle]
    front = _mean([wheel.position.x * _CM for wheel in steering], 0.6 * box.extent.x)
    rear = -_mean([wheel.position.x * _CM for wheel in fixed], -0.6 * box.extent.x)
    radius = max(_mean([wheel.radius * _CM for wheel in wheels], 0.35), 0.05)
    mass = max(control.mass, 1.0)
    forces, gear = _forces(control, radius)
    speeds, shares = zip(*(control.steering_curve or ((0.0, 1.0),)), strict=True)
    wheelbase = max(front + rear, 0.1)
    grip = _mean([wheel.tire_friction for wheel in wheels], DRY_ASPHALT) / DRY_ASPHALT
    stiffness = _mean([wheel.lat_stiff_value for wheel in wheels], 20.0)
    weight = mass * GRAVITY / wheelbase
    return {
        "mass": mass,
        "moment": mass * ((2 * box.extent.x) ** 2 + (2 * box.extent.y) ** 2) / 12,
        "wheelbase": wheelbase,
        "front": front,
        "rear": rear,
        "traction": _DRIVEN * grip * mass * GRAVITY,
        "front_grip": weight * rear * grip,
        "rear_grip": weight * front * grip,
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
    """The greatest force at the wheels by gear and speed, and the gear of moderate driving by speed."""
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
    return sum(wheel.max_brake_torque for wheel in wheels) / radius


def _mean(values: list[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise
