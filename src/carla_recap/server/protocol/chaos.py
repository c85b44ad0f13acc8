"""The physics of vehicles as CARLA 0.10 describes it, for the engine's Chaos physics.

What the simulator's physics does not have is sent with CARLA's defaults, and ignored when a client sets it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from carla_recap.sim.geometry import Vector
from carla_recap.sim.physics.physics_control import Curve, Gear, PhysicsControl, WheelPhysics

_STIFFNESS = 50.0
"""The cornering stiffness of 0.10's usual wheels, 1,000, by that of 0.9's, 20."""


def _down() -> Vector:
    return Vector(0.0, 0.0, -1.0)


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
    suspension_axis: Vector = field(default_factory=_down)
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
            wheel_radius=wheel.radius,
            cornering_stiffness=wheel.lat_stiff_value * _STIFFNESS,
            friction_force_multiplier=wheel.tire_friction,
            max_steer_angle=wheel.max_steer_angle,
            affected_by_steering=bool(wheel.max_steer_angle),
            affected_by_handbrake=bool(wheel.max_handbrake_torque),
            max_brake_torque=wheel.max_brake_torque,
            max_hand_brake_torque=wheel.max_handbrake_torque,
            wheel_index=index,
            location=wheel.position,
            old_location=wheel.position,
        )

    def plain(self) -> WheelPhysics:
        """Return it as a wheel of 0.9."""
        return WheelPhysics(
            tire_friction=self.friction_force_multiplier,
            max_steer_angle=self.max_steer_angle if self.affected_by_steering else 0.0,
            radius=self.wheel_radius,
            max_brake_torque=self.max_brake_torque if self.affected_by_brake else 0.0,
            max_handbrake_torque=self.max_hand_brake_torque if self.affected_by_handbrake else 0.0,
            lat_stiff_value=self.cornering_stiffness / _STIFFNESS,
            position=self.location,
        )


@dataclass(slots=True)
class ChaosControl:
    """How a vehicle moves; lengths in cm, the mass in kg, torques in N m, times in s."""

    torque_curve: Curve
    max_torque: float
    max_rpm: float
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
            control.torque_curve,
            max((torque for _, torque in control.torque_curve), default=0.0),
            control.max_rpm,
            rev_up_moi=control.moi,
            use_automatic_gears=control.use_gear_autobox,
            gear_change_time=control.gear_switch_time,
            final_ratio=control.final_ratio,
            forward_gear_ratios=[gear.ratio for gear in gears],
            reverse_gear_ratios=[gears[0].ratio],
            change_up_rpm=gears[0].up_ratio * control.max_rpm,
            change_down_rpm=gears[0].down_ratio * control.max_rpm,
            mass=control.mass,
            drag_coefficient=control.drag_coefficient,
            center_of_mass=control.center_of_mass,
            steering_curve=control.steering_curve,
            wheels=[ChaosWheel.of(wheel, index) for index, wheel in enumerate(control.wheels)],
            use_sweep_wheel_collision=control.use_sweep_wheel_collision,
        )

    def plain(self) -> PhysicsControl:
        """Return it as a physics control of 0.9, whose curve is scaled so that the greatest torque is `max_torque`."""
        peak = max((torque for _, torque in self.torque_curve), default=0.0)
        scale = self.max_torque / peak if peak > 0 else 1.0
        turns = max(self.max_rpm, 1.0)
        down, up = self.change_down_rpm / turns, self.change_up_rpm / turns
        return PhysicsControl(
            torque_curve=tuple((rpm, torque * scale) for rpm, torque in self.torque_curve),
            max_rpm=self.max_rpm,
            moi=self.rev_up_moi,
            use_gear_autobox=self.use_automatic_gears,
            gear_switch_time=self.gear_change_time,
            final_ratio=self.final_ratio,
            forward_gears=[Gear(ratio, down, up) for ratio in self.forward_gear_ratios],
            mass=self.mass,
            drag_coefficient=self.drag_coefficient,
            center_of_mass=self.center_of_mass,
            steering_curve=self.steering_curve,
            wheels=[wheel.plain() for wheel in self.wheels],
            use_sweep_wheel_collision=self.use_sweep_wheel_collision,
        )
