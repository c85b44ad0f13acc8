"""What drivers and walkers are told to do."""

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
        hand_brake: Whether it is drawn.
        reverse: Whether the throttle drives backwards.
        manual_gear_shift: Whether `gear` counts.
        gear: From 1; 0 is neutral, -1 reverse.
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
    """Where and how fast to walk.

    Attributes:
        direction: In the world.
        speed: In m/s.
        jump: Whether to jump: accepted, and nothing comes of it.
    """

    direction: Vector = field(default_factory=lambda: Vector(1.0, 0.0, 0.0))
    speed: float = 0.0
    jump: bool = False
