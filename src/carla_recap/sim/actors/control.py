"""The controls of vehicles and walkers."""

from __future__ import annotations

from dataclasses import dataclass, field

from carla_recap.sim.geometry import Vector


@dataclass(slots=True)
class VehicleControl:
    """The controls of a vehicle.

    Attributes:
        throttle: 0 to 1.
        steer: -1 (left) to 1 (right).
        brake: 0 to 1.
        hand_brake: Whether the hand brake is on.
        reverse: Whether the throttle drives backwards.
        manual_gear_shift: Whether `gear` is used.
        gear: The gear, from 1; 0 is neutral, -1 reverse.
    """

    throttle: float = 0.0
    steer: float = 0.0
    brake: float = 0.0
    hand_brake: bool = False
    reverse: bool = False
    manual_gear_shift: bool = False
    gear: int = 0


@dataclass(slots=True)
class WalkerControl:
    """The control of a walker.

    Attributes:
        direction: The direction in the axes of the world.
        speed: The speed in m/s.
        jump: Whether to jump; accepted without effect.
    """

    direction: Vector = field(default_factory=lambda: Vector(1.0, 0.0, 0.0))
    speed: float = 0.0
    jump: bool = False
