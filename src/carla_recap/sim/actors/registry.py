"""The actors of an episode: spawned with their bodies, destroyed with what is attached to them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import ActorKind
from carla_recap.sim.actors import blueprints
from carla_recap.sim.actors.actor import Actor, Prop, Sensor, Spectator, attached_transform
from carla_recap.sim.actors.lights import Sign, Signals, TrafficLight
from carla_recap.sim.actors.moving import MovingActor, Vehicle, Walker
from carla_recap.sim.actors.triggers import FrictionTrigger
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Transform
from carla_recap.sim.physics.plane import PROP, VEHICLE, WALKER, WALL, Plane
from carla_recap.sim.physics.vehicles import Vehicles
from carla_recap.sim.physics.walkers import Walkers
from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.validation import expect_text, expect_transform

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pymunk

    from carla_recap.sim.actors.actor import Collision
    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.geometry import Location
    from carla_recap.sim.settings import Clock, Settings
    from carla_recap.sim.town.junctions import Signal
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.traffic.controllers import Traffic

_WALKER_MASS: Final = 75.0  # kg
_WALKER_RADIUS: Final = 0.25  # m, of the shoulders
_WALKER_HALF: Final = 0.19  # m: half of the width of a walker as vehicles perceive it, whatever the size of its box
_POLE_RADIUS: Final = 0.15  # m
_FALSE: Final = ("false", "0", "no", "off")
_POLE_BELOW, _POLE_ABOVE = 1.0, 3.0  # m: how far a pole reaches below the road and above its sign
_CLASSES: Final[dict[ActorKind, type[Actor]]] = {
    ActorKind.VEHICLE: Vehicle,
    ActorKind.WALKER: Walker,
    ActorKind.SENSOR: Sensor,
}
LARGEST_WANTED: Final = 2**24
"""The largest id that can be wanted; larger ones in a recording are damage, and would use up CARLA's 32 bits."""


@dataclass(slots=True)
class TickEvents:
    """What happened between the end of the previous tick and the end of this one.

    Attributes:
        spawned: The actors that were spawned, in order.
        destroyed: The ids of the actors that were destroyed.
        parented: Ids of attached actors and of their parents.
        collisions: The collisions, one for each pair of actors.
        physics: The vehicles whose physics control was changed.
        light_times: The lights whose times were changed.
        doors: Vehicle id, door, and whether it is open now.
    """

    spawned: list[Actor] = field(default_factory=list)
    destroyed: list[int] = field(default_factory=list)
    parented: list[tuple[int, int]] = field(default_factory=list)
    collisions: list[Collision] = field(default_factory=list)
    physics: list[Vehicle] = field(default_factory=list)
    light_times: list[TrafficLight] = field(default_factory=list)
    doors: list[tuple[int, int, bool]] = field(default_factory=list)


class ActorRegistry:
    """The actors of an episode; the spectator, the traffic lights and the signs of the town exist from the beginning.

    Args:
        town: The town.
        clock: The simulated time.
        settings: The settings of the simulation.
        library: The blueprint library.
        ids: The ids of the world's actors, also of those of earlier episodes.

    Attributes:
        town: The town.
        clock: The simulated time.
        settings: The settings of the simulation.
        blueprints: The blueprint library.
        traffic: The autopilot and the pedestrian navigation; set before the first tick.
        actors: All actors by id, in the order of spawning.
        plane: The bodies of the actors, and the barriers of the town.
        vehicles: All vehicles, as arrays.
        walkers: All walkers, as arrays.
        signals: All traffic lights, as arrays.
        spectator: The spectator.
        traffic_lights: All traffic lights; light i is row i of `signals`.
        events: The events of the latest tick.
        pending: The events since the latest tick.
        triggers: All friction triggers.
        occupied: The vehicles in triggers: the friction of their tyres outside, and the triggers; the latest one acts.
        ids: The ids of the world's actors, also of those of earlier episodes.
    """

    traffic: Traffic

    def __init__(self, town: Town, clock: Clock, settings: Settings, library: BlueprintLibrary, ids: ActorIds) -> None:
        self.town = town
        self.clock = clock
        self.settings = settings
        self.blueprints = library
        self._actors: dict[int, Actor] = {}
        self._owners: dict[int, Actor] = {}
        self._attached: dict[MovingActor, Actor] = {}
        self.actors: Mapping[int, Actor] = MappingProxyType(self._actors)
        self.plane = Plane()
        self.vehicles = Vehicles(self.plane, town.height)
        self.walkers = Walkers(self.plane, town.height)
        self.signals = Signals(town)
        self.events = TickEvents()
        self.pending = TickEvents()
        self.triggers: list[FrictionTrigger] = []
        self.occupied: dict[Vehicle, tuple[list[float], list[FrictionTrigger]]] = {}
        self.ids = ids
        for barrier in town.barriers:
            self.plane.add_wall(barrier)
        self.spectator = Spectator(self, self.ids.new(), blueprints.SPECTATOR, Transform())
        self._add(self.spectator)
        self.traffic_lights: list[TrafficLight] = []
        for signal in town.signals:
            self._add_sign(signal)

    def end_tick(self, collisions: list[Collision]) -> None:
        """Make the pending events, and the collisions of a tick, the events of that tick.

        A pending collision, which a replay has added, is left out if physics has found one of the same actors.
        """
        self.events, self.pending = self.pending, TickEvents()
        found = {(collision.actor1, collision.actor2) for collision in collisions}
        replayed = [each for each in self.events.collisions if (each.actor1, each.actor2) not in found]
        self.events.collisions = collisions + replayed

    def place(
        self,
        blueprint: Blueprint | str,
        transform: Transform,
        parent: Actor | None,
        attributes: Mapping[str, str],
        wanted_id: int | None = None,
    ) -> Actor:
        """Spawn an actor, even where others are; see `World.place`."""
        blueprint = self.blueprints.resolve(blueprint, attributes)
        expect_transform("the transform", transform, of=blueprint.id)
        for key, value in attributes.items():
            expect_text(key, value, of=blueprint.id)
        if parent is not None:
            parent.check()
        make = _CLASSES.get(blueprint.kind, Prop) if blueprint.id != blueprints.FRICTION_TRIGGER else FrictionTrigger
        actor = make(self, self.ids.new(wanted_id), blueprint, transform, dict(attributes), parent)
        self._add(actor)
        if isinstance(actor, FrictionTrigger):
            self.triggers.append(actor)
        elif isinstance(actor, MovingActor):
            self._add_body(actor, transform if parent is None else attached_transform(parent, transform))
        elif isinstance(actor, Prop) and parent is None and actor.box.extent.length() > 0:
            actor.body = self._own(actor, self.plane.add_box(PROP, _corners(blueprint), None))
            actor.transform = transform
        if parent is not None:
            self.pending.parented.append((actor.id, parent.id))
            if isinstance(actor, MovingActor):
                self._attach(actor, parent)
        return actor

    def occupant(self, blueprint: Blueprint, transform: Transform) -> Actor | None:
        """Return an actor that the box of a blueprint would overlap; None if its place is free."""
        expect_transform("the transform", transform, of=blueprint.id)
        if blueprint.box.extent.length() == 0:
            return None
        location, yaw = transform.location, np.radians(transform.rotation.yaw).item()
        heights = blueprint.box.heights(transform)
        bodies = self.plane.overlapping(_corners(blueprint), location.x, location.y, yaw, heights)
        return next((self._owners[body] for body in bodies if body in self._owners), None)

    def destroy(self, actor: Actor) -> bool:
        """Destroy an actor and what is attached to it; see `World.destroy`."""
        if not actor.is_alive:
            return False
        if isinstance(actor, (Spectator, Sign)):
            raise SimError(f"{actor!r} belongs to the town and cannot be destroyed")
        remaining, parents_first = [actor], []
        while remaining:
            parents_first.append(remaining.pop())
            remaining += parents_first[-1].children
        for each in parents_first:
            each.mark_destroyed()
        for each in reversed(parents_first):
            self._remove(each)
        return True

    def _remove(self, actor: Actor) -> None:
        """Remove a destroyed actor to which nothing is attached."""
        if actor.parent is not None:
            actor.parent.children.remove(actor)
        if isinstance(actor, FrictionTrigger):
            self.triggers.remove(actor)
            actor.release()
        if isinstance(actor, (Vehicle, Walker)):
            self._attached.pop(actor, None)
            del self._owners[actor.rows.remove(actor.id).id]
        elif isinstance(actor, Prop) and actor.body is not None:
            del self._owners[actor.body.id]
            self.plane.remove(actor.body)
        del self._actors[actor.id]
        self.pending.destroyed.append(actor.id)

    def move_attached(self) -> None:
        """Move the vehicles and walkers that are attached to others along with these."""
        for actor, parent in self._attached.items():
            actor.follow_parent(parent)

    def owner(self, body: int) -> Actor | None:
        """Return the actor that a body of the plane belongs to; None for a barrier."""
        return self._owners.get(body)

    def close(self) -> None:
        """Mark all actors as destroyed, at the end of their episode."""
        for actor in self._actors.values():
            actor.mark_destroyed()

    def _add(self, actor: Actor) -> None:
        self._actors[actor.id] = actor
        self.pending.spawned.append(actor)

    def _own(self, actor: Actor, body: pymunk.Body) -> pymunk.Body:
        self._owners[body.id] = actor
        self.plane.set_heights(body, actor.heights)
        return body

    def _add_body(self, mover: MovingActor, transform: Transform) -> None:
        columns = _columns(mover, transform)
        if isinstance(mover, Vehicle):
            physics = mover.physics_control
            body = self._own(mover, self.plane.add_box(VEHICLE, _corners(mover.blueprint), physics.mass))
            sticky = mover.attributes.get("sticky_control", "true").lower() not in _FALSE
            row = self.vehicles.add(mover, body, **columns, sticky=sticky)
            self.vehicles.set_physics(row, physics, mover.box)
        elif isinstance(mover, Walker):
            body = self._own(mover, self.plane.add_disc(WALKER, _WALKER_RADIUS, _WALKER_MASS))
            self.walkers.add(mover, body, **columns, half_height=mover.box.extent.z, mass=_WALKER_MASS)

    def _attach(self, actor: MovingActor, parent: Actor) -> None:
        """Attach a vehicle or walker to another actor: it moves along and collides with none, as attached props."""
        self._attached[actor] = parent
        actor.rows.carried[actor.row] = True
        actor.set_simulate_physics(False)
        actor.set_collisions(False)
        actor.follow_parent(parent)

    def _add_sign(self, signal: Signal) -> None:
        """Add a light or sign of the town; it has a pole, unless it hangs over the road."""
        if signal.kind is SignalKind.LIGHT:
            light = TrafficLight(self, self.ids.new(), blueprints.TRAFFIC_LIGHT, signal, len(self.traffic_lights))
            self.traffic_lights.append(light)
            sign: Sign = light
        else:
            sign = Sign(self, self.ids.new(), _sign_blueprint(signal), signal)
        self._add(sign)
        location = signal.transform.location
        if not self._is_on_road(location):
            body = self._own(sign, self.plane.add_disc(WALL, _POLE_RADIUS, None))
            ground = self.town.height([location.x], [location.y], [location.z])[0].item()
            pole = ground - _POLE_BELOW, max(ground, location.z) + _POLE_ABOVE
            self.plane.set_heights(body, lambda: pole)
            self.plane.move(body, location.x, location.y, 0.0)

    def _is_on_road(self, location: Location) -> bool:
        x, y = np.array([location.x]), np.array([location.y])
        lane, s = self.town.nearest_lane(x, y, z=self.town.height(x, y, [location.z]))
        offset = abs(self.town.project(lane, x, y, s)[1][0])
        return bool(offset < self.town.lanes[lane[0]].width / 2 + _POLE_RADIUS)


def _sign_blueprint(signal: Signal) -> Blueprint:
    if signal.kind is SignalKind.SPEED_LIMIT:
        return blueprints.speed_limit((signal.speed_limit or 0.0) * 3.6)
    return blueprints.STOP_SIGN if signal.kind is SignalKind.STOP else blueprints.YIELD_SIGN


def _corners(blueprint: Blueprint) -> list[tuple[float, float]]:
    """Return the outline of a blueprint's box from above."""
    centre, extent = blueprint.box.location, blueprint.box.extent
    return [(centre.x + x * extent.x, centre.y + y * extent.y) for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]


def _columns(mover: MovingActor, transform: Transform) -> dict[str, float | tuple[float, float, float]]:
    location, turn, extent = transform.location, transform.rotation, mover.box.extent
    half = (_WALKER_HALF, _WALKER_HALF) if isinstance(mover, Walker) else (extent.x, extent.y)
    return {
        "position": (location.x, location.y, location.z),
        "rotation": (turn.pitch, turn.yaw, turn.roll),
        "half_length": half[0],
        "half_width": half[1],
        "bottom": mover.box.location.z - extent.z,
        "top": mover.box.location.z + extent.z,
    }


class ActorIds:
    """Gives each actor of a world, through all its episodes, an id of its own.

    As in CARLA, an actor can have an id that is wanted, if it is free, and later ones get larger ids. Unlike in CARLA, the
    id of a destroyed actor is not free: clients may still ask for that actor.
    """

    def __init__(self) -> None:
        self._next = 1
        self._gaps: list[range] = []  # the ids below the next one that no actor ever had, ascending

    def new(self, wanted: int | None = None) -> int:
        """Return an id that no actor ever had.

        Args:
            wanted: The id to return if it is free, from 1 to `LARGEST_WANTED`; else, and for None, it is the next one.
        """
        if wanted is not None and 0 < wanted <= LARGEST_WANTED:
            self.reserve(wanted)
            index = bisect_right(self._gaps, wanted, key=lambda gap: gap.start) - 1
            if index >= 0 and wanted in (gap := self._gaps[index]):
                rest = range(gap.start, wanted), range(wanted + 1, gap.stop)
                self._gaps[index : index + 1] = [part for part in rest if part]
                return wanted
        self._next += 1
        return self._next - 1

    def reserve(self, largest: int) -> None:
        """Keep the free ids up to one for actors for which they are wanted; it has no effect beyond `LARGEST_WANTED`."""
        if self._next <= largest <= LARGEST_WANTED:
            self._gaps.append(range(self._next, largest + 1))
            self._next = largest + 1
