"""What numbers of clients the simulator is told: finite ones (see `wire`), and not so large that physics breaks down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.server.calls.table import CallError

if TYPE_CHECKING:
    from carla_recap.sim.geometry import Location, Transform, Vector
    from carla_recap.sim.physics_control import PhysicsControl

PLACE: Final = 1e6  # m
TURN: Final = 1e6  # degrees
SPEED: Final = 1e4  # m/s
TURNING: Final = 1e5  # degrees/s
LIGHTEST: Final = 1.0  # kg
SOFTEST: Final = 0.01  # lateral stiffness of tyres, per unit of load and radian
PHYSICS: Final = 1e9  # whatever its unit is


def check_place(place: Location) -> None:
    """Make sure that a place can be one.

    Raises:
        CallError: It is too far away.
    """
    _check("a place", "m", PLACE, place.x, place.y, place.z)


def check_transform(transform: Transform) -> None:
    """Make sure that something can be there; see `check_place`."""
    check_place(transform.location)
    turn = transform.rotation
    _check("a rotation", "degrees", TURN, turn.pitch, turn.yaw, turn.roll)


def check_speed(velocity: Vector) -> None:
    """Make sure that something can move so fast.

    Raises:
        CallError: It is too fast.
    """
    _check("a velocity", "m/s", SPEED, velocity.x, velocity.y, velocity.z)


def check_turning(velocity: Vector) -> None:
    """Make sure that something can turn so fast.

    Raises:
        CallError: It is too fast.
    """
    _check("an angular velocity", "degrees/s", TURNING, velocity.x, velocity.y, velocity.z)


def check_physics(control: PhysicsControl) -> None:
    """Make sure that a vehicle can be like that.

    Raises:
        CallError: A number is too large, or too small.
    """
    wheels = control.wheels
    centre = control.center_of_mass
    numbers = [control.max_rpm, control.moi, control.final_ratio, control.mass, control.drag_coefficient]
    numbers += [value for curve in (control.torque_curve, control.steering_curve) for point in curve for value in point]
    numbers += [value for gear in control.forward_gears for value in (gear.ratio, gear.down_ratio, gear.up_ratio)]
    numbers += [value for wheel in wheels for value in (wheel.tire_friction, wheel.max_brake_torque, wheel.lat_stiff_value)]
    numbers += [value for wheel in wheels for value in (wheel.max_steer_angle, wheel.radius)]
    _check("a physics control", "in its numbers", PHYSICS, *numbers, centre.x, centre.y, centre.z)
    if control.mass < LIGHTEST or any(wheel.lat_stiff_value < SOFTEST for wheel in wheels):
        least = f"a mass of {LIGHTEST:g} kg and a lateral stiffness of tyres of {SOFTEST:g} or more"
        raise CallError(f"a physics control: {least} were expected")
    if control.drag_coefficient < 0 or any(min(wheel.tire_friction, wheel.max_brake_torque) < 0 for wheel in wheels):
        raise CallError("a physics control: drag, tyre friction and brake torque of 0 or more were expected")


def _check(what: str, unit: str, most: float, *values: float) -> None:
    if not all(-most <= value <= most for value in values):
        raise CallError(f"{what}: at most {most:g} {unit} was expected, found {max(values, key=abs):g}")
