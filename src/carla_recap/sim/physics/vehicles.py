"""All vehicles as a struct of arrays: their controls, what follows from their physics controls, and their motion.

Vehicles are dynamic bicycle models with tyres that slip. Speeds are in the vehicle's own axes: forward, to the right, and
the yaw rate. A step keeps the velocity in the world while the vehicle turns, adds engine, brakes and drag, and then the
lateral forces of the tyres, front and rear, by their slip at the end of the step, limited by friction. That is stable at any
speed; at low speed it becomes the motion of rolling wheels: the radius of a turn is wheelbase / tan(angle).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.motion import GRAVITY
from carla_recap.sim.columns import StructOfArrays, column
from carla_recap.sim.physics.moving_bodies import MovingBodies
from carla_recap.sim.physics.physics_control import GEARS, SPEEDS, columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.sim.geometry import Box
    from carla_recap.sim.physics.moving_bodies import Height
    from carla_recap.sim.physics.physics_control import PhysicsControl
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.util.arrays import Booleans, Floats, Integers


_STILL: Final = 0.02  # m/s and rad/s: slower vehicles stand
_ROLLING: Final = 0.013  # rolling resistance of car tyres on asphalt, as a share of the weight
_ENGINE_BRAKE: Final = 0.5  # m/s², without throttle
_COASTING: Final = -0.4  # m/s², besides resistance: pedals brake only for a stronger deceleration
_STEER_RATE: Final = 2.5  # full locks per second, as fast as CARLA's steering input rises
_LEAST_GRIP: Final = 0.4  # the share of the grip that brakes with anti-lock leave for steering
_SIDEWAYS: Final = 1.5  # of the grip ahead: CARLA's traffic manager enters bends of 8 m at 11 m/s, and stays in its lane
_SLIP_SPEED: Final = 0.02  # m/s: keeps the slip of standing wheels finite
_TABLE: Final = np.zeros(len(SPEEDS))
_STEEPEST: Final = 0.5  # the slope of a road, rise by run
_LEAST: Final = np.array([[0.0], [-1.0], [0.0]])  # of throttle, steering and brake


class DriveTables(StructOfArrays):
    """What engine, gearbox and steering give by speed; vehicles of one physics control share a row."""

    forces: Floats = column(np.zeros((GEARS, len(_TABLE))))
    """The greatest force of the engine by gear and speed, in N, (n, gears, speeds); see `physics_control`."""
    best_force: Floats = column(_TABLE)
    """The greatest of them by speed, in N, (n, speeds)."""
    usual_gear: NDArray[np.int64] = column(_TABLE.astype(np.int64))
    """The gear of moderate driving by speed, (n, speeds)."""
    lock_share: Floats = column(_TABLE)
    """The share of the full lock that steering reaches, by speed, (n, speeds)."""

    def __init__(self) -> None:
        super().__init__()
        self._keys: list[bytes] = []

    def row(self, values: Mapping[str, NDArray[Any]], used: Integers) -> int:
        """Return the row of some values, which is one that is not used yet if none has them."""
        key = b"".join(values[name].tobytes() for name in self.COLUMNS)
        if key in self._keys:
            return self._keys.index(key)
        free = np.setdiff1d(np.arange(len(self)), used)
        if not len(free):
            self._keys.append(key)
            return self.append_row(**values)
        row = int(free[0])
        self._keys[row] = key
        for name, value in values.items():
            getattr(self, name)[row] = value
        return row


class Vehicles(MovingBodies):
    """The vehicles; row i of each array belongs to `actors[i]`."""

    throttle: Floats = column(0.0)
    """The throttle, 0 to 1."""
    steer: Floats = column(0.0)
    """The steering, -1 (left) to 1 (right), relative to `steer_limit`."""
    brake: Floats = column(0.0)
    """The brake, 0 to 1."""
    hand_brake: Booleans = column(False)
    """Whether the hand brake is drawn, which locks the rear wheels."""
    reverse: Booleans = column(False)
    """Whether the throttle drives backwards."""
    gear: NDArray[np.int64] = column(np.int64(1))
    """The gear as reported: from 1, 0 neutral, -1 reverse."""
    manual: Booleans = column(False)
    """Whether `gear` is part of the control; else the gearbox is automatic."""
    light_state: NDArray[np.uint32] = column(np.uint32(0))
    """CARLA's light bits."""
    autopilot: Booleans = column(False)
    """Whether the autopilot drives."""
    sticky: Booleans = column(True)
    """Whether a control holds until the next one; else it holds for a tick."""
    controlled: Booleans = column(False)
    """Whether a control was applied since the latest tick."""
    speed: Floats = column(0.0)
    """The speed forward in m/s; negative backwards."""
    sideways: Floats = column(0.0)
    """The speed to the right, in m/s."""
    turning: Floats = column(0.0)
    """The yaw rate in rad/s, positive to the right."""
    steer_angle: Floats = column(0.0)
    """The angle of the front wheels in radians, positive to the right."""
    steer_limit: Floats = column(1.0)
    """The angle of the front wheels at full steering and the present speed, in radians."""
    awake: Booleans = column(False)
    """Whether it moves, or is about to."""
    force: Floats = column(np.zeros(2))
    """The external force of the next tick, in N, (n, 2)."""
    wheelbase: Floats = column(1.0)
    """The distance between the axles in m."""
    front: Floats = column(0.5)
    """The distance from its origin to the front axle in m."""
    rear: Floats = column(0.5)
    """The distance from its origin to the rear axle in m."""
    moment: Floats = column(1.0)
    """The moment of inertia in kg m²."""
    traction: Floats = column(0.0)
    """The greatest force of the driven wheels, in N."""
    front_grip: Floats = column(0.0)
    """The greatest force of the front tyres, in N."""
    rear_grip: Floats = column(0.0)
    """The greatest force of the rear tyres, in N."""
    softness: Floats = column(1.0)
    """The softness of the tyres in m/N: slip angle per lateral force, times the rolling speed."""
    air: Floats = column(0.0)
    """The drag of the air: the force in N at 1 m/s."""
    front_brake: Floats = column(0.0)
    """The greatest force of the front brakes, in N."""
    rear_brake: Floats = column(0.0)
    """The greatest force of the rear brakes, in N."""
    full_lock: Floats = column(1.0)
    """The greatest angle of the front wheels, in radians."""
    table: Integers = column(np.int64(0))
    """The rows of `tables` that are theirs."""

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self._written = np.empty((0, 3))
        self._moved = np.empty(0, np.bool_)
        self.tables = DriveTables()

    def set_physics(self, row: int, control: PhysicsControl, box: Box) -> None:
        """Set the columns that follow from a physics control."""
        values = columns(control, box, weightless=bool(self.weightless[row]))
        tables = {name: values.pop(name) for name in DriveTables.COLUMNS}
        self.table[row] = self.tables.row(tables, np.delete(self.table, row))
        for name, value in values.items():
            getattr(self, name)[row] = value
        if self.simulated[row]:
            self.bodies[row].mass, self.bodies[row].moment = self.mass[row].item(), self.moment[row].item()

    def set_velocity(self, row: int, x: float, y: float, z: float) -> None:
        """See `MovingBodies.set_velocity`."""
        super().set_velocity(row, x, y, z)
        yaw = np.radians(self.rotation[row, 1])
        self.speed[row] = np.cos(yaw) * x + np.sin(yaw) * y
        self.sideways[row] = np.cos(yaw) * y - np.sin(yaw) * x

    def drive(self, rows: list[int], pedals: Floats, hand_brake: Sequence[bool], reverse: Sequence[bool]) -> None:
        """Apply controls to some vehicles, as `Vehicle.apply_control` does, with automatic gearboxes.

        Args:
            rows: Their rows.
            pedals: Throttle, steering and brake, all finite, (3, n).
            hand_brake: Whether the hand brakes are drawn.
            reverse: Whether the throttle drives backwards.
        """
        self.throttle[rows], self.steer[rows], self.brake[rows] = np.clip(pedals, _LEAST, 1.0)
        self.hand_brake[rows] = hand_brake
        self.reverse[rows] = reverse
        self.manual[rows] = False
        self.controlled[rows] = True

    def pedals(self, rows: Integers, acceleration: Floats, backwards: Booleans | bool = False) -> tuple[Floats, Floats]:
        """Return throttle and brake, 0 to 1 each, for accelerations of vehicles; one of the two is 0.

        Args:
            rows: Their rows, (n,).
            acceleration: The accelerations in the direction of the gear, in m/s², (n,).
            backwards: Whether that is backwards, (n,).
        """
        speed, mass = np.maximum(np.where(backwards, -self.speed[rows], self.speed[rows]), 0), self.mass[rows]
        column = _column_of(speed)
        resistance = self.air[rows] * speed * speed + mass * (GRAVITY * _ROLLING)
        coasting = mass * _COASTING - resistance
        force = mass * acceleration
        tables, own = self.tables, self.table[rows]
        best = np.maximum(np.where(backwards, tables.forces[own, -1, column], tables.best_force[own, column]), 1.0)
        throttle = np.clip((force + resistance) / best, 0, 1)
        brakes = np.maximum(self.front_brake[rows] + self.rear_brake[rows], 1.0)
        brake = np.clip((coasting - force) / brakes, 0, 1)
        slowing = acceleration < 0
        return np.where(slowing, np.where(force > coasting, throttle, 0), throttle), np.where(slowing, brake, 0)

    def _moment(self, row: int) -> float:
        return float(self.moment[row])

    def begin_tick(self, seconds: float) -> bool:
        """See `MovingBodies.begin_tick`; forces act now."""
        if not self.sticky.all():
            self._release_controls()
        if self.force.any():
            self.add_velocities(np.where(self.simulated[:, None], self.force * seconds / self.mass[:, None], 0.0))
            self.force[:] = 0
        slow = (self.speed != 0) | (self.sideways != 0) | (self.turning != 0)  # what is too slow to go on has yet to stop
        self.awake = self._in_motion() | slow & self.simulated
        self._before = self.velocity.copy()
        self._moved = self.awake | self.unsettled & self.simulated
        return bool(self.awake.any())

    def _release_controls(self) -> None:
        """Reset the controls that held for the latest tick alone."""
        released = ~self.sticky & ~self.controlled
        for values in (self.throttle, self.steer, self.brake, self.hand_brake, self.reverse, self.manual):
            values[released] = 0
        self.controlled[:] = False

    def add_velocities(self, change: Floats) -> None:
        """Add velocities in m/s, in the world, (n, 2)."""
        yaw = np.radians(self.rotation[:, 1])
        cos, sin = np.cos(yaw), np.sin(yaw)
        self.speed += cos * change[:, 0] + sin * change[:, 1]
        self.sideways += cos * change[:, 1] - sin * change[:, 0]

    def write_velocities(self, seconds: float) -> None:
        """See `MovingBodies.write_velocities`."""
        _advance(self, seconds)
        in_motion = self._in_motion()
        for values in (self.speed, self.sideways, self.turning):
            values[self.awake & ~in_motion] = 0
        yaw = np.radians(self.rotation[:, 1]) + self.turning * seconds / 2
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y = cos * self.speed - sin * self.sideways, sin * self.speed + cos * self.sideways
        velocities = self._written = np.stack((x, y, self.turning), axis=1)
        velocities[~self.simulated] = 0
        self.set_body_velocities(self.awake, velocities)
        self.awake = in_motion

    def read_bodies(self) -> None:
        """See `MovingBodies.read_bodies`."""
        states = self.plane.states(self.body_id)
        moving = self.simulated
        self.position[moving, :2] = states[moving, :2]
        yaw = (np.degrees(states[moving, 2]) + 180) % 360 - 180
        self.rotation[moving, 1] = np.where(yaw == -180, 180.0, yaw)  # within (-180, 180], as CARLA's
        change = states[:, 3:] - self._written
        hit = moving & change.any(axis=1)
        if hit.any():
            change[~hit] = 0
            self.add_velocities(change[:, :2])
            self.turning += change[:, 2]
            self.awake |= hit
        self._moved |= self.awake

    def end_tick(self, seconds: float) -> None:
        """See `MovingBodies.end_tick`."""
        rows = np.flatnonzero(self._moved)
        if not len(rows):
            self.acceleration[self.simulated] = 0
            return
        self._settle(rows, seconds)
        yaw = np.radians(self.rotation[:, 1])
        cos, sin = np.cos(yaw), np.sin(yaw)
        moved = self._moved
        self.velocity[moved, 0] = (cos * self.speed - sin * self.sideways)[moved]
        self.velocity[moved, 1] = (sin * self.speed + cos * self.sideways)[moved]
        self.angular_velocity[moved, 2] = np.degrees(self.turning)[moved]
        self._accelerate(seconds)

    def _settle(self, rows: NDArray[np.intp], seconds: float) -> None:
        """Set the heights and pitches of vehicles by the road below their axles."""
        yaw = np.radians(self.rotation[rows, 1])
        cos, sin = np.cos(yaw), np.sin(yaw)
        front, rear = self.front[rows], self.rear[rows]
        x, y = self.position[rows, 0], self.position[rows, 1]
        z = self.position[rows, 2]
        heights = self._height(
            np.concatenate((x + cos * front, x - cos * rear)),
            np.concatenate((y + sin * front, y - sin * rear)),
            np.concatenate((z, z)),
        )
        high, low = heights[: len(rows)], heights[len(rows) :]
        wheelbase = self.wheelbase[rows]
        steep = np.abs(high - low) > _STEEPEST * wheelbase  # one axle is beyond the edge of a bridge
        if steep.any():
            nearer = np.where(np.abs(high - z) < np.abs(low - z), high, low)
            high, low = np.where(steep, nearer, high), np.where(steep, nearer, low)
        near = self._stand(rows, low + (high - low) * rear / wheelbase, seconds)
        rows = rows[near]
        self.rotation[rows, 0] = np.degrees(np.arctan2(high - low, wheelbase))[near]
        self.rotation[rows, 2] = 0

    def _in_motion(self) -> Booleans:
        moving = (np.abs(self.speed) > _STILL) | (np.abs(self.sideways) > _STILL)
        moving |= (np.abs(self.turning) > _STILL) | (self.throttle > 0)
        in_motion: Booleans = moving & self.simulated
        return in_motion


def _column_of(speed: Floats) -> Integers:
    """Return the columns of the tables for speeds in m/s."""
    column: Integers = np.minimum((speed / SPEEDS[1]).astype(np.int64), len(SPEEDS) - 1)
    return column


def _advance(fleet: Vehicles, seconds: float) -> None:
    """Advance the speeds of the vehicles that are awake by a step of a length in s."""
    speed = _column_of(np.abs(fleet.speed))
    _steer(fleet, fleet.tables.lock_share[fleet.table, speed], seconds)
    drive = _drive(fleet, speed)
    forward, right, turning = _slide(fleet, drive, seconds)
    np.copyto(fleet.speed, forward, where=fleet.awake)
    np.copyto(fleet.sideways, right, where=fleet.awake)
    np.copyto(fleet.turning, turning, where=fleet.awake)


def _steer(fleet: Vehicles, share: Floats, seconds: float) -> None:
    np.multiply(fleet.full_lock, share, out=fleet.steer_limit)
    most = _STEER_RATE * seconds * fleet.full_lock
    missing = _within(fleet.steer, -1, 1) * fleet.steer_limit - fleet.steer_angle
    fleet.steer_angle += _within(missing, -most, most)


def _drive(fleet: Vehicles, speed: Integers) -> Floats:
    """Return the forces of the engines in N, negative backwards, and shift the gears."""
    tables, own = fleet.tables, fleet.table
    automatic = np.where(fleet.reverse, -1, tables.usual_gear[own, speed])
    np.copyto(fleet.gear, automatic, where=~fleet.manual)
    backwards = fleet.reverse | (fleet.gear < 0)
    force = np.where(fleet.manual | backwards, tables.forces[own, fleet.gear, speed], tables.best_force[own, speed])
    force = np.minimum(_within(fleet.throttle, 0, 1) * force, fleet.traction)
    return np.where(backwards, -force, force)


def _slide(fleet: Vehicles, drive: Floats, seconds: float) -> tuple[Floats, Floats, Floats]:
    """Return the speeds after a step: forward, to the right, and the yaw rate.

    A tyre gives a lateral force by its slip, and that force changes the slip. Both axles therefore get the forces that fit
    the slips at the end of the step, which are force times softness times rolling speed. These are two linear equations,

        a * front + b * rear = slip of the front axle,
        b * front + c * rear = slip of the rear axle,

    with the slips without any force on the right. a and c are what a force takes off the slip of its own axle, plus the
    softness of the tyres there; b is what it takes off that of the other axle. Where a force would exceed the grip of its
    axle, it is the grip, and the other force is computed again for that.

    Args:
        fleet: The vehicles.
        drive: The forces of the engines in N.
        seconds: The length of the step.
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
    """Return the lateral force that the friction ellipse leaves, in N."""
    return _SIDEWAYS * np.sqrt(np.maximum(grip * grip - used * used, (_LEAST_GRIP * grip) ** 2))


def _within(values: Floats, least: Floats | float, most: Floats | float) -> Floats:
    """Return the same as np.clip, in half of the time for short arrays."""
    within: Floats = np.minimum(np.maximum(values, least), most)
    return within
