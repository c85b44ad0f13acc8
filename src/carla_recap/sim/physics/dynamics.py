"""How vehicles move: a dynamic bicycle model with tyres that slip, for all vehicles at once.

Speeds are in the vehicle's own axes: forward, to the right, and the rate of its turn. A step keeps the velocity in the
world while the vehicle turns beneath it, adds engine, brakes and drag, and then lets the tyres push sideways, front and
rear, as much as their slip at the end of the step makes them, and never more than friction allows. That is stable at any
speed; at low speed it becomes the motion of wheels that only roll: the radius of a turn is wheelbase / tan(angle).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.physics.drivetrain import GRAVITY, SPEEDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

STILL: Final = 0.02  # m/s and rad/s: what is slower stands
_ROLLING: Final = 0.013  # rolling resistance of car tyres on asphalt, as a share of the weight
_ENGINE_BRAKE: Final = 0.5  # m/s², without throttle
_STEER_RATE: Final = 2.5  # full locks per second, as fast as CARLA's steering input rises
_LEAST_GRIP: Final = 0.4  # the share of the grip that brakes with anti-lock leave for steering
_SIDEWAYS: Final = 1.5  # of the grip ahead: CARLA's traffic manager enters bends of 8 m at 11 m/s, and stays in its lane
_SLIP_SPEED: Final = 0.02  # m/s: keeps the slip of standing wheels finite


def advance(fleet: Vehicles, seconds: float) -> None:
    """Take the speeds of the vehicles that are awake one step on, as their controls and tyres have it."""
    speed = np.minimum((np.abs(fleet.speed) / SPEEDS[1]).astype(np.int64), len(SPEEDS) - 1)
    every = np.arange(len(fleet))
    _steer(fleet, fleet.lock_share[every, speed], seconds)
    drive = _drive(fleet, every, speed)
    forward, right, turning = _slide(fleet, drive, seconds)
    np.copyto(fleet.speed, forward, where=fleet.awake)
    np.copyto(fleet.sideways, right, where=fleet.awake)
    np.copyto(fleet.turning, turning, where=fleet.awake)


def _steer(fleet: Vehicles, share: Floats, seconds: float) -> None:
    np.multiply(fleet.full_lock, share, out=fleet.steer_limit)
    most = _STEER_RATE * seconds * fleet.full_lock
    missing = _within(fleet.steer, -1, 1) * fleet.steer_limit - fleet.steer_angle
    fleet.steer_angle += _within(missing, -most, most)


def _drive(fleet: Vehicles, every: Integers, speed: Integers) -> Floats:
    """The force of the engine in N, negative backwards; also shifts the gears."""
    automatic = np.where(fleet.reverse, -1, fleet.usual_gear[every, speed])
    np.copyto(fleet.gear, automatic, where=~fleet.manual)
    backwards = fleet.reverse | (fleet.gear < 0)
    force = np.where(fleet.manual | backwards, fleet.forces[every, fleet.gear, speed], fleet.best_force[every, speed])
    force = np.minimum(_within(fleet.throttle, 0, 1) * force, fleet.traction)
    return np.where(backwards, -force, force)


def _slide(fleet: Vehicles, drive: Floats, seconds: float) -> tuple[Floats, Floats, Floats]:
    """The speeds after a step.

    Args:
        fleet: The vehicles.
        drive: The forces of the engines in N.
        seconds: How long the step is.
    """
    mass, front, rear = fleet.mass, fleet.front, fleet.rear
    grip = fleet.front_grip, fleet.rear_grip
    brake = _within(fleet.brake, 0, 1)
    front_brake, rear_brake = np.minimum(brake * fleet.front_brake, grip[0]), np.minimum(brake * fleet.rear_brake, grip[1])
    turned = fleet.turning * seconds
    cos, sin = np.cos(turned), np.sin(turned)
    forward = cos * fleet.speed + sin * fleet.sideways
    right = cos * fleet.sideways - sin * fleet.speed
    turning = fleet.turning
    rear_slip = right - rear * turning
    locked = fleet.hand_brake
    skid = np.hypot(forward, rear_slip) + _SLIP_SPEED
    rear_brake = np.where(locked, grip[1] * (np.abs(forward) + _SLIP_SPEED) / skid, rear_brake)

    engine_brake = np.where(fleet.throttle > 0, 0.0, _ENGINE_BRAKE * mass)
    resistance = np.minimum(front_brake + rear_brake + engine_brake, grip[0] + grip[1])
    resistance += np.minimum(_ROLLING * GRAVITY * mass, grip[0] + grip[1]) + fleet.air * forward * forward
    forward = forward + drive / mass * seconds
    forward = np.sign(forward) * np.maximum(np.abs(forward) - resistance / mass * seconds, 0.0)

    sliding = grip[1] * (np.abs(rear_slip) + _SLIP_SPEED) / skid
    hold = _left_over(front_brake, grip[0]), np.where(locked, sliding, _left_over(rear_brake, grip[1]))
    moment, per_mass = fleet.moment, seconds / mass
    cos, sin = np.cos(fleet.steer_angle), np.sin(fleet.steer_angle)
    nose = right + front * turning
    front_slip = cos * nose - sin * forward
    soft = fleet.softness
    a = (np.abs(cos * forward + sin * nose) + _SLIP_SPEED) * soft / rear + per_mass + seconds * (cos * front) ** 2 / moment
    b = cos * (per_mass - seconds * front * rear / moment)
    c = (np.abs(forward) + _SLIP_SPEED) * soft / front + per_mass + seconds * rear**2 / moment
    at_front = _within((c * front_slip - b * rear_slip) / (a * c - b * b), -hold[0], hold[0])
    at_rear = _within((rear_slip - b * at_front) / c, -hold[1], hold[1])
    at_front = _within((front_slip - b * at_rear) / a, -hold[0], hold[0])
    return (
        forward + sin * at_front * per_mass,
        right - (cos * at_front + at_rear) * per_mass,
        turning - (cos * front * at_front - rear * at_rear) * seconds / moment,
    )


def _left_over(used: Floats, grip: Floats) -> Floats:
    """What the friction circle, an ellipse here, leaves of a grip for sideways forces."""
    return _SIDEWAYS * np.sqrt(np.maximum(grip * grip - used * used, (_LEAST_GRIP * grip) ** 2))


def _within(values: Floats, least: Floats | float, most: Floats | float) -> Floats:
    """What np.clip does, in half of the time for short arrays."""
    within: Floats = np.minimum(np.maximum(values, least), most)
    return within
