"""The physics control of a vehicle, as CARLA describes it, and the parameters of `drivetrain` that follow.

All values are accepted that CARLA accepts: those that have no meaning make a vehicle that coasts, or stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, pi, radians
from statistics import fmean
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.motion import GRAVITY
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Vector
from carla_recap.sim.validation import expect_between, expect_numbers

if TYPE_CHECKING:
    from carla_recap.sim.geometry import Box
    from carla_recap.util.arrays import Floats


Curve = tuple[tuple[float, float], ...]

DEFAULT_STEERING: Final[Curve] = ((0.0, 1.0), (20.0, 0.9), (60.0, 0.8), (120.0, 0.7))
"""How much of the steering angle is left at a speed in km/h, as CARLA's cars have it."""
SPEEDS: Final = np.arange(0.0, 120.0, 0.5)  # m/s: the columns of the table of steering
GEARS: Final = 14  # columns of the tables of gears: neutral, the forward gears, and reverse as the last
CORNERS: Final = 4
"""Front left, front right, rear left, rear right: the wheels of a vehicle as it drives."""
TORQUES: Final = 256  # steps of the table of torques, from no revolutions to the most
WHEEL: Final = ("x", "y", "radius", "inertia", "damping", "grip", "lateral", "longitudinal", "brake", "hand_brake")
"""The parameters of a corner, see `parameters`."""
_AIR: Final = 1.25  # kg/m³, as in UE4
CHASSIS_AREA: Final = 1.8 * 1.4  # m², against the air, of every vehicle: the chassis of UE4's default
_REVERSE: Final = -4.0  # the ratio of the reverse gear in UE4, which no physics control has
_NEUTRAL_UP: Final = 0.15  # of the most revolutions, above which the gearbox leaves neutral, in PhysX and UE4
_NEVER: Final = 1e9  # a share of the most revolutions that no engine reaches
_WHEEL_MASS: Final = 20.0  # kg, in UE4; no physics control has it
LEAST_MASS: Final = 1.0  # kg, that a vehicle has at least
_WHEEL_SHARE: Final = 0.05  # of the vehicle's mass that a wheel has at most
_USUAL_SWITCH_TIME: Final = 0.5  # s, of UE4
_USUAL_LATENCY, _QUICK_LATENCY = 2.0, 0.5
"""s between two shifts of the gearbox: in PhysX and UE4, and in CARLA's gearboxes since 0.9.12; no physics control has it.

Recordings show 2.0 s where a shift takes 0.5 s (0.9.10), and 0.5 s where it takes 0.1 s (0.9.13)."""
_LEAST_MOMENT: Final = 1e-3  # kg m² of engine and wheels
_MOST_FRICTION: Final = 30.0  # of tyres: with more, stiff ones throw a vehicle about in steps of 0.01 s
_STEEPEST_LOCK: Final = 85.0  # degrees
_DAMPINGS: Final = ("full_throttle", "zero_throttle_clutch_engaged", "zero_throttle_clutch_disengaged")
_CM: Final = 0.01  # m
_LEAST_LEVER: Final = 0.05  # m, between the centre of a vehicle and an axle


@dataclass(slots=True)
class WheelPhysics:
    """A wheel, in CARLA's units.

    Attributes:
        tire_friction: The friction coefficient; 3.5 is that of CARLA's cars.
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
        drag_coefficient: Of the air, for `CHASSIS_AREA`.
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
    """Make sure that a physics control can be simulated; the error text begins with `what`.

    A `SimError` is raised if it has no wheel, or more than 12 gears, or a number is too large, infinite or NaN.
    """
    expect_numbers(what, control)
    if not control.wheels:
        raise SimError(f"{what}: expected a wheel at least, found none")
    expect_between(f"{what}: forward gears", len(control.forward_gears), 0, GEARS - 2)


def columns(control: PhysicsControl, box: Box) -> dict[str, float]:
    """Return the columns of `Vehicles` that follow from a physics control, which may be incomplete."""
    x = _corners(control, box)[0]
    mass = max(control.mass, LEAST_MASS)
    return {
        "mass": mass,
        "moment": mass * ((2 * box.extent.x) ** 2 + (2 * box.extent.y) ** 2) / 12,
        "wheelbase": x[0] - x[2],
        "front": x[0],
        "rear": -x[2],
        "air": 0.5 * _AIR * max(control.drag_coefficient, 0.0) * CHASSIS_AREA,
    }


def parameters(control: PhysicsControl, box: Box, *, weightless: bool = False) -> dict[str, Any]:
    """Return the row of `DriveTables` that follows from a physics control, which may be incomplete.

    Wheels without places stand where it suits the box. Without gravity, the tyres have no grip.
    """
    x, y = _corners(control, box)
    base, mass = x[0] - x[2], max(control.mass, LEAST_MASS)
    centre = min(max(control.center_of_mass.x, x[2] + 0.05 * base), x[0] - 0.05 * base)
    weight = mass * GRAVITY / base / 2
    loads = [weight * (centre - x[2]), weight * (centre - x[2]), weight * (x[0] - centre), weight * (x[0] - centre)]
    full_lock = radians(min(max(max(wheel.max_steer_angle for wheel in control.wheels[:2]), 0.0), _STEEPEST_LOCK))
    corners = []
    for own_x, own_y, load, wheels in zip(x, y, loads, _wheels_of_corners(control), strict=True):
        radius = max(fmean([wheel.radius * _CM for wheel in wheels]), 0.05)
        stiffness = fmean([max(wheel.lat_stiff_value, 0.0) * _saturation(wheel.lat_stiff_max_load) for wheel in wheels])
        friction = 0.0 if weightless else fmean([min(max(wheel.tire_friction, 0.0), _MOST_FRICTION) for wheel in wheels])
        inertia = 0.5 * min(_WHEEL_MASS, _WHEEL_SHARE * mass) * radius * radius
        corners.append(
            (
                own_x - centre,
                own_y,
                radius,
                max(len(wheels) * inertia, _LEAST_MOMENT),
                sum(max(wheel.damping_rate, 0.0) for wheel in wheels),
                friction * load,
                stiffness * load,
                sum(max(wheel.long_stiff_value, 0.0) for wheel in wheels) * GRAVITY,
                sum(max(wheel.max_brake_torque, 0.0) for wheel in wheels),
                sum(max(wheel.max_handbrake_torque, 0.0) for wheel in wheels),
            )
        )
    most = max(control.max_rpm, 0.0)
    torques = _at(np.linspace(0.0, most, TORQUES + 1), control.torque_curve, 0.0)
    return {
        "wheels": np.array(corners).T,
        "centre": centre,
        "full_lock": full_lock,
        "track": y[1] - y[0],
        "torques": torques + 1j * np.diff(torques, append=torques[-1:]),
        "most_turns": most * 2 * pi / 60,
        "engine_inertia": max(control.moi, _LEAST_MOMENT),
        "damping": np.maximum([getattr(control, f"damping_rate_{name}") for name in _DAMPINGS], 0.0),
        "clutch": max(control.clutch_strength, 0.0),
        **_gears(control),
        "lock_share": _at(SPEEDS * 3.6, control.steering_curve, 1.0, 1.0),
    }


def _gears(control: PhysicsControl) -> dict[str, Any]:
    """Return what the gearbox is and does by gear: neutral, the forward gears, and reverse as the last one."""
    ratios, up, down = np.zeros(GEARS), np.full(GEARS, _NEVER), np.full(GEARS, -1.0)
    gears = control.forward_gears[: GEARS - 2]
    for number, gear in enumerate(gears, 1):
        ratios[number] = gear.ratio * control.final_ratio
        up[number] = gear.up_ratio if number < len(gears) else _NEVER
        down[number] = gear.down_ratio if number > 1 else -1.0
    ratios[-1] = _REVERSE * control.final_ratio
    up[0] = _NEUTRAL_UP if gears else _NEVER
    latency = _USUAL_LATENCY if control.gear_switch_time >= _USUAL_SWITCH_TIME else _QUICK_LATENCY
    return {
        "ratios": ratios,
        "up": up,
        "down": down,
        "switch_time": max(control.gear_switch_time, 0.0),
        "latency": latency if control.use_gear_autobox else inf,
    }


def _at(points: Floats, curve: Curve, empty: float, most: float = inf) -> Floats:
    """Return the values of a curve at some points, each 0 to `most`; an empty curve has one value."""
    x, y = np.array(sorted(curve) or [(0.0, empty)]).T
    found: Floats = np.interp(points, x, np.clip(y, 0.0, most))
    return found


def _corners(control: PhysicsControl, box: Box) -> tuple[list[float], list[float]]:
    """Return x and y of the four corners in m; where the wheels have no places, those that suit the box."""
    x, y = (
        [_CM * fmean(getattr(wheel.position, axis) for wheel in wheels) for wheels in _wheels_of_corners(control)]
        for axis in "xy"
    )
    front, rear = (x[0] + x[1]) / 2, (x[2] + x[3]) / 2
    if front - rear < _LEAST_LEVER:
        front, rear = 0.6 * max(box.extent.x, 0.1), -0.6 * max(box.extent.x, 0.1)
    right = (y[1] - y[0] + y[3] - y[2]) / 4
    right = right if right > 0 else 0.8 * box.extent.y
    return [front, front, rear, rear], [-right, right, -right, right]


def _wheels_of_corners(control: PhysicsControl) -> list[list[WheelPhysics]]:
    """Return the wheels of each corner: those behind the fourth one belong to the rear, and missing ones are as others."""
    wheels = control.wheels or [WheelPhysics()]
    if len(wheels) < CORNERS:  # one wheel of each axle, or even fewer
        return [[wheels[min(number * len(wheels) // CORNERS, len(wheels) - 1)]] for number in range(CORNERS)]
    return [[wheels[corner], *(wheels[CORNERS + corner % 2 :: 2] if corner >= 2 else ())] for corner in range(CORNERS)]


def _saturation(most_load: float) -> float:
    """Return the share of the lateral stiffness that a tyre has at its load at rest, by PhysX's curve."""
    k = min(3.0 / most_load, 3.0) if most_load > 0 else 3.0
    return k - k * k / 3 + k**3 / 27
