"""How vehicles drive: engine, clutch, gearbox, wheels and tyres of all at once, as in the engine of CARLA.

That is PhysX 3's vehicle with four driven wheels (its guide's chapter Vehicles, and PxVehicleUpdate.cpp) as UE4 sets it up.
Four wheels and the engine turn; a clutch couples the engine to the mean of the wheels. They are integrated together and
backwards, so that any clutch is stable. The force of a tyre follows from its slips, lengthwise and sideways, as in the
Michigan model: it grows by its stiffnesses, and saturates at its friction. Loads are those at rest.

PhysX takes the force of a tyre from before the step, which makes stiff tyres oscillate at 5 to 15 m/s in steps of 0.01 s; so
they do in CARLA's recordings, whose cars accelerate less there. `advance` does so, too, in CARLA's own steps, 0.01 s at
most, a third of it below 5 m/s. For the vehicles of the autopilot, whose drives need not be CARLA's to the point, it takes
steps of 0.05 s at most, with tyres that follow the change of their slips within a step. So do those of vehicles that roll
slowly without throttle: they come to rest.
"""

from __future__ import annotations

from math import ceil, inf, pi
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.sim.columns import StructOfArrays, column
from carla_recap.sim.physics.moving_bodies import MovingBodies
from carla_recap.sim.physics.physics_control import CORNERS, GEARS, SPEEDS, TORQUES, WHEEL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.sim.physics.moving_bodies import Height
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.util.arrays import Booleans, Floats, Integers

_STEP: Final = 0.01  # s: CARLA's default of the longest step of physics
_LONG_STEP: Final = 0.05  # s: the longest step of the autopilot's vehicles; motorcycles swing in ones of 0.1 s
_ROUNDING: Final = 1e-6
_SLOW: Final = 5.0  # m/s: below, PhysX divides a step by three
_SLOW_STEPS: Final = 3
_LEAST_SLIP_SPEED: Final = 0.1  # m/s, added below the slip of wheels that are driven or braked
_LEAST_SIDE_SPEED: Final = 1.0  # m/s, added below the slip sideways
_KEPT: Final = 8
_TINY: Final = 1e-9
_STICKY_SPEED: Final = 0.2  # m/s: slower vehicles whose wheels are locked stand, and others after a second
_STICKY_TIME: Final = 1.0  # s
_PEDALS, _STEERING = (6.0, 10.0), (2.5, 5.0)
"""1/s, by which the pedals and the steering of UE4's vehicles rise and fall at most."""
_sum: Final = np.add.reduce  # over the corners


class DriveTables(StructOfArrays):
    """The parameters of drivetrains; vehicles of one physics control share a row. See `physics_control.parameters`."""

    wheels: Floats = column(np.zeros((len(WHEEL), CORNERS)))
    """The parameters `WHEEL` of each corner: places from the centre of mass in m, radius in m, moment of inertia in kg m²,
    damping in kg m²/s, friction times load in N, stiffness in N sideways and lengthwise, torques of the brakes in N m."""
    centre: Floats = column(0.0)
    """How far the centre of mass is ahead of the origin, in m."""
    full_lock: Floats = column(0.0)
    """The greatest angle of the inner front wheel in radians."""
    track: Floats = column(1.0)
    """The distance between left and right wheels in m."""
    torques: Floats = column(np.zeros(TORQUES + 1))
    """The torque of the engine in N m, from no revolutions to the most."""
    most_turns: Floats = column(0.0)
    """The most revolutions of the engine in rad/s."""
    engine_inertia: Floats = column(1.0)
    """The moment of inertia of the engine in kg m²."""
    damping: Floats = column(np.zeros(3))
    """The damping of the engine in kg m²/s: at full throttle, and without throttle in a gear and in neutral."""
    clutch: Floats = column(0.0)
    """The strength of the clutch in kg m²/s."""
    ratios: Floats = column(np.zeros(GEARS))
    """Engine by wheels, by gear; 0 in neutral, negative in reverse."""
    up: Floats = column(np.zeros(GEARS))
    """The share of the most revolutions above which the gearbox shifts up, by gear."""
    down: Floats = column(np.zeros(GEARS))
    """The share of the most revolutions below which it shifts down, by gear."""
    switch_time: Floats = column(0.0)
    """How long it is in neutral when it shifts, in s."""
    latency: Floats = column(0.0)
    """The least time between two shifts in s; infinite for a gearbox that does not shift by itself."""
    lock_share: Floats = column(np.zeros(len(SPEEDS)))
    """The share of the full lock that steering reaches, by speed."""

    def __init__(self) -> None:
        super().__init__()
        self._keys: list[bytes] = []
        self._of: dict[bytes, _Parameters] = {}

    def of(self, own: Integers) -> _Parameters:
        """Return the parameters of vehicles by their rows here; the latest few are kept."""
        key = own.tobytes()
        if key not in self._of:
            if len(self._of) == _KEPT:
                self._of.clear()
            self._of[key] = _Parameters(self, own)
        return self._of[key]

    def row(self, values: Mapping[str, Any], used: Integers) -> int:
        """Return the row of some values, which is one that is not used yet if none has them."""
        key = b"".join(np.asarray(values[name], float).tobytes() for name in self.COLUMNS)
        if key in self._keys:
            return self._keys.index(key)
        free = np.setdiff1d(np.arange(len(self)), used)
        if not len(free):
            self._keys.append(key)
            return self.append_row(**values)
        row = int(free[0])
        self._keys[row] = key
        self._of.clear()
        for name, value in values.items():
            getattr(self, name)[row] = value
        return row


class Drivetrains(MovingBodies):
    """The controls of vehicles, and what moves in them; row i of each array belongs to `actors[i]`."""

    throttle: Floats = column(0.0)
    """The throttle, 0 to 1."""
    steer: Floats = column(0.0)
    """The steering, -1 (left) to 1 (right), relative to `steer_limit`."""
    brake: Floats = column(0.0)
    """The brake, 0 to 1."""
    hand_brake: Booleans = column(False)
    """Whether the hand brake is drawn."""
    throttle_input: Floats = column(0.0)
    """The throttle that has reached the engine: inputs take their time."""
    steer_input: Floats = column(0.0)
    """The steering that has reached the wheels."""
    brake_input: Floats = column(0.0)
    """The brake that has reached the wheels."""
    reverse: Booleans = column(False)
    """Whether the throttle drives backwards."""
    gear: Integers = column(np.int64(0))
    """The gear: from 1, 0 neutral, -1 reverse."""
    target_gear: Integers = column(np.int64(0))
    """The gear that the gearbox shifts to."""
    shift_time: Floats = column(0.0)
    """How long it has been shifting, in s."""
    since_shift: Floats = column(inf)
    """The time since the gearbox began to shift by itself, in s."""
    engine: Floats = column(0.0)
    """The speed of the engine in rad/s."""
    omega: Floats = column(np.zeros(CORNERS))
    """The speeds of the wheels in rad/s, (n, corners)."""
    slow_time: Floats = column(0.0)
    """How long it has hardly been moving, in s."""
    manual: Booleans = column(False)
    """Whether `gear` is part of the control; else the gearbox is automatic."""
    speed: Floats = column(0.0)
    """The speed forward in m/s; negative backwards."""
    sideways: Floats = column(0.0)
    """The speed to the right, in m/s."""
    turning: Floats = column(0.0)
    """The yaw rate in rad/s, positive to the right."""
    steer_angle: Floats = column(0.0)
    """The angle between those of the front wheels in radians, positive to the right."""
    steer_limit: Floats = column(1.0)
    """The angle of the inner front wheel at full steering and the present speed, in radians."""
    wheelbase: Floats = column(1.0)
    """The distance between the axles in m."""
    front: Floats = column(0.5)
    """The distance from its origin to the front axle in m."""
    rear: Floats = column(0.5)
    """The distance from its origin to the rear axle in m."""
    air: Floats = column(0.0)
    """The drag of the air: the force in N at 1 m/s."""
    table: Integers = column(np.int64(0))
    """The rows of `tables` that are theirs."""

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self.tables = DriveTables()


class _Parameters:
    """The parameters of some vehicles: arrays with a column for each, and a row for each corner where there are four."""

    def __init__(self, tables: DriveTables, own: Integers) -> None:
        wheels = np.ascontiguousarray(tables.wheels[own].transpose(1, 2, 0))
        self.x, self.y, self.radius, inertia, self.damping, self.grip, self.lateral, self.longitudinal, *brakes = wheels
        self.brake, self.hand_brake = brakes
        self.per_inertia = 1 / inertia
        self.per_grip = 1 / np.maximum(self.grip, _TINY)
        stiffnesses = self.lateral / np.maximum(self.longitudinal, _TINY)
        self.most_weighting, self.less_weighting = 0.5 * (1 + stiffnesses), 0.5 * (1 - stiffnesses)
        self.most_turns, self.clutch = tables.most_turns[own], tables.clutch[own]
        self.per_turn = TORQUES / np.maximum(self.most_turns, _TINY)
        self.per_engine = 1 / tables.engine_inertia[own]
        self.full, self.engaged, self.disengaged = np.ascontiguousarray(tables.damping[own].T)
        self.centre, self.track, self.full_lock = tables.centre[own], tables.track[own], tables.full_lock[own]
        self.latency, self.switch_time = tables.latency[own], tables.switch_time[own]
        self.brakes, self.wheel_damping, self.wheel_inertia = _sum(brakes[0]), _sum(self.damping), _sum(inertia)


def column_of(speed: Floats) -> Integers:
    """Return the columns of the tables for speeds in m/s."""
    found: Integers = np.fmin(speed / SPEEDS[1], len(SPEEDS) - 1).astype(np.int64)
    return found


def steer(fleet: Drivetrains, seconds: float) -> None:
    """Let the steering follow its control for a tick of a length in s."""
    steered = fleet.steer_input[:] = _follow(fleet.steer_input, fleet.steer, _STEERING, seconds)
    own = fleet.tables.of(fleet.table)
    limit = own.full_lock * fleet.tables.lock_share[fleet.table, column_of(np.abs(fleet.speed))]
    # The angle between those of the front wheels has a cotangent between theirs, which differ by track / wheelbase.
    inner = np.tan(limit * np.abs(steered))
    fleet.steer_angle[:] = np.copysign(np.arctan(inner / (1 + inner * own.track / (2 * fleet.wheelbase))), steered)
    fleet.steer_limit[:] = np.maximum(limit, _TINY)


def _follow(values: Floats, wanted: Floats, rates: tuple[float, float], seconds: float) -> Floats:
    """Return inputs that have followed what is wanted for a time in s: away from 0 by one rate, and back by another."""
    change = wanted - values
    most = np.where(change * values >= 0, rates[0], rates[1]) * seconds
    found: Floats = values + np.minimum(np.maximum(change, -most), most)
    return found


def advance(fleet: Drivetrains, rows: Integers, seconds: float, *, exactly: bool) -> tuple[Floats, Floats, Floats]:
    """Drive the vehicles of some rows for a time in s, `exactly` as CARLA does, in its steps, or in longer ones.

    Return how far their origins have moved, ahead and to the right of how they stood, in m, and their turn in radians.
    """
    drive = _Drive(fleet, rows)
    steps = max(ceil(seconds / (_STEP if exactly else _LONG_STEP) - _ROUNDING), 1)
    for _ in range(steps):
        drive.begin(seconds / steps)
        if exactly:
            drive.step_exactly(seconds / steps)
        else:
            drive.step(np.full(len(rows), seconds / steps), np.ones(len(rows), np.bool_))
    return drive.write(seconds)


class _Drive:
    """Some vehicles while they are driven: x and y are ahead and to the right of how they stood at first.

    Arrays have a column for each vehicle, and a row for each corner where there are four.
    """

    def __init__(self, fleet: Drivetrains, rows: Integers) -> None:
        self.fleet, self.rows = fleet, rows
        self.table = fleet.table[rows]
        self.own = fleet.tables.of(self.table)
        hand_brake = fleet.hand_brake[rows]
        self.held = hand_brake * self.own.hand_brake
        self.share = np.full((CORNERS, len(rows)), 1 / CORNERS)
        self.share[:2, hand_brake], self.share[2:, hand_brake] = 0.5, 0.0  # PhysX's: drive at the front alone
        self.mass, self.moment, self.air = fleet.mass[rows], fleet.moment[rows], fleet.air[rows]
        self.cos, self.sin = self._front_wheels()
        self.pedals = np.array((fleet.throttle_input[rows], fleet.brake_input[rows]))
        self.wanted = np.array((fleet.throttle[rows], fleet.brake[rows]))
        self.manual, self.gear, self.target = fleet.manual[rows], fleet.gear[rows], fleet.target_gear[rows]
        self.shift_time, self.since_shift = fleet.shift_time[rows], fleet.since_shift[rows]
        self.turning = fleet.turning[rows]
        self.vx, self.vy = fleet.speed[rows], fleet.sideways[rows] + self.turning * self.own.centre
        self.yaw, self.moved_x, self.moved_y = np.zeros((3, len(rows)))
        self.omega, self.engine = np.ascontiguousarray(fleet.omega[rows].T), fleet.engine[rows]

    def begin(self, seconds: float) -> None:
        """Begin a step of a length in s: pedals, and gears; an automatic shift takes the throttle away."""
        own = self.own
        self.pedals = _follow(self.pedals, self.wanted, _PEDALS, seconds)
        throttle, brake = self.pedals
        self.brakes = brake * own.brake + self.held
        self.braked = self.brakes > 0
        self._shift(seconds)
        neutral = self.gear == 0
        shifting = (self.gear != self.target) & ~self.manual
        self.ratio = self.fleet.tables.ratios[self.table, self.gear]
        self.strength = own.clutch * ~neutral
        self.accelerator = throttle * ~shifting
        without = np.where(neutral, own.disengaged, own.engaged)
        self.engine_damping = without + (own.full - without) * self.accelerator

    def _front_wheels(self) -> tuple[Floats, Floats]:
        """Return cosine and sine of the angles of the wheels: those of the front ones meet at the axis of the rear ones."""
        between = np.tan(self.fleet.steer_angle[self.rows])
        by_track = between * self.own.track / (2 * self.fleet.wheelbase[self.rows])
        tangents = np.zeros_like(self.own.x)
        tangents[0], tangents[1] = between / (1 + by_track), between / np.maximum(1 - by_track, _TINY)
        cos: Floats = 1 / np.sqrt(1 + tangents * tangents)
        return cos, cos * tangents

    def _shift(self, seconds: float) -> None:
        """Let the gearboxes work for a step of a length in s; a shift goes by way of neutral."""
        own, tables = self.own, self.fleet.tables
        turns = self.engine * own.per_turn / TORQUES
        ready = (self.gear == self.target) & (self.since_shift > own.latency) & ~self.manual & (self.gear >= 0)
        up = ready & (turns > tables.up[self.table, self.gear])
        down = ready & (turns < tables.down[self.table, self.gear])
        self.since_shift += seconds
        begins = up | down
        if begins.any():
            self.target = self.target + up - down
            self.gear[begins], self.shift_time[begins], self.since_shift[begins] = 0, 0.0, 0.0
        changing = self.gear != self.target
        if changing.any():
            done = changing & (self.shift_time > own.switch_time)
            self.gear[done] = self.target[done]
            self.shift_time += seconds

    def step_exactly(self, seconds: float) -> None:
        """Advance as PhysX does: a slow vehicle in three parts, and one that rolls slowly without throttle to its rest."""
        slow = np.abs(self.vx * np.cos(self.yaw) + self.vy * np.sin(self.yaw)) < _SLOW
        rolls = slow & (self.accelerator == 0)
        self.step(np.where(slow, seconds / _SLOW_STEPS, seconds), rolls)
        if slow.any():
            for _ in range(_SLOW_STEPS - 1):
                self.step(np.where(slow, seconds / _SLOW_STEPS, 0.0), rolls)

    def step(self, seconds: Floats, implicit: Booleans) -> None:
        """Advance each vehicle by its time in s; the tyres of `implicit` ones follow the change of their slips."""
        own, cos, sin, omega = self.own, np.cos(self.yaw), np.sin(self.yaw), self.omega
        forward, right = self.vx * cos + self.vy * sin, self.vy * cos - self.vx * sin
        along, across = forward - self.turning * own.y, right + self.turning * own.x
        ahead, aside = along * self.cos + across * self.sin, across * self.cos - along * self.sin

        rim = omega * own.radius
        speed = np.abs(ahead)
        per_slip_speed = 1 / (np.maximum(speed, np.abs(rim)) + _LEAST_SLIP_SPEED)
        slip = (rim - ahead) * per_slip_speed
        per_side_speed = 1 / (speed + _LEAST_SIDE_SPEED)
        side_slip = aside * per_side_speed
        load = np.hypot(own.lateral * side_slip, own.longitudinal * slip) * own.per_grip
        bounded = np.minimum(load, 3.0)
        saturation = bounded * (1 + bounded * (bounded / 27 - 1 / 3))
        weighting = own.most_weighting - own.less_weighting * np.cos(np.minimum(0.5 * load, pi))
        effective = weighting * side_slip
        by_slip = own.grip * saturation / (np.hypot(slip, effective) + _TINY)
        pull, push = by_slip * slip, -by_slip * effective

        brake = -np.sign(omega) * self.brakes
        softness = by_slip * per_slip_speed * own.radius * implicit
        new = self._turn_wheels(seconds, brake - pull * own.radius, softness * own.radius)
        pull = pull + softness * (new - omega)
        self.omega = new

        pull_x, push_y = pull * self.cos - push * self.sin, pull * self.sin + push * self.cos
        force_x = _sum(pull_x) - np.minimum(self.air * np.abs(forward), self.mass / np.maximum(seconds, _TINY)) * forward
        force_y, torque = _sum(push_y), _sum(own.x * push_y - own.y * pull_x)
        ax, ay, spin = force_x / self.mass * seconds, force_y / self.mass * seconds, torque / self.moment * seconds
        if implicit.any():
            ax /= 1 + _sum(softness * (new == 0) / own.radius) / self.mass * seconds
            stiffness = by_slip * weighting * per_side_speed * self.cos**2 * implicit
            ay, spin = self._follow_slip(stiffness, ay, spin, seconds)
        self.vx += ax * cos - ay * sin
        self.vy += ax * sin + ay * cos
        self.turning = self.turning + spin
        self.moved_x += self.vx * seconds
        self.moved_y += self.vy * seconds
        self.yaw = self.yaw + self.turning * seconds

    def _turn_wheels(self, seconds: Floats, torque: Floats, softness: Floats) -> Floats:
        """Return the speeds of the wheels after a step in rad/s, and turn the engine.

        With the torque of the clutch t, the engine is e0 - a t after the step, and a wheel w0 + b t. As t itself is
        strength * (engine - ratio * mean of the wheels) after the step, it is a fraction.
        """
        own, torques = self.own, self.fleet.tables.torques
        turned = np.minimum(self.engine * own.per_turn, TORQUES)
        index = np.minimum(turned.astype(np.int64), TORQUES - 1)
        low = torques[self.table, index]
        drive = self.accelerator * (low + (torques[self.table, index + 1] - low) * (turned - index))
        per_engine = seconds * own.per_engine
        engine_less = per_engine / (1 + per_engine * self.engine_damping)
        engine = (self.engine + per_engine * drive) / (1 + per_engine * self.engine_damping)
        per_wheel = seconds * own.per_inertia
        slowed = 1 / (1 + per_wheel * (own.damping + softness))
        free = (self.omega + per_wheel * (torque + softness * self.omega)) * slowed
        gained = per_wheel * slowed * self.share * self.ratio
        difference = engine - self.ratio * _sum(self.share * free)
        clutch = self.strength * difference
        clutch /= 1 + self.strength * (engine_less + self.ratio * _sum(self.share * gained))
        self.engine = np.minimum(np.maximum(engine - engine_less * clutch, 0.0), own.most_turns)
        wheels: Floats = free + gained * clutch
        wheels[self.braked & (self.omega * wheels <= 0)] = 0.0
        return wheels

    def _follow_slip(self, stiffness: Floats, ay: Floats, spin: Floats, seconds: Floats) -> tuple[Floats, Floats]:
        """Return the changes of the speed to the right and of the yaw rate if tyres follow the change of their slips."""
        levers = stiffness * self.own.x
        a, lever = 1 + _sum(stiffness) / self.mass * seconds, _sum(levers) * seconds
        d = 1 + _sum(levers * self.own.x) / self.moment * seconds
        b, c = lever / self.mass, lever / self.moment
        determinant = a * d - b * c
        return (d * ay - b * spin) / determinant, (a * spin - c * ay) / determinant

    def write(self, seconds: float) -> tuple[Floats, Floats, Floats]:
        """Write the state back after a step of a length in s; see `advance`."""
        fleet, rows, cos, sin = self.fleet, self.rows, np.cos(self.yaw), np.sin(self.yaw)
        forward, right = self.vx * cos + self.vy * sin, self.vy * cos - self.vx * sin
        rims = np.abs(self.omega * self.own.radius).max(axis=0)
        slow = (np.hypot(forward, right) < _STICKY_SPEED) & (rims < _STICKY_SPEED) & (self.accelerator == 0)
        waited = np.where(slow, fleet.slow_time[rows] + seconds, 0.0)
        stands = slow & (self.braked.any(axis=0) & (rims == 0) | (waited > _STICKY_TIME))
        moving = ~stands
        fleet.slow_time[rows] = waited
        fleet.speed[rows], fleet.turning[rows] = forward * moving, self.turning * moving
        fleet.sideways[rows] = (right - self.turning * self.own.centre) * moving
        fleet.omega[rows], fleet.engine[rows] = (self.omega * moving).T, self.engine
        fleet.throttle_input[rows], fleet.brake_input[rows] = self.pedals
        fleet.gear[rows], fleet.target_gear[rows] = self.gear, self.target
        fleet.shift_time[rows], fleet.since_shift[rows] = self.shift_time, self.since_shift
        x = self.moved_x + (1 - cos) * self.own.centre
        y = self.moved_y - sin * self.own.centre
        return x * moving, y * moving, self.yaw * moving
