"""The physics control of a vehicle, as CARLA describes it, and the forces that follow: of engine and brakes, grip, drag.

The wheels of an axle act as one: each adds the load that it carries times its own friction, and its own brake. Along the
vehicle, a tyre also gives no more than its longitudinal stiffness allows at a large slip.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import pi, radians
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.motion import GRAVITY
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Vector
from carla_recap.sim.validation import expect_between, expect_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.geometry import Box
    from carla_recap.util.arrays import Floats


Curve = tuple[tuple[float, float], ...]

LEAST_MASS: Final = 1.0  # kg
LEAST_STIFFNESS: Final = 0.01  # lateral stiffness of tyres, per unit of load and radian

DEFAULT_STEERING: Final[Curve] = ((0.0, 1.0), (20.0, 0.9), (60.0, 0.8), (120.0, 0.7))
"""How much of the steering angle is left at a speed in km/h, as CARLA's cars have it."""
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


@dataclass(slots=True)
class WheelPhysics:
    """A wheel, in CARLA's units.

    Attributes:
        tire_friction: Grip; 3.5 is that of CARLA's cars, and counts as dry asphalt.
        damping_rate: Of the wheel's rotation.
        max_steer_angle: How far it turns to each side, in degrees; 0 for a wheel that does not steer.
        radius: In cm.
        max_brake_torque: In N m.
        max_handbrake_torque: In N m; 0 for a wheel without a hand brake.
        lat_stiff_max_load: The load above which the lateral stiffness grows no more, relative to the load at rest.
        lat_stiff_value: Lateral stiffness per unit of load and radian.
        long_stiff_value: Longitudinal stiffness per unit of load.
        position: Where it is, in cm, in the axes of the vehicle.
    """

    tire_friction: float = 3.5
    damping_rate: float = 0.25
    max_steer_angle: float = 70.0
    radius: float = 35.0
    max_brake_torque: float = 1500.0
    max_handbrake_torque: float = 3000.0
    lat_stiff_max_load: float = 3.0
    lat_stiff_value: float = 20.0
    long_stiff_value: float = 3000.0
    position: Vector = field(default_factory=Vector)


@dataclass(slots=True)
class Gear:
    """A forward gear.

    Attributes:
        ratio: The ratio of the gear.
        down_ratio, up_ratio: The shares of `max_rpm` below and above which the gearbox leaves the gear.
    """

    ratio: float = 1.0
    down_ratio: float = 0.5
    up_ratio: float = 0.65


@dataclass(slots=True)
class PhysicsControl:
    """How a vehicle moves, in CARLA's units.

    Attributes:
        torque_curve: The torque of the engine in N m at revolutions per minute, ascending.
        max_rpm: The most revolutions per minute.
        moi: The engine's moment of inertia in kg m².
        damping_rate_full_throttle: Damping of the engine at full throttle, in kg m²/s.
        damping_rate_zero_throttle_clutch_engaged, damping_rate_zero_throttle_clutch_disengaged: The same without throttle.
        use_gear_autobox: Whether the gears change on their own.
        gear_switch_time: In s.
        clutch_strength: In kg m²/s.
        final_ratio: Between gearbox and wheels.
        forward_gears: From first to last.
        mass: In kg.
        drag_coefficient: Of the air, for the area of the vehicle's front.
        center_of_mass: In m, in the axes of the vehicle.
        steering_curve: The share of the steering angle that is left at a speed in km/h, ascending.
        wheels: From front to back, the left one of each pair first.
        use_sweep_wheel_collision: Kept, and nothing comes of it.
    """

    torque_curve: Curve = ((0.0, 500.0), (5000.0, 500.0))
    max_rpm: float = 5000.0
    moi: float = 1.0
    damping_rate_full_throttle: float = 0.15
    damping_rate_zero_throttle_clutch_engaged: float = 2.0
    damping_rate_zero_throttle_clutch_disengaged: float = 0.35
    use_gear_autobox: bool = True
    gear_switch_time: float = 0.5
    clutch_strength: float = 10.0
    final_ratio: float = 4.0
    forward_gears: list[Gear] = field(default_factory=lambda: [Gear()])
    mass: float = 1500.0
    drag_coefficient: float = 0.3
    center_of_mass: Vector = field(default_factory=Vector)
    steering_curve: Curve = DEFAULT_STEERING
    wheels: list[WheelPhysics] = field(default_factory=list)
    use_sweep_wheel_collision: bool = False

    def copy(self) -> PhysicsControl:
        """Return a copy that shares nothing that can be changed."""
        return replace(
            self,
            torque_curve=tuple(self.torque_curve),
            forward_gears=[replace(gear) for gear in self.forward_gears],
            center_of_mass=replace(self.center_of_mass),
            steering_curve=tuple(self.steering_curve),
            wheels=[replace(wheel, position=replace(wheel.position)) for wheel in self.wheels],
        )


def expect_physics(what: str, control: PhysicsControl) -> None:
    """Make sure that a physics control can be simulated.

    Args:
        what: The control's name in the error text.
        control: The physics control.

    Raises:
        SimError: It has no wheel, no gear or more than 12, or a number is too large, or too small.
    """
    expect_numbers(what, control)
    wheels = control.wheels
    if not wheels:
        raise SimError(f"{what}: expected a wheel at least, found none")
    expect_between(f"{what}: forward gears", len(control.forward_gears), 1, GEARS - 2)
    if control.mass < LEAST_MASS or any(wheel.lat_stiff_value < LEAST_STIFFNESS for wheel in wheels):
        least = f"a mass of {LEAST_MASS:g} kg and a lateral stiffness of tyres of {LEAST_STIFFNESS:g} or more"
        raise SimError(f"{what}: {least} were expected")
    if control.drag_coefficient < 0 or any(min(wheel.tire_friction, wheel.max_brake_torque) < 0 for wheel in wheels):
        raise SimError(f"{what}: drag, tyre friction and brake torque of 0 or more were expected")
    if control.max_rpm <= 0:
        raise SimError(f"{what}: a max_rpm of more than 0 was expected, found {control.max_rpm:g}")


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
