"""The actors of a world, with CARLA's vocabulary: what each is, where it is, and what it can be told."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.sim.actors.control import VehicleControl, WalkerControl
from carla_recap.sim.errors import DeadActor, SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.plane import PROP, VEHICLE, WALKER
from carla_recap.sim.traffic.lights import RED, UNKNOWN
from carla_recap.sim.validation import (
    LARGEST,
    expect_between,
    expect_finite,
    expect_physics,
    expect_place,
    expect_push,
    expect_transform,
    expect_velocity,
)

if TYPE_CHECKING:
    import pymunk

    from carla_recap.records import ActorKind
    from carla_recap.sim.actors.blueprints import Blueprint
    from carla_recap.sim.geometry import Box
    from carla_recap.sim.physics.movers import Movers
    from carla_recap.sim.physics.physics_control import PhysicsControl
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers
    from carla_recap.sim.town.town import Signal
    from carla_recap.sim.traffic.lights import Signals
    from carla_recap.sim.world import World

HERO = "hero"
"""The role name of the vehicle that a test is about."""
ALL_DOORS = 6
"""The number that stands for doors 0 to 5 together."""
_LIGHT_BITS: Final = 0xFFFFFFFF
_ACROSS: Final = 90.0
"""Degrees: CARLA turns its lights and signs so much further than the signals of the map, with x across the road."""


class Actor:
    """Something in a world. `World.spawn` makes them.

    Attributes:
        id: Its number, never used again.
        blueprint: What it was made from.
        attributes: What it has, as text.
        parent: What it is attached to.
        children: What is attached to it.
        is_alive: Whether it has not been destroyed.
    """

    def __init__(
        self,
        world: World,
        id: int,
        blueprint: Blueprint,
        transform: Transform,
        attributes: dict[str, str] | None = None,
        parent: Actor | None = None,
    ) -> None:
        self.world = world
        self.id = id
        self.blueprint = blueprint
        self.attributes = {**blueprint.attributes, **(attributes or {})}
        self.parent = parent
        self.children: list[Actor] = []
        self.is_alive = True
        self._transform = transform.copy()
        if parent is not None:
            parent.children.append(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.id}, {self.type_id!r})"

    @property
    def type_id(self) -> str:
        """The name of its blueprint."""
        return self.blueprint.id

    @property
    def kind(self) -> ActorKind:
        """What it is, as recordings number it."""
        return self.blueprint.kind

    @property
    def box(self) -> Box:
        """The box around it, in its own axes."""
        return self.blueprint.box

    @property
    def is_hero(self) -> bool:
        """Whether its role name is hero."""
        return self.attributes.get("role_name") == HERO

    @property
    def transform(self) -> Transform:
        """Where it is in the world: a copy. Setting it puts it elsewhere; of an attached one, relative to its parent."""
        if self.parent is not None and self.is_alive:
            return upon(self.parent, self._transform)
        return self._transform.copy()

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform(f"the transform of {self!r}", value)
        self._transform = value.copy()

    @property
    def relative_transform(self) -> Transform:
        """Where it is upon its parent; in the world, where it has none."""
        return self._transform.copy() if self.parent is not None else self.transform

    @property
    def velocity(self) -> Vector:
        """In m/s."""
        return self.parent.velocity if self.parent is not None else Vector()

    @property
    def angular_velocity(self) -> Vector:
        """In degrees/s."""
        return self.parent.angular_velocity if self.parent is not None else Vector()

    @property
    def acceleration(self) -> Vector:
        """In m/s²."""
        return self.parent.acceleration if self.parent is not None else Vector()

    def destroy(self) -> bool:
        """Take it, and what is attached to it, out of the world; False if it was destroyed before."""
        return self.world.destroy(self)

    def die(self) -> None:
        """Be no more: from now on only what it was can be asked for."""
        self._transform = self.transform
        self.is_alive = False

    def check(self) -> None:
        """Make sure that it is alive.

        Raises:
            DeadActor: It has been destroyed.
        """
        if not self.is_alive:
            raise DeadActor(f"actor {self.id} ({self.type_id}) has been destroyed")


class Mover(Actor):
    """An actor whose numbers are a row of a struct of arrays."""

    _group = VEHICLE

    @property
    def rows(self) -> Movers[Any]:
        """The struct of arrays that it is in."""
        raise NotImplementedError

    @property
    def row(self) -> int:
        """Its row there.

        Raises:
            DeadActor: It has been destroyed.
        """
        self.check()
        return self.rows.row(self.id)

    @property
    def transform(self) -> Transform:
        """Where it is in the world: a copy. Setting it puts it elsewhere, at the speed that it has.

        Of an attached one, it is set relative to its parent.
        """
        if not self.is_alive:
            return self._transform.copy()
        row = self.rows.row(self.id)
        return Transform(
            Location(*self.rows.position[row].tolist()),
            Rotation(*self.rows.rotation[row].tolist()),
        )

    @transform.setter
    def transform(self, value: Transform) -> None:
        expect_transform(f"the transform of {self!r}", value)
        if self.parent is not None:
            self._transform = value.copy()
            return self.ride(self.parent)
        place, turn = value.location, value.rotation
        return self.rows.put(self.row, (place.x, place.y, place.z), (turn.pitch, turn.yaw, turn.roll))

    @property
    def velocity(self) -> Vector:
        """In m/s."""
        return self._vector("velocity")

    @property
    def angular_velocity(self) -> Vector:
        """In degrees/s."""
        return self._vector("angular_velocity")

    @property
    def acceleration(self) -> Vector:
        """In m/s²."""
        return self._vector("acceleration")

    @property
    def simulates_physics(self) -> bool:
        """Whether forces move it; else it stays where it is put."""
        return bool(self.rows.simulated[self.row])

    def set_simulate_physics(self, enabled: bool = True) -> None:
        """Let forces move it, or have it stay where it is put; an attached one goes where its parent does."""
        self.rows.set_simulated(self.row, enabled and self.parent is None)

    def set_collisions(self, enabled: bool = True) -> None:
        """Let it touch others, or pass through them; an attached one always passes."""
        rows = self.rows
        rows.plane.set_touching(rows.bodies[self.row], self._group, enabled and self.parent is None)

    def set_target_velocity(self, velocity: Vector) -> None:
        """Give it a velocity in m/s, from which it goes on."""
        expect_velocity(f"the velocity of {self!r}", velocity)
        self.rows.set_velocity(self.row, velocity.x, velocity.y, velocity.z)

    def ride(self, parent: Actor) -> None:
        """Go where a parent has gone that it is fixed to, and as fast."""
        place, velocity = upon(parent, self._transform), parent.velocity
        turning, acceleration = parent.angular_velocity, parent.acceleration
        rows, row = self.rows, self.row
        rows.position[row] = place.location.x, place.location.y, place.location.z
        rows.rotation[row] = place.rotation.pitch, place.rotation.yaw, place.rotation.roll
        rows.set_velocity(row, velocity.x, velocity.y, velocity.z)
        rows.angular_velocity[row] = turning.x, turning.y, turning.z
        rows.acceleration[row] = acceleration.x, acceleration.y, acceleration.z

    def _vector(self, column: str) -> Vector:
        return Vector(*getattr(self.rows, column)[self.row].tolist()) if self.is_alive else Vector()


class Vehicle(Mover):
    """A vehicle.

    Attributes:
        open_doors: The numbers of the doors that are open; `set_door` moves them.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        assert self.blueprint.physics is not None
        self.open_doors: set[int] = set()
        self._physics_control = deepcopy(self.blueprint.physics)

    @property
    def rows(self) -> Vehicles:
        """All vehicles."""
        return self.world.vehicles

    @property
    def control(self) -> VehicleControl:
        """What its driver does: a copy; setting it is `apply_control`."""
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
        """Tell its driver what to do from now on.

        Throttle and brake beyond 0 to 1, and steering beyond -1 to 1, count as these; the gear counts where it is shifted
        by hand.

        Raises:
            SimError: A number is none, or there is no such gear.
        """
        expect_finite(f"the control of {self!r}", control.throttle, control.steer, control.brake)
        if control.manual_gear_shift:
            expect_between(f"the gear of {self!r}", control.gear, -1, self.gears)
        rows, row = self.rows, self.row
        rows.throttle[row] = min(max(control.throttle, 0.0), 1.0)
        rows.steer[row] = min(max(control.steer, -1.0), 1.0)
        rows.brake[row] = min(max(control.brake, 0.0), 1.0)
        rows.hand_brake[row] = control.hand_brake
        rows.reverse[row] = control.reverse
        rows.manual[row] = control.manual_gear_shift
        if control.manual_gear_shift:
            rows.gear[row] = control.gear

    @property
    def light_state(self) -> int:
        """CARLA's light bits."""
        return int(self.rows.light_state[self.row])

    @light_state.setter
    def light_state(self, bits: int) -> None:
        expect_between(f"the lights of {self!r}", bits, 0, _LIGHT_BITS)
        self.rows.light_state[self.row] = bits

    @property
    def autopilot(self) -> bool:
        """Whether the autopilot drives it."""
        return bool(self.rows.autopilot[self.row])

    @autopilot.setter
    def autopilot(self, enabled: bool) -> None:
        self.set_autopilot(enabled)

    def set_autopilot(self, enabled: bool = True) -> None:
        """Have the autopilot drive it, or leave it to its controls."""
        row = self.row
        if enabled:
            _ = self.world.autopilot
        self.rows.autopilot[row] = enabled

    @property
    def gears(self) -> int:
        """How many forward gears it has."""
        return len(self._physics_control.forward_gears)

    @property
    def physics_control(self) -> PhysicsControl:
        """How it moves: a copy; set it to change anything."""
        return deepcopy(self._physics_control)

    @physics_control.setter
    def physics_control(self, control: PhysicsControl) -> None:
        expect_physics(f"the physics control of {self!r}", control)
        row = self.row
        self._physics_control = deepcopy(control)
        self.rows.set_physics(row, self._physics_control, self.box)
        self.world.pending.physics.append(self)

    def add_impulse(self, impulse: Vector) -> None:
        """Push it: N s, in the world."""
        rows, row = self.rows, self.row
        expect_push(f"an impulse on {self!r}", impulse, rows.mass[row].item())
        change = np.zeros((len(rows), 2))
        change[row] = np.array((impulse.x, impulse.y)) / rows.mass[row]
        rows.kick(change)

    def add_force(self, force: Vector) -> None:
        """Push it during the next tick: N, in the world."""
        rows, row, seconds = self.rows, self.row, self.world.settings.fixed_delta_seconds or self.world.delta
        impulse = Vector(force.x * seconds, force.y * seconds, force.z * seconds)
        expect_push(f"a force on {self!r}", impulse, rows.mass[row].item())
        rows.force[row] += (force.x, force.y)

    def set_door(self, door: int, open: bool) -> None:
        """Open or close a door: 0 front left, 1 front right, 2 rear left, 3 rear right, 4 hood, 5 trunk, 6 all."""
        self.check()
        expect_between("a door", door, 0, ALL_DOORS)
        doors = {door} if door < ALL_DOORS else set(range(ALL_DOORS))
        self.open_doors = self.open_doors | doors if open else self.open_doors - doors
        self.world.pending.doors.append((self.id, door, open))


class Walker(Mover):
    """A pedestrian."""

    _group = WALKER

    @property
    def rows(self) -> Walkers:
        """All walkers."""
        return self.world.walkers

    @property
    def control(self) -> WalkerControl:
        """Where it is told to walk: a copy; setting it is `apply_control`."""
        rows, row = self.rows, self.row
        return WalkerControl(Vector(*rows.direction[row].tolist()), rows.speed[row].item(), rows.jump[row].item())

    @control.setter
    def control(self, control: WalkerControl) -> None:
        self.apply_control(control)

    def apply_control(self, control: WalkerControl) -> None:
        """Have it walk in a direction; a destination is forgotten."""
        direction = control.direction
        expect_velocity(f"the direction of {self!r}", direction)
        expect_velocity(f"the speed of {self!r}", Vector(control.speed))
        rows, row = self.rows, self.row
        self.world.pedestrians.forget(self.id)
        length = direction.length()
        if length:
            rows.direction[row] = direction.x / length, direction.y / length, direction.z / length
        rows.speed[row] = max(control.speed, 0.0) if length else 0.0
        rows.jump[row] = control.jump

    @property
    def destination(self) -> Location | None:
        """Where it walks by itself; None where it does not. Setting it has it walk there, and then on to other places."""
        return self.world.pedestrians.destination(self.id)

    @destination.setter
    def destination(self, place: Location | None) -> None:
        self.check()
        if place is None:
            self.world.pedestrians.forget(self.id)
        else:
            expect_place(f"the destination of {self!r}", place)
            self.world.pedestrians.send(self, place)

    @property
    def has_fallen(self) -> bool:
        """Whether a vehicle has thrown it down."""
        return bool(self.rows.fallen[self.row])


class Prop(Actor):
    """A thing that stands around.

    Attributes:
        body: Its body in the plane; None where it is attached to something, or has no size.
    """

    body: pymunk.Body | None = None

    @property
    def transform(self) -> Transform:
        """Where it is in the world: a copy. Setting it puts it elsewhere; of an attached one, relative to its parent."""
        return super().transform

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform(f"the transform of {self!r}", value)
        self._transform = value.copy()
        if self.body is not None:
            x, y = value.location.x, value.location.y
            self.world.plane.move(self.body, x, y, np.radians(value.rotation.yaw).item())

    def set_collisions(self, enabled: bool = True) -> None:
        """Let it touch others, or be passed through."""
        self.check()
        if self.body is not None:
            self.world.plane.set_touching(self.body, PROP, enabled)


class Sensor(Actor):
    """A sensor: a collision sensor has the collisions of its parent recorded, others do nothing."""


class Spectator(Actor):
    """Whoever looks at the world."""


class Sign(Actor):
    """A stop, yield or speed-limit sign.

    Attributes:
        signal: What the town says of it.
    """

    def __init__(self, world: World, id: int, blueprint: Blueprint, signal: Signal) -> None:
        place = signal.transform.copy()
        place.rotation.yaw = (place.rotation.yaw + _ACROSS + 180) % 360 - 180
        super().__init__(world, id, blueprint, place)
        self.signal = signal


class TrafficLight(Sign):
    """A traffic light; its numbers are those of row `row` of `world.signals`."""

    def __init__(self, world: World, id: int, blueprint: Blueprint, signal: Signal, row: int) -> None:
        super().__init__(world, id, blueprint, signal)
        self.row = row

    @property
    def _signals(self) -> Signals:
        self.check()
        return self.world.signals

    @property
    def state(self) -> int:
        """0 red, 1 yellow, 2 green, 3 off, 4 unknown; setting it lasts until the group's next change."""
        return int(self._signals.state[self.row])

    @state.setter
    def state(self, state: int) -> None:
        expect_between("the state of a traffic light", state, RED, UNKNOWN)
        self._signals.set_state(self.row, state)

    def set_state(self, state: int) -> None:
        """See `state`."""
        self.state = state

    @property
    def elapsed_time(self) -> float:
        """For how long it has had its state, in s."""
        return float(self._signals.elapsed[self.row])

    @elapsed_time.setter
    def elapsed_time(self, seconds: float) -> None:
        self._expect_time("time", seconds)
        self._signals.elapsed[self.row] = seconds

    @property
    def frozen(self) -> bool:
        """Whether the time of its group stands still."""
        return bool(self._signals.frozen[self.row])

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._signals.freeze(self.row, frozen)

    def freeze(self, frozen: bool = True) -> None:
        """Stop the time of its group, or let it go on."""
        self.frozen = frozen

    @property
    def green_time(self) -> float:
        """How long it is green, in s."""
        return float(self._signals.green_time[self.row])

    @green_time.setter
    def green_time(self, seconds: float) -> None:
        self._set_time("green_time", seconds)

    @property
    def yellow_time(self) -> float:
        """How long it is yellow, in s."""
        return float(self._signals.yellow_time[self.row])

    @yellow_time.setter
    def yellow_time(self, seconds: float) -> None:
        self._set_time("yellow_time", seconds)

    @property
    def red_time(self) -> float:
        """How long all are red after it, in s."""
        return float(self._signals.red_time[self.row])

    @red_time.setter
    def red_time(self, seconds: float) -> None:
        self._set_time("red_time", seconds)

    @property
    def group(self) -> list[TrafficLight]:
        """All lights that take turns with it, itself included."""
        lights = self.world.traffic_lights
        return [lights[row] for row in self._signals.group_of(self.row)]

    def reset_group(self) -> None:
        """Let its group begin its cycle again."""
        self._signals.reset(self.row)

    @property
    def affected_lanes(self) -> tuple[tuple[int, float], ...]:
        """The lanes that it governs, and how far along each one stops, in m."""
        return self.signal.stops

    def _set_time(self, name: str, seconds: float) -> None:
        self._expect_time(name.replace("_", " "), seconds)
        getattr(self._signals, name)[self.row] = seconds
        self.world.pending.light_times.append(self)

    def _expect_time(self, what: str, seconds: float) -> None:
        if not 0 <= seconds <= LARGEST:
            raise SimError(f"{self!r}: a {what} of {seconds:g} s: expected 0 s or more, and at most {LARGEST:g} s")


def upon(parent: Actor, relative: Transform) -> Transform:
    """Where something is in the world that is fixed to a parent."""
    return parent.transform.attached(relative)
