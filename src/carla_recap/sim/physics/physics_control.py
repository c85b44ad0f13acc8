"""The physics control of a vehicle, as CARLA describes it: engine, gears, wheels, mass and drag."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Vector
from carla_recap.sim.validation import expect_numbers

Curve = tuple[tuple[float, float], ...]

LEAST_MASS: Final = 1.0  # kg
LEAST_STIFFNESS: Final = 0.01  # lateral stiffness of tyres, per unit of load and radian

DEFAULT_STEERING: Final[Curve] = ((0.0, 1.0), (20.0, 0.9), (60.0, 0.8), (120.0, 0.7))
"""How much of the steering angle is left at a speed in km/h, as CARLA's cars have it."""


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
        SimError: It has no gear or no wheel, or a number is too large, or too small.
    """
    expect_numbers(what, control)
    wheels = control.wheels
    if not wheels or not control.forward_gears:
        raise SimError(f"{what}: a forward gear and a wheel at least were expected")
    if control.mass < LEAST_MASS or any(wheel.lat_stiff_value < LEAST_STIFFNESS for wheel in wheels):
        least = f"a mass of {LEAST_MASS:g} kg and a lateral stiffness of tyres of {LEAST_STIFFNESS:g} or more"
        raise SimError(f"{what}: {least} were expected")
    if control.drag_coefficient < 0 or any(min(wheel.tire_friction, wheel.max_brake_torque) < 0 for wheel in wheels):
        raise SimError(f"{what}: drag, tyre friction and brake torque of 0 or more were expected")
    if control.max_rpm <= 0:
        raise SimError(f"{what}: a max_rpm of more than 0 was expected, found {control.max_rpm:g}")
