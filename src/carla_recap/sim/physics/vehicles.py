"""All vehicles as a struct of arrays: their controls, what follows from their physics controls, and their motion.

Speeds are in the vehicle's own axes: forward, to the right, and the yaw rate. `drivetrain` tells how a step changes them,
and how far a vehicle moves in it; its body gets the mean velocity of the step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.columns import column
from carla_recap.sim.physics import drivetrain
from carla_recap.sim.physics.drivetrain import Drivetrains
from carla_recap.sim.physics.physics_control import GEARS, WHEEL, columns, parameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.geometry import Box
    from carla_recap.sim.physics.moving_bodies import Height
    from carla_recap.sim.physics.physics_control import PhysicsControl
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.util.arrays import Booleans, Floats, Integers


_STILL: Final = 0.02  # m/s and rad/s: slower vehicles stand
_IDLE: Final = 1.0  # rad/s: so slow an engine does nothing
_ROLLS: Final = 1.0  # m/s: below, a vehicle is taken to stand
_STEEPEST: Final = 0.5  # the slope of a road, rise by run
_TINY: Final = 1e-9
_RADIUS: Final = WHEEL.index("radius")


def same_everywhere(values: Floats) -> Floats:
    """Return values to six decimals: smaller ones differ between processors, which round sines differently."""
    rounded: Floats = values.round(6) + 0.0  # no -0.0
    return rounded


class Vehicles(Drivetrains):
    """The vehicles; row i of each array belongs to `actors[i]`."""

    light_state: NDArray[np.uint32] = column(np.uint32(0))  # CARLA's light bits
    autopilot: Booleans = column(False)  # whether the autopilot drives
    sticky: Booleans = column(True)  # whether a control holds until the next one; else it holds for a tick
    controlled: Booleans = column(False)  # whether a control was applied since the latest tick
    awake: Booleans = column(False)  # whether it moves, or is about to
    force: Floats = column(np.zeros(2))  # the external force of the next tick in N, in the world, (n, 2)

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self._motions = np.empty((0, 3))  # of the bodies: m/s, m/s, rad/s
        self._moved = np.empty(0, np.bool_)

    @property
    def wheel_angle(self) -> Floats:
        """The angles of the inner front wheels in radians, (n,); without physics, they follow the control at once."""
        return np.where(self.simulated, self.steer_angle, self.steer * self.tables.of(self.table).full_lock)

    def set_physics(self, row: int, control: PhysicsControl, box: Box) -> None:
        """Set what follows from a physics control."""
        drive, own = parameters(control, box, weightless=bool(self.weightless[row])), columns(control, box)
        self.table[row] = self.tables.row(drive, np.delete(self.table, row))
        for name, value in own.items():
            getattr(self, name)[row] = value
        for gears in (self.gear, self.target_gear):
            gears[row] = min(gears[row], len(control.forward_gears))
        if self.simulated[row]:
            self.bodies[row].mass, self.bodies[row].moment = self.mass[row].item(), self.moment[row].item()

    def set_velocity(self, row: int, x: float, y: float, z: float) -> None:
        """See `MovingBodies.set_velocity`; the wheels roll, and an engine in gear turns with them."""
        super().set_velocity(row, x, y, z)
        yaw = np.radians(self.rotation[row, 1])
        speed = self.speed[row] = np.cos(yaw) * x + np.sin(yaw) * y
        self.sideways[row] = np.cos(yaw) * y - np.sin(yaw) * x
        self.omega[row] = speed / self.tables.wheels[self.table[row], _RADIUS]
        if self.gear[row]:
            turns = self.tables.ratios[self.table[row], self.gear[row]] * self.omega[row].mean()
            self.engine[row] = min(max(turns, 0.0), self.tables.most_turns[self.table[row]])
        elif self.autopilot[row]:
            self.engage(row)

    def set_simulated(self, row: int, simulated: bool) -> None:
        """See `MovingBodies.set_simulated`; physics begins with an engine at rest in neutral and wheels that roll.

        A gear that a control has put in stays in.
        """
        if simulated and not self.simulated[row]:
            inputs = (self.throttle_input, self.steer_input, self.brake_input)
            for values in (*inputs, self.engine, self.slow_time, *(() if self.manual[row] else (self.gear,))):
                values[row] = 0
            self.target_gear[row] = self.gear[row]
            self.omega[row] = self.speed[row] / self.tables.wheels[self.table[row], _RADIUS]
            if self.autopilot[row]:
                self.engage(row)
        elif self.simulated[row] and not simulated:
            self.turning[row] = 0.0
        super().set_simulated(row, simulated)

    def engage(self, row: int) -> None:
        """Put a vehicle that rolls in neutral in the lowest gear for its speed, as an autopilot needs to take over."""
        tables, own, speed = self.tables, self.table[row], self.speed[row]
        if self.gear[row] or self.target_gear[row] or speed < _ROLLS:
            return
        most = tables.most_turns[own]
        turns = tables.ratios[own, 1:-1] * speed / tables.wheels[own, _RADIUS, 0]
        possible = np.flatnonzero((turns > 0) & (turns <= most))
        if len(possible):
            calm = possible[turns[possible] <= tables.up[own, 1:-1][possible] * most]
            gear = calm[0] if len(calm) else possible[-1]
            self.gear[row] = self.target_gear[row] = gear + 1
            self.engine[row] = turns[gear]

    def pedals(self, rows: Integers, acceleration: Floats, backwards: Booleans | bool = False) -> tuple[Floats, Floats]:
        """Return throttle and brake, 0 to 1 each, for accelerations of vehicles; one of the two is 0.

        Accelerations are in m/s², in the direction of the gear, (n,); `backwards` says whether that is backwards, (n,).
        """
        table = self.table[rows]
        own, tables = self.tables.of(table), self.tables
        speed = np.maximum(np.where(backwards, -self.speed[rows], self.speed[rows]), 0)
        gear = np.where(backwards, GEARS - 1, np.maximum(self.target_gear[rows], 1))
        radius, ratio = own.radius[: len(rows)], np.maximum(np.abs(tables.ratios[table, gear]), _TINY)
        turns = np.minimum(ratio * speed / radius, own.most_turns)
        torque = tables.torques[table, (turns * own.per_turn).astype(np.int64)].real
        inertia = self.mass[rows] * radius**2 + own.wheel_inertia + ratio * ratio / own.per_engine
        resistance = self.air[rows] * speed * speed * radius + own.wheel_damping * speed / radius
        wanted = inertia * acceleration / radius + resistance + own.engaged * turns * ratio  # N m at the wheels
        throttle = wanted / (ratio * np.maximum(torque + (own.engaged - own.full) * turns, _TINY))
        brake = np.where(acceleration < 0, -wanted / np.maximum(own.brakes, _TINY), 0)
        return np.minimum(np.maximum(throttle, 0), 1), np.minimum(np.maximum(brake, 0), 1)

    def begin_tick(self, seconds: float) -> bool:
        """Begin a tick: vehicles steer, and the autopilot's are driven for all of it.

        Return whether any of them moves, or is about to.
        """
        if not self.sticky.all():  # some controls held for the latest tick alone
            released = ~self.sticky & ~self.controlled
            for values in (self.throttle, self.steer, self.brake, self.hand_brake, self.reverse, self.manual):
                values[released] = 0
            self.controlled[:] = False
        if self.force.any():
            self.add_velocities(np.where(self.simulated[:, None], self.force * seconds / self.mass[:, None], 0.0))
            self.force[:] = 0
        self._choose_gears()
        slow = (self.speed != 0) | (self.sideways != 0) | (self.turning != 0)  # what is too slow to go on has yet to stop
        self.awake = self._in_motion() | slow & self.simulated
        self._before = self.velocity.copy()
        self._moved = self.awake | self.unsettled & self.simulated
        begins = bool(self.awake.any() or (self.steer_input != self.steer).any())
        self._motions = np.zeros((len(self), 3))
        if begins:
            drivetrain.steer(self, seconds)
            self._drive(self.simulated & self.autopilot, seconds, exactly=False)
        return begins

    def _drive(self, which: Booleans, seconds: float, *, exactly: bool) -> None:
        """Drive some vehicles for a time in s, see `drivetrain.advance`: their bodies are to get the mean velocities."""
        rows = which.nonzero()[0]
        if len(rows):
            ahead, aside, turn = drivetrain.advance(self, rows, seconds, exactly=exactly)
            yaw = np.radians(self.rotation[rows, 1])
            cos, sin = np.cos(yaw), np.sin(yaw)
            self._motions[rows] = np.array((cos * ahead - sin * aside, sin * ahead + cos * aside, turn)).T / seconds

    def _choose_gears(self) -> None:
        """Put in the gears of manual gearboxes, and reverse, or first after it, at once."""
        chosen = np.where(self.reverse, -1, np.where(self.gear < 0, 1, self.gear))
        at_once = self.manual | (chosen != self.gear)
        np.copyto(self.gear, chosen, where=~self.manual)
        np.copyto(self.target_gear, self.gear, where=at_once)

    def add_velocities(self, change: Floats) -> None:
        """Add velocities in m/s, in the world, (n, 2)."""
        yaw = np.radians(self.rotation[:, 1])
        cos, sin = np.cos(yaw), np.sin(yaw)
        self.speed += cos * change[:, 0] + sin * change[:, 1]
        self.sideways += cos * change[:, 1] - sin * change[:, 0]

    def write_velocities(self, seconds: float) -> None:
        """Set the velocities of the bodies for the next step."""
        driven = self.simulated & (self.autopilot | self.awake)
        self._drive(driven & ~self.autopilot, seconds, exactly=True)
        np.copyto(self.brake_input, self.brake, where=~driven)
        in_motion = self._in_motion()
        stops = self.awake & ~in_motion
        if stops.any():
            for values in (self.speed, self.sideways, self.turning, self._motions):
                values[stops] = 0
        self.set_body_velocities(self.awake, self._motions)
        self.awake = in_motion

    def read_bodies(self) -> None:
        """Read the poses and velocities of the bodies after a step."""
        states = self.plane.states(self.body_id)
        moving = self.simulated
        self.position[moving, :2] = same_everywhere(states[moving, :2])
        yaw = same_everywhere((np.degrees(states[moving, 2]) + 180) % 360 - 180)
        self.rotation[moving, 1] = np.where(yaw == -180, 180.0, yaw)  # within (-180, 180], as CARLA's
        change = states[:, 3:] - self._motions
        self._motions = states[:, 3:]
        hit = moving & change.any(axis=1)
        if hit.any():
            change[~hit] = 0
            self.add_velocities(change[:, :2])
            self.turning += change[:, 2]
            self.awake |= hit
        self._moved |= self.awake

    def end_tick(self, seconds: float) -> None:
        """End a tick: set the heights and the velocities of those that moved."""
        rows = self._moved.nonzero()[0]
        if not len(rows):
            self.acceleration[self.simulated] = 0
            return
        yaw, speed, sideways = np.radians(self.rotation[rows, 1]), self.speed[rows], self.sideways[rows]
        cos, sin = np.cos(yaw), np.sin(yaw)
        self._settle(rows, cos, sin, seconds)
        x, y = cos * speed - sin * sideways, sin * speed + cos * sideways
        motion = same_everywhere(np.array((x, y, np.degrees(self.turning[rows]))))
        self.velocity[rows, :2], self.angular_velocity[rows, 2] = motion[:2].T, motion[2]
        self._accelerate(seconds)

    def _settle(self, rows: NDArray[np.intp], cos: Floats, sin: Floats, seconds: float) -> None:
        """Set the heights and pitches of vehicles, with cosine and sine of their yaws, by the road below their axles."""
        front, rear = self.front[rows], self.rear[rows]
        x, y, z = self.position[rows].T
        high, low = self._height(
            np.concatenate((x + cos * front, x - cos * rear)),
            np.concatenate((y + sin * front, y - sin * rear)),
            np.concatenate((z, z)),
        ).reshape(2, -1)
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
        moving = (np.abs(self.speed) > _STILL) | (np.abs(self.sideways) > _STILL) | (self.engine > _IDLE)
        moving |= (np.abs(self.turning) > _STILL) | (self.throttle > 0)
        in_motion: Booleans = moving & self.simulated
        return in_motion
