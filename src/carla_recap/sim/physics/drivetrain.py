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
    from carla_recap.util.arrays import Booleans, Complexes, Floats, Integers

_STEP: Final = 0.01  # s: CARLA's default of the longest step of physics
_LONG_STEP: Final = 0.05  # s: the longest step of the autopilot's vehicles; motorcycles swing in ones of 0.1 s
_ROUNDING: Final = 1e-6
_SLOW: Final = 5.0  # m/s: below, PhysX divides a step by three
_SLOW_STEPS: Final = 3
_LEAST_SLIP_SPEED: Final = 0.1  # m/s, added below the slip of wheels that are driven or braked
_LEAST_SIDE_SPEED: Final = 1.0  # m/s, added below the slip sideways
_KEPT: Final = 8
_TINY: Final = 1e-9
_NO_TIME: Final = 1e-30  # s: so short a step changes nothing
_STICKY_SPEED: Final = 0.2  # m/s: slower vehicles whose wheels are locked stand, and others after a second
_STICKY_TIME: Final = 1.0  # s
_PEDALS, _STEERING = (6.0, 10.0), (2.5, 5.0)
"""1/s, by which the pedals and the steering of UE4's vehicles rise and fall at most."""


class DriveTables(StructOfArrays):
    """The parameters of drivetrains; vehicles of one physics control share a row. See `physics_control.parameters`."""

    wheels: Floats = column(np.zeros((len(WHEEL), CORNERS)))
    """The parameters `WHEEL` of each corner: places from the centre of mass in m, radius in m, moment of inertia in kg m²,
    damping in kg m²/s, friction times load in N, stiffness in N sideways and lengthwise, torques of the brakes in N m."""
    centre: Floats = column(0.0)  # how far the centre of mass is ahead of the origin, in m
    full_lock: Floats = column(0.0)  # the greatest angle of the inner front wheel in radians
    track: Floats = column(1.0)  # the distance between left and right wheels in m
    torques: Complexes = column(np.zeros(TORQUES + 1, np.complex128))
    """The torque of the engine in N m, from no revolutions to the most; as the imaginary part, its growth to the next."""
    most_turns: Floats = column(0.0)  # the most revolutions of the engine in rad/s
    engine_inertia: Floats = column(1.0)  # the moment of inertia of the engine in kg m²
    damping: Floats = column(np.zeros(3))
    """The damping of the engine in kg m²/s: at full throttle, and without throttle in a gear and in neutral."""
    clutch: Floats = column(0.0)  # the strength of the clutch in kg m²/s
    ratios: Floats = column(np.zeros(GEARS))  # engine by wheels, by gear; 0 in neutral, negative in reverse
    up: Floats = column(np.zeros(GEARS))  # the share of the most revolutions above which the gearbox shifts up, by gear
    down: Floats = column(np.zeros(GEARS))  # the share of the most revolutions below which it shifts down, by gear
    switch_time: Floats = column(0.0)  # how long it is in neutral when it shifts, in s
    latency: Floats = column(0.0)
    """The least time between two shifts in s; infinite for a gearbox that does not shift by itself."""
    lock_share: Floats = column(np.zeros(len(SPEEDS)))  # the share of the full lock that steering reaches, by speed

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
        key = b"".join(np.asarray(values[name], getattr(self, name).dtype).tobytes() for name in self.COLUMNS)
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

    throttle: Floats = column(0.0)  # the throttle, 0 to 1
    steer: Floats = column(0.0)  # the steering, -1 (left) to 1 (right), relative to `steer_limit`
    brake: Floats = column(0.0)  # the brake, 0 to 1
    hand_brake: Booleans = column(False)  # whether the hand brake is drawn
    throttle_input: Floats = column(0.0)  # the throttle that has reached the engine: inputs take their time
    steer_input: Floats = column(0.0)  # the steering that has reached the wheels
    brake_input: Floats = column(0.0)  # the brake that has reached the wheels
    reverse: Booleans = column(False)  # whether the throttle drives backwards
    gear: Integers = column(np.int64(0))  # the gear: from 1, 0 neutral, -1 reverse
    target_gear: Integers = column(np.int64(0))  # the gear that the gearbox shifts to
    shift_time: Floats = column(0.0)  # how long it has been shifting, in s
    since_shift: Floats = column(inf)  # the time since the gearbox began to shift by itself, in s
    engine: Floats = column(0.0)  # the speed of the engine in rad/s
    omega: Floats = column(np.zeros(CORNERS))  # the speeds of the wheels in rad/s, (n, corners)
    slow_time: Floats = column(0.0)  # how long it has hardly been moving, in s
    manual: Booleans = column(False)  # whether `gear` is part of the control; else the gearbox is automatic
    speed: Floats = column(0.0)  # the speed forward in m/s; negative backwards
    sideways: Floats = column(0.0)  # the speed to the right, in m/s
    turning: Floats = column(0.0)  # the yaw rate in rad/s, positive to the right
    steer_angle: Floats = column(0.0)  # the angle between those of the front wheels in radians, positive to the right
    steer_limit: Floats = column(1.0)
    """The angle of the inner front wheel at full steering and the present speed, in radians."""
    wheelbase: Floats = column(1.0)  # the distance between the axles in m
    front: Floats = column(0.5)  # the distance from its origin to the front axle in m
    rear: Floats = column(0.5)  # the distance from its origin to the rear axle in m
    air: Floats = column(0.0)  # the drag of the air: the force in N at 1 m/s
    table: Integers = column(np.int64(0))  # the rows of `tables` that are theirs

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self.tables = DriveTables()


class _Parameters:
    """The parameters of some vehicles: an element for each; of corners, first for the front left one of each."""

    def __init__(self, tables: DriveTables, own: Integers) -> None:
        wheels = np.ascontiguousarray(tables.wheels[own].transpose(1, 2, 0)).reshape(len(WHEEL), -1)
        self.x, y, self.radius, inertia, damping, self.grip, lateral, longitudinal, self.brake, self.hand_brake = wheels
        self.each = np.tile(np.arange(len(own)), CORNERS)
        self.places = self.x + 1j * y
        self.rim_inertia, self.rim_damping = inertia / self.radius**2, damping / self.radius**2
        per_grip = 1 / (3 * np.maximum(self.grip, _TINY))
        self.lateral, self.longitudinal = lateral * per_grip, longitudinal * per_grip  # of a load that saturates at 1
        stiffnesses = lateral / np.maximum(longitudinal, _TINY)
        self.most_weighting, self.less_weighting = 0.5 * (1 + stiffnesses), 0.5 * (1 - stiffnesses)
        self.most_turns, self.clutch = tables.most_turns[own], tables.clutch[own]
        self.per_turn = TORQUES / np.maximum(self.most_turns, _TINY)
        self.per_engine = 1 / tables.engine_inertia[own]
        self.full, self.engaged, self.disengaged = np.ascontiguousarray(tables.damping[own].T)
        self.centre, self.track, self.full_lock = tables.centre[own], tables.track[own], tables.full_lock[own]
        self.latency, self.switch_time = tables.latency[own], tables.switch_time[own]
        self.brakes, self.wheel_damping, self.wheel_inertia = _sum(self.brake), _sum(damping), _sum(inertia)
        self.first_torque = own * (TORQUES + 1)


def _sum(values: Any) -> Any:
    """Return the sums over the corners of each vehicle."""
    return np.add.reduce(values.reshape(CORNERS, -1))


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
    most = np.where(change * values >= 0, rates[0] * seconds, rates[1] * seconds)
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
    """Some vehicles while they are driven; arrays have an element for each of them, or for each corner, as `_Parameters`.

    numpy takes a microsecond for an operation on a few numbers, and twice that if shapes differ: hence the flat arrays.
    Places, velocities and forces are complex: ahead and, as the imaginary part, to the right of how the vehicle stood at
    first, or of what is said.
    """

    def __init__(self, fleet: Drivetrains, rows: Integers) -> None:
        self.fleet, self.rows = fleet, rows
        self.table = fleet.table[rows]
        own = self.own = fleet.tables.of(self.table)
        self.torques = fleet.tables.torques.ravel()
        hand_brake = fleet.hand_brake[rows]
        self.held = hand_brake[own.each] * own.hand_brake
        share = np.full((CORNERS, len(rows)), 1 / CORNERS)
        share[:2, hand_brake], share[2:, hand_brake] = 0.5, 0.0  # PhysX's: drive at the front alone
        self.share = share.ravel() / own.radius
        self.mass, self.moment, self.air = fleet.mass[rows], fleet.moment[rows], fleet.air[rows]
        self.wheels = self._front_wheels()
        self.to_wheels = self.wheels.conj()
        self.levers = 1j * own.places * self.to_wheels
        self.spins = self.levers.conj()
        self.against = -(self.wheels.real**2)
        self.pedals = np.concatenate((fleet.throttle_input[rows], fleet.brake_input[rows]))
        self.wanted = np.concatenate((fleet.throttle[rows], fleet.brake[rows]))
        self.manual, self.gear, self.target = fleet.manual[rows], fleet.gear[rows], fleet.target_gear[rows]
        self.shift_time, self.since_shift = fleet.shift_time[rows], fleet.since_shift[rows]
        self.turning = fleet.turning[rows]
        self.velocity = fleet.speed[rows] + 1j * (fleet.sideways[rows] + self.turning * own.centre)
        self.yaw, self.moved = np.zeros(len(rows)), np.zeros(len(rows), np.complex128)
        self.heading, self.body = np.exp(1j * self.yaw), self.velocity.copy()
        self.rim, self.engine = fleet.omega[rows].T.ravel() * own.radius, fleet.engine[rows]
        self._engage()

    def _front_wheels(self) -> Complexes:
        """Return the directions of the wheels: those of the front ones meet at the axis of the rear ones."""
        between = np.tan(self.fleet.steer_angle[self.rows])
        by_track = between * self.own.track / (2 * self.fleet.wheelbase[self.rows])
        directions = np.ones((CORNERS, len(self.rows)), np.complex128)
        directions.imag[0], directions.imag[1] = between / (1 + by_track), between / np.maximum(1 - by_track, _TINY)
        return (directions / np.abs(directions)).ravel()

    def begin(self, seconds: float) -> None:
        """Begin a step of a length in s: pedals, and gears; an automatic shift takes the throttle away."""
        own = self.own
        self.pedals = _follow(self.pedals, self.wanted, _PEDALS, seconds)
        throttle, brake = self.pedals.reshape(2, -1)
        brakes = brake[own.each] * own.brake + self.held
        self.braked, self.brakes = brakes > 0, -brakes / own.radius
        self._shift(seconds)
        self.accelerator = throttle * (self.manual | (self.gear == self.target))
        self.engine_damping = self.without + (own.full - self.without) * self.accelerator

    def _shift(self, seconds: float) -> None:
        """Let the gearboxes work for a step of a length in s; a shift goes by way of neutral."""
        own = self.own
        turns = self.engine * own.per_turn / TORQUES
        ready = self.shifts & (self.gear == self.target) & (self.since_shift > own.latency)
        up, down = ready & (turns > self.up), ready & (turns < self.down)
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
            self._engage()

    def _engage(self) -> None:
        """Set what follows from the gears."""
        own, tables, neutral, which = self.own, self.fleet.tables, self.gear == 0, (self.table, self.gear)
        self.geared = self.share * tables.ratios[which][own.each]
        self.geared_twice = self.geared * self.geared
        self.up, self.down = tables.up[which], tables.down[which]
        self.shifts = ~self.manual & (self.gear >= 0)
        self.strength = own.clutch * ~neutral
        self.without = np.where(neutral, own.disengaged, own.engaged)

    def step_exactly(self, seconds: float) -> None:
        """Advance as PhysX does: a slow vehicle in three parts, and one that rolls slowly without throttle to its rest."""
        slow = np.abs(self.body.real) < _SLOW
        rolls = slow & (self.accelerator == 0)
        part = seconds / _SLOW_STEPS
        self.step(np.where(slow, part, seconds), rolls)
        if slow.any():
            self.step(np.where(slow, part, _NO_TIME), rolls, _SLOW_STEPS - 1)

    def step(self, seconds: Floats, implicit: Booleans, times: int = 1) -> None:
        """Advance each vehicle by its time in s, some `times`; tyres of `implicit` ones follow the change of their slips."""
        own, each = self.own, self.own.each
        per_mass, self.per_moment = seconds / self.mass, seconds / self.moment
        self.per_mass, drag = per_mass, self.air * per_mass
        per_engine = seconds * own.per_engine
        self.keeps = 1 / (1 + per_engine * self.engine_damping)
        self.engine_less = per_engine * self.keeps
        self.gains = self.engine_less * self.accelerator
        self.slips_less = 1 + self.strength * self.engine_less
        self.wheel_per_time = own.rim_inertia / seconds[each]
        follows, by_implicit = bool(implicit.any()), implicit[each].astype(float)
        against = self.against * by_implicit
        slips, loads = np.empty((2, len(each)), np.complex128)
        for _ in range(times):
            slid = self.body[each] * self.to_wheels + self.turning[each] * self.levers
            ahead, rim = slid.real.copy(), self.rim
            speed = np.abs(ahead)
            slip_speed, side_speed = np.maximum(speed, np.abs(rim)) + _LEAST_SLIP_SPEED, speed + _LEAST_SIDE_SPEED
            slip = np.divide(rim - ahead, slip_speed, out=slips.real)
            side_slip = np.divide(slid.imag, side_speed, out=slips.imag)
            np.multiply(own.longitudinal, slip, out=loads.real)
            np.multiply(own.lateral, side_slip, out=loads.imag)
            load = np.abs(loads)
            bounded = np.minimum(load, 1.0)
            saturation = bounded * (3 + bounded * (bounded - 3))
            weighting = own.less_weighting * np.cos(np.minimum(1.5 * load, pi)) - own.most_weighting  # against the slip
            np.multiply(weighting, side_slip, out=side_slip)
            by_slip = own.grip * saturation / (np.abs(slips) + _TINY)
            forces = by_slip * slips

            softness = by_slip / slip_speed * by_implicit
            new = self._turn_wheels(forces.real, softness)
            if follows:
                forces += softness * (new - rim)
            self.rim = new

            forward, change = self.body.real, _sum(forces * self.wheels) * per_mass
            spin = _sum((forces * self.spins).real) * self.per_moment
            change -= np.minimum(drag * np.abs(forward), 1.0) * forward
            if follows:
                change.real /= 1 + _sum(softness * (new == 0)) * per_mass
                stiffness = by_slip * weighting / side_speed * against
                change.imag, spin = self._follow_slip(stiffness, change.imag, spin)
            self.velocity += change * self.heading
            self.turning = self.turning + spin
            self.moved += self.velocity * seconds
            self.yaw = self.yaw + self.turning * seconds
            self.heading = np.exp(1j * self.yaw)
            self.body = self.velocity * self.heading.conj()

    def _turn_wheels(self, pull: Floats, softness: Floats) -> Floats:
        """Return the speeds of the rims after a step in m/s, and turn the engine.

        With the torque of the clutch t, the engine is e0 - a t after the step, and a rim r0 + b t. As t itself is
        strength * (engine - ratio * mean of the wheels) after the step, it is a fraction.
        """
        own, rim = self.own, self.rim
        turned = np.minimum(self.engine * own.per_turn, TORQUES)
        index = turned.astype(np.int64)
        torque = self.torques[index + own.first_torque]
        engine = self.engine * self.keeps + self.gains * (torque.real + torque.imag * (turned - index))
        resists = self.wheel_per_time + softness
        gives = 1 / (resists + own.rim_damping)
        free = (resists * rim + np.sign(rim) * self.brakes - pull) * gives
        clutch = self.strength * (engine - _sum(free * self.geared))
        clutch /= self.slips_less + self.strength * _sum(gives * self.geared_twice)
        self.engine = np.minimum(np.maximum(engine - self.engine_less * clutch, 0.0), own.most_turns)
        new: Floats = free + gives * self.geared * clutch[own.each]
        np.copyto(new, 0.0, where=self.braked & (rim * new <= 0))
        return new

    def _follow_slip(self, stiffness: Floats, ay: Floats, spin: Floats) -> tuple[Floats, Floats]:
        """Return the changes of the speed to the right and of the yaw rate if tyres follow the change of their slips."""
        levers = stiffness * self.own.x
        a, d = 1 + _sum(stiffness) * self.per_mass, 1 + _sum(levers * self.own.x) * self.per_moment
        b, c = _sum(levers) * self.per_mass, _sum(levers) * self.per_moment
        determinant = a * d - b * c
        return (d * ay - b * spin) / determinant, (a * spin - c * ay) / determinant

    def write(self, seconds: float) -> tuple[Floats, Floats, Floats]:
        """Write the state back after a step of a length in s; see `advance`."""
        fleet, rows, own = self.fleet, self.rows, self.own
        rims = np.abs(self.rim).reshape(CORNERS, -1).max(axis=0)
        slow = (np.abs(self.body) < _STICKY_SPEED) & (rims < _STICKY_SPEED) & (self.accelerator == 0)
        waited = np.where(slow, fleet.slow_time[rows] + seconds, 0.0)
        braked = self.braked.reshape(CORNERS, -1).any(axis=0)
        moving = ~(slow & (braked & (rims == 0) | (waited > _STICKY_TIME)))
        fleet.slow_time[rows] = waited
        fleet.speed[rows], fleet.turning[rows] = self.body.real * moving, self.turning * moving
        fleet.sideways[rows] = (self.body.imag - self.turning * own.centre) * moving
        fleet.omega[rows], fleet.engine[rows] = ((self.rim / own.radius).reshape(CORNERS, -1) * moving).T, self.engine
        fleet.throttle_input[rows], fleet.brake_input[rows] = self.pedals.reshape(2, -1)
        fleet.gear[rows], fleet.target_gear[rows] = self.gear, self.target
        fleet.shift_time[rows], fleet.since_shift[rows] = self.shift_time, self.since_shift
        moved = (self.moved + (1 - self.heading) * own.centre) * moving
        return moved.real, moved.imag, self.yaw * moving
