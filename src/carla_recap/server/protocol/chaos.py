"""The physics of vehicles as CARLA 0.10 describes it, for the engine's Chaos physics.

What the simulator's physics does not have is sent with CARLA's defaults, and ignored when a client sets it. What it has
beyond that is kept when a client sets the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from math import isclose
from typing import Any, Final

from carla_recap.sim.geometry import Vector
from carla_recap.sim.physics.physics_control import Curve, Gear, PhysicsControl, WheelPhysics

_STIFFNESS: Final = 50.0
"""The cornering stiffness of 0.10's usual wheels, 1,000, by that of 0.9's, 20."""


_WHEEL: Final = {
    "wheel_radius": "radius",
    "friction_force_multiplier": "tire_friction",
    "max_steer_angle": "max_steer_angle",
    "max_brake_torque": "max_brake_torque",
    "max_hand_brake_torque": "max_handbrake_torque",
    "location": "position",
}
"""The fields of a wheel in 0.9 by those that are the same in 0.10."""
_CONTROL: Final = {
    **{name: name for name in ("torque_curve", "max_rpm", "final_ratio", "mass", "drag_coefficient", "center_of_mass")},
    **{name: name for name in ("steering_curve", "use_sweep_wheel_collision")},
    "rev_up_moi": "moi",
    "use_automatic_gears": "use_gear_autobox",
    "gear_change_time": "gear_switch_time",
}
"""The same of a physics control."""


@dataclass(slots=True)
class ChaosWheel:
    """A wheel; lengths in cm, angles in degrees, torques in N m."""

    axle_type: int = 0
    offset: Vector = field(default_factory=Vector)
    wheel_radius: float = 30.0
    wheel_width: float = 30.0
    wheel_mass: float = 30.0
    cornering_stiffness: float = 1000.0
    friction_force_multiplier: float = 3.0
    side_slip_modifier: float = 1.0
    slip_threshold: float = 20.0
    skid_threshold: float = 20.0
    max_steer_angle: float = 70.0
    affected_by_steering: bool = True
    affected_by_brake: bool = True
    affected_by_handbrake: bool = True
    affected_by_engine: bool = True
    abs_enabled: bool = False
    traction_control_enabled: bool = False
    max_wheelspin_rotation: float = 30.0
    external_torque_combine_method: int = 0
    lateral_slip_graph: Curve = ()
    suspension_axis: Vector = field(default_factory=lambda: Vector(0.0, 0.0, -1.0))
    suspension_force_offset: Vector = field(default_factory=Vector)
    suspension_max_raise: float = 10.0
    suspension_max_drop: float = 10.0
    suspension_damping_ratio: float = 0.5
    wheel_load_ratio: float = 0.5
    spring_rate: float = 250.0
    spring_preload: float = 50.0
    suspension_smoothing: int = 0
    rollbar_scaling: float = 0.15
    sweep_shape: int = 0
    sweep_type: int = 0
    max_brake_torque: float = 1500.0
    max_hand_brake_torque: float = 3000.0
    wheel_index: int = -1
    location: Vector = field(default_factory=Vector)
    old_location: Vector = field(default_factory=Vector)
    velocity: Vector = field(default_factory=Vector)

    @classmethod
    def of(cls, wheel: WheelPhysics, index: int) -> ChaosWheel:
        """Return a wheel of 0.9."""
        return cls(
            **{name: getattr(wheel, own) for name, own in _WHEEL.items()},
            cornering_stiffness=wheel.lat_stiff_value * _STIFFNESS,
            affected_by_steering=bool(wheel.max_steer_angle),
            affected_by_handbrake=bool(wheel.max_handbrake_torque),
            wheel_index=index,
        )

    def plain(self) -> WheelPhysics:
        """Return it as a wheel of 0.9."""
        wheel = WheelPhysics(**{own: getattr(self, name) for name, own in _WHEEL.items()})
        wheel.lat_stiff_value = self.cornering_stiffness / _STIFFNESS
        wheel.max_steer_angle *= self.affected_by_steering
        wheel.max_brake_torque *= self.affected_by_brake
        wheel.max_handbrake_torque *= self.affected_by_handbrake
        return wheel


@dataclass(slots=True)
class ChaosControl:
    """How a vehicle moves; lengths in cm, the mass in kg, torques in N m, times in s."""

    torque_curve: Curve = ((0.0, 500.0), (5000.0, 500.0))
    max_torque: float = 300.0
    max_rpm: float = 5000.0
    idle_rpm: float = 1.0
    brake_effect: float = 1.0
    rev_up_moi: float = 1.0
    rev_down_rate: float = 600.0
    differential_type: int = 0
    front_rear_split: float = 0.5
    use_automatic_gears: bool = True
    gear_change_time: float = 0.5
    final_ratio: float = 4.0
    forward_gear_ratios: list[float] = field(default_factory=lambda: [1.0])
    reverse_gear_ratios: list[float] = field(default_factory=lambda: [1.0])
    change_up_rpm: float = 4500.0
    change_down_rpm: float = 2000.0
    transmission_efficiency: float = 0.9
    mass: float = 1000.0
    drag_coefficient: float = 0.3
    center_of_mass: Vector = field(default_factory=Vector)
    chassis_width: float = 180.0
    chassis_height: float = 140.0
    downforce_coefficient: float = 0.3
    drag_area: float = 0.0
    inertia_tensor_scale: Vector = field(default_factory=lambda: Vector(1.0, 1.0, 1.0))
    sleep_threshold: float = 10.0
    sleep_slope_limit: float = 0.866
    steering_curve: Curve = ((0.0, 1.0), (10.0, 0.5))
    wheels: list[ChaosWheel] = field(default_factory=list)
    use_sweep_wheel_collision: bool = False

    @classmethod
    def of(cls, control: PhysicsControl) -> ChaosControl:
        """Return a physics control of 0.9."""
        gears = control.forward_gears or [Gear()]
        return cls(
            **{name: getattr(control, own) for name, own in _CONTROL.items()},
            max_torque=max((torque for _, torque in control.torque_curve), default=0.0),
            forward_gear_ratios=[gear.ratio for gear in gears],
            reverse_gear_ratios=[gears[0].ratio],
            change_up_rpm=gears[0].up_ratio * control.max_rpm,
            change_down_rpm=gears[0].down_ratio * control.max_rpm,
            wheels=[ChaosWheel.of(wheel, index) for index, wheel in enumerate(control.wheels)],
        )

    def plain(self) -> PhysicsControl:
        """Return it as a physics control of 0.9, whose curve is scaled so that the greatest torque is `max_torque`."""
        control = PhysicsControl(**{own: getattr(self, name) for name, own in _CONTROL.items()})
        peak = max((torque for _, torque in self.torque_curve), default=0.0)
        scale = self.max_torque / peak if peak > 0 else 1.0
        control.torque_curve = tuple((rpm, torque * scale) for rpm, torque in self.torque_curve)
        shares = [rpm / max(self.max_rpm, 1.0) for rpm in (self.change_down_rpm, self.change_up_rpm)]
        control.forward_gears = [Gear(ratio, *shares) for ratio in self.forward_gear_ratios]
        control.wheels = [wheel.plain() for wheel in self.wheels]
        return control

    @staticmethod
    def completed(control: PhysicsControl, before: PhysicsControl) -> PhysicsControl:
        """Return a physics control of `plain`, with at most as many wheels, with what 0.10 lacks from the one before."""
        wheels = [
            replace(wheel, **_others(old, *_WHEEL.values(), "lat_stiff_value"))
            for wheel, old in zip(control.wheels, before.wheels, strict=False)
        ]
        gears, old_gears = control.forward_gears, before.forward_gears
        if gears and old_gears and _shift_alike(gears[0], old_gears[0]):
            gears = [replace(old_gears[min(n, len(old_gears) - 1)], ratio=gear.ratio) for n, gear in enumerate(gears)]
        others = _others(before, *_CONTROL.values(), "forward_gears", "wheels")
        return replace(control, forward_gears=gears, wheels=wheels, **others)


def _others(record: PhysicsControl | WheelPhysics, *names: str) -> dict[str, Any]:
    """Return the fields of a record but some."""
    return {each.name: getattr(record, each.name) for each in fields(record) if each.name not in names}


def _shift_alike(one: Gear, other: Gear) -> bool:
    """Return whether two gears are shifted at the same rates, within the precision of the protocol."""
    pairs = (one.down_ratio, other.down_ratio), (one.up_ratio, other.up_ratio)
    return all(isclose(*pair, rel_tol=1e-5) for pair in pairs)
