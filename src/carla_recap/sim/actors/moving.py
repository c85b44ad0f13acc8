"""Actors that move by themselves: vehicles and walkers, each a row of a struct of arrays, and their controls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.sim.episode import Actor
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.physics_control import expect_physics
from carla_recap.sim.physics.plane import VEHICLE, WALKER
from carla_recap.sim.validation import (
    expect_between,
    expect_finite,
    expect_place,
    expect_push,
    expect_velocity,
)

if TYPE_CHECKING:
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.physics.physics_control import PhysicsControl
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers

ALL_DOORS = 6
"""The number that stands for doors 0 to 5 together."""
LIGHT_BITS: Final = 0xFFFFFFFF


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


class MovingActor(Actor):
    """An actor whose numbers are a row of a struct of arrays."""

    has_motion = True
    _group = VEHICLE

    @property
    def rows(self) -> MovingBodies:
        """The struct of arrays that it is a row of."""
        raise NotImplementedError

    @property
    def row(self) -> int:
        """Its row in `rows`; `DeadActor` is raised if it has been destroyed."""
        self.check()
        return self.rows.row(self.id)

    def _place(self) -> Transform:
        row = self.row
        return Transform(Location(*self.rows.position[row].tolist()), Rotation(*self.rows.rotation[row].tolist()))

    def _move_body(self) -> None:
        if self.parent is not None:
            return self.follow_parent()
        place, turn = self._transform.location, self._transform.rotation
        return self.rows.place(self.row, (place.x, place.y, place.z), (turn.pitch, turn.yaw, turn.roll))

    @property
    def simulates_physics(self) -> bool:
        """Whether forces move it; else it stays where it is placed."""
        return bool(self.rows.simulated[self.row])

    def set_simulate_physics(self, enabled: bool = True) -> None:
        """Let forces move it, or keep it where it is placed; an attached one follows its parent."""
        self.rows.set_simulated(self.row, enabled and self.parent is None)

    def set_enable_gravity(self, enabled: bool = True) -> None:
        """Let it stand on the road, or keep its height."""
        self.rows.weightless[self.row] = not enabled
        self.rows.unsettled[self.row] = True

    def set_collisions(self, enabled: bool = True) -> None:
        """Let it collide with others, or pass through them; an attached one always passes."""
        rows = self.rows
        rows.plane.set_touching(rows.bodies[self.row], self._group, enabled and self.parent is None)

    def set_target_velocity(self, velocity: Vector) -> None:
        """Set its velocity in m/s, from which physics continues."""
        expect_velocity("the velocity", velocity, of=self)
        self.rows.set_velocity(self.row, velocity.x, velocity.y, velocity.z)

    def attach(self) -> None:
        """Move along with the parent from now on; it collides with none, as attached props."""
        self.episode.attached[self.id] = self
        self.rows.carried[self.row] = True
        self.set_simulate_physics(False)
        self.set_collisions(False)
        self.follow_parent()

    def follow_parent(self) -> None:
        """Take over position and motion from the parent."""
        assert self.parent is not None
        parent = self.parent
        place, velocity = parent.transform.attached(self._transform), parent.velocity
        turning, acceleration = parent.angular_velocity, parent.acceleration
        rows, row = self.rows, self.row
        rows.position[row] = place.location.x, place.location.y, place.location.z
        rows.rotation[row] = place.rotation.pitch, place.rotation.yaw, place.rotation.roll
        rows.set_velocity(row, velocity.x, velocity.y, velocity.z)
        rows.angular_velocity[row] = turning.x, turning.y, turning.z
        rows.acceleration[row] = acceleration.x, acceleration.y, acceleration.z

    def _remove_body(self) -> None:
        self.episode.attached.pop(self.id, None)
        del self.episode.owners[self.rows.remove(self.id).id]

    def _vector(self, column: str) -> Vector:
        return Vector(*getattr(self.rows, column)[self.row].tolist()) if self.is_alive else Vector()


class Vehicle(MovingActor):
    """A vehicle.

    Attributes:
        open_doors: The numbers of the doors that are open; `set_door` moves them.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        assert self.blueprint.physics is not None
        self.open_doors: set[int] = set()
        self._physics_control = self.blueprint.physics  # a change replaces it

    @property
    def rows(self) -> Vehicles:
        """All vehicles."""
        return self.episode.vehicles

    @property
    def control(self) -> VehicleControl:
        """A copy of its control; setting it is `apply_control`."""
        rows, row = self.rows, self.row
        return VehicleControl(
            rows.throttle[row].item(),
            rows.steer[row].item(),
            rows.brake[row].item(),
            rows.hand_brake[row].item(),
            rows.reverse[row].item(),
            rows.manual[row].item(),
            rows.gear[row].item(),
        )

    @control.setter
    def control(self, control: VehicleControl) -> None:
        self.apply_control(control)

    def apply_control(self, control: VehicleControl) -> None:
        """Set the control that applies from now on.

        Throttle and brake are limited to 0 to 1, steering to -1 to 1; the gear only counts with manual gear shift.

        Raises:
            SimError: A number is not finite, or there is no such gear.
        """
        expect_finite("the control", control.throttle, control.steer, control.brake, of=self)
        if control.manual_gear_shift:
            expect_between("the gear", control.gear, -1, self.gears, of=self)
        rows, row = self.rows, self.row
        rows.throttle[row] = min(max(control.throttle, 0.0), 1.0)
        rows.steer[row] = min(max(control.steer, -1.0), 1.0)
        rows.brake[row] = min(max(control.brake, 0.0), 1.0)
        rows.hand_brake[row] = control.hand_brake
        rows.reverse[row] = control.reverse
        rows.manual[row] = control.manual_gear_shift
        rows.controlled[row] = True
        if control.manual_gear_shift:
            rows.gear[row] = rows.target_gear[row] = control.gear

    @property
    def light_state(self) -> int:
        """CARLA's light bits."""
        return int(self.rows.light_state[self.row])

    @light_state.setter
    def light_state(self, bits: int) -> None:
        expect_between("the lights", bits, 0, LIGHT_BITS, of=self)
        self.rows.light_state[self.row] = bits

    @property
    def autopilot(self) -> bool:
        """Whether the autopilot drives it."""
        return bool(self.rows.autopilot[self.row])

    @autopilot.setter
    def autopilot(self, enabled: bool) -> None:
        self.set_autopilot(enabled)

    def set_autopilot(self, enabled: bool = True) -> None:
        """Let the autopilot drive it, or leave it to its control."""
        row = self.row
        if enabled:
            self.rows.engage(row)
        self.rows.autopilot[row] = enabled

    @property
    def gears(self) -> int:
        """The number of forward gears."""
        return len(self._physics_control.forward_gears)

    @property
    def physics_control(self) -> PhysicsControl:
        """A copy of its physics control; set it to change anything."""
        return self._physics_control.copy()

    @physics_control.setter
    def physics_control(self, control: PhysicsControl) -> None:
        expect_physics(f"the physics control of {self!r}", control)
        self.rows.set_physics(self.row, control, self.box)
        self._physics_control = control.copy()
        self.episode.pending.physics.append(self)

    def set_enable_gravity(self, enabled: bool = True) -> None:
        """Let it stand on the road, or float at its height, without grip."""
        super().set_enable_gravity(enabled)
        self.rows.set_physics(self.row, self._physics_control, self.box)

    def add_impulse(self, impulse: Vector) -> None:
        """Apply an impulse in N s, in the axes of the world; one without physics is not moved by it."""
        rows, row = self.rows, self.row
        expect_push("the change of velocity", impulse, rows.mass[row].item(), of=self)
        if not rows.simulated[row]:
            return
        change = np.zeros((len(rows), 2))
        change[row] = np.array((impulse.x, impulse.y)) / rows.mass[row]
        rows.add_velocities(change)

    def add_force(self, force: Vector) -> None:
        """Apply a force in N during the next tick, whatever its length, in the axes of the world; see `add_impulse`."""
        rows, row = self.rows, self.row
        expect_push("the change of velocity", self.episode.impulse(force), rows.mass[row].item(), of=self)
        rows.force[row] += (force.x, force.y)

    def set_door(self, door: int, open: bool) -> None:
        """Open or close a door: 0 front left, 1 front right, 2 rear left, 3 rear right, 4 hood, 5 trunk, 6 all."""
        self.check()
        expect_between("a door", door, 0, ALL_DOORS)
        doors = {door} if door < ALL_DOORS else set(range(ALL_DOORS))
        self.open_doors = self.open_doors | doors if open else self.open_doors - doors
        self.episode.pending.doors.append((self.id, door, open))


class Walker(MovingActor):
    """A pedestrian."""

    _group = WALKER

    @property
    def rows(self) -> Walkers:
        """All walkers."""
        return self.episode.walkers

    @property
    def control(self) -> WalkerControl:
        """A copy of its control; setting it is `apply_control`."""
        rows, row = self.rows, self.row
        return WalkerControl(Vector(*rows.direction[row].tolist()), rows.speed[row].item(), rows.jump[row].item())

    @control.setter
    def control(self, control: WalkerControl) -> None:
        self.apply_control(control)

    def apply_control(self, control: WalkerControl) -> None:
        """Let it walk in a direction; its destination is cleared."""
        direction = control.direction
        expect_velocity("the direction", direction, of=self)
        expect_velocity("the speed", Vector(control.speed), of=self)
        rows, row = self.rows, self.row
        rows.destination[row] = np.nan
        length = direction.length()
        if length:
            rows.direction[row] = direction.x / length, direction.y / length, direction.z / length
        rows.speed[row] = max(control.speed, 0.0) if length else 0.0
        rows.jump[row] = control.jump

    @property
    def destination(self) -> Location | None:
        """Where it walks by itself, or None. Setting it lets it find its way there, and then on to other places.

        Raises:
            SimError: When it is set: the town has no sidewalks, or none leads there.
        """
        place = self.rows.destination[self.row].tolist() if self.is_alive else [np.nan]
        return None if np.isnan(place[0]) else Location(*place)

    @destination.setter
    def destination(self, place: Location | None) -> None:
        rows, row = self.rows, self.row
        if place is not None:
            expect_place("the destination", place, of=self)
            self.episode.town.expect_walkway(self.transform.location, place)
        rows.destination[row] = np.nan if place is None else (place.x, place.y, place.z)

    @property
    def has_fallen(self) -> bool:
        """Whether a vehicle has thrown it down."""
        return bool(self.rows.fallen[self.row])
