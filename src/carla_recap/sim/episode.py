"""The state of a simulated world from the load of its map to the next load: town, time, weather, actors and events.

An actor is a handle. What moves is a row of the episode's arrays, which physics, traffic and recorder compute with.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from carla_recap.model.lives import HERO
from carla_recap.sim import blueprints
from carla_recap.sim.errors import DeadActor, SimError
from carla_recap.sim.geometry import Transform, Vector
from carla_recap.sim.physics.plane import Plane
from carla_recap.sim.physics.vehicles import Vehicles
from carla_recap.sim.physics.walkers import Walkers
from carla_recap.sim.settings import Weather
from carla_recap.sim.signals import Signals
from carla_recap.sim.validation import expect_numbers, expect_transform

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np

    from carla_recap.model.records import ActorKind
    from carla_recap.sim.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.geometry import Box, Location
    from carla_recap.sim.settings import Clock, Settings
    from carla_recap.sim.town.loading import Town

LARGEST_WANTED: Final = 2**24
"""The largest id that can be wanted; larger ones in a recording are damage, and would use up CARLA's 32 bits."""

LARGEST_ID: Final = 2**27
"""The largest id of an actor: the number of a sensor's stream has 28 bits beside those of the release of its clients."""


@dataclass(frozen=True, slots=True)
class Collision:
    """A collision of an actor that is watched: a hero, or one with a collision sensor.

    Attributes:
        actor1: The id of that actor.
        actor2: The id of the actor that it collided with; None for a barrier, which is no actor.
        location: The first point of contact; in a replay, the point halfway between the actors.
        impulse: The impulse on actor1 in N s; in a replay, an estimate.
        hero1: Whether actor1 is a hero.
        hero2: Whether actor2 is a hero.
        number: The number of the collision in its episode, from 0; in a replay, the recorded number.
    """

    actor1: int
    actor2: int | None
    location: Location
    impulse: Vector
    hero1: bool
    hero2: bool
    number: int


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
    physics: list[Actor] = field(default_factory=list)
    light_times: list[Actor] = field(default_factory=list)
    doors: list[tuple[int, int, bool]] = field(default_factory=list)


class Episode:
    """The state of a world.

    Attributes:
        random: The source of all randomness.
        ids: The ids of the world's actors, also of those of earlier episodes.
        plane: The bodies of the actors, and the barriers of the town.
        actors: All actors by id, in the order of spawning.
        owners: The actors by the ids of their bodies in the plane; barriers have none.
        attached: The vehicles and walkers that are attached to others, by id, parents before their children.
        occupied: The ids of the vehicles in friction triggers: the friction of their tyres outside, and that of the
            triggers by their ids; the latest one acts.
        events: The events of the latest tick, and between it and the one before.
        pending: The events since the latest tick, which the next one will add to `events`.
        replayed: The recording that is being replayed.
    """

    def __init__(
        self,
        number: int,
        town: Town,
        clock: Clock,
        settings: Settings,
        random: np.random.Generator,
        library: BlueprintLibrary,
        ids: ActorIds,
    ) -> None:
        self.number = number
        self.town = town
        self.clock = clock
        self.settings = settings
        self.random = random
        self.blueprints = library
        self.ids = ids
        self.plane = Plane()
        self.vehicles = Vehicles(self.plane, town.height)
        self.walkers = Walkers(self.plane, town.height)
        self.signals = Signals(town)
        self.actors: dict[int, Actor] = {}
        self.owners: dict[int, Actor] = {}
        self.attached: dict[int, Actor] = {}
        self.triggers: list[Actor] = []
        self.occupied: dict[int, tuple[list[float], dict[int, float]]] = {}
        self.events = TickEvents()
        self.pending = TickEvents()
        self.replayed: Path | None = None
        self._weather = Weather()
        for barrier in town.barriers:
            self.plane.add_wall(barrier)
        self.spectator = Spectator(self, self.ids.new(), blueprints.SPECTATOR, Transform())
        self.add(self.spectator)

    @property
    def weather(self) -> Weather:
        """The weather; set it to change it.

        Raises:
            SimError: When it is set: it is no `Weather`, or a number is too large for a recording.
        """
        return self._weather

    @weather.setter
    def weather(self, weather: Weather) -> None:
        if not isinstance(weather, Weather):
            raise SimError(f"the weather: a Weather was expected, such as PRESETS['HardRainNoon'], not {weather!r:.60}")
        expect_numbers("the weather", weather)
        self._weather = weather

    def impulse(self, force: Vector) -> Vector:
        """Return the impulse of a force that acts during the next tick, from N to N s, or of a torque."""
        seconds = self.settings.fixed_delta_seconds or self.clock.delta
        return Vector(force.x * seconds, force.y * seconds, force.z * seconds)

    def add(self, actor: Actor) -> None:
        """Add a new actor."""
        self.actors[actor.id] = actor
        self.pending.spawned.append(actor)

    def end_tick(self, collisions: list[Collision]) -> None:
        """Make the pending events, and the collisions of a tick, the events of that tick.

        A pending collision, which a replay has added, is left out if physics has found one of the same actors.
        """
        self.clock.advance()
        self.events, self.pending = self.pending, TickEvents()
        found = {(collision.actor1, collision.actor2) for collision in collisions}
        replayed = [each for each in self.events.collisions if (each.actor1, each.actor2) not in found]
        self.events.collisions = collisions + replayed

    def close(self) -> None:
        """Mark all actors as destroyed, at the end of the episode."""
        for actor in self.actors.values():
            actor.mark_destroyed()


class Actor:
    """Something in a world. `World.spawn` makes them.

    Attributes:
        episode: The episode that it belongs to.
        id: Its number, never reused.
        blueprint: The blueprint that it was made from.
        attributes: Its attributes, as text.
        parent: The actor that it is attached to.
        children: The actors that are attached to it.
        is_alive: Whether it has not been destroyed.
        has_motion: Whether it has a motion of its own, and not that of its parent.
        is_of_town: Whether it belongs to the town and cannot be destroyed.
    """

    has_motion = False
    is_of_town = False

    def __init__(
        self,
        episode: Episode,
        id: int,
        blueprint: Blueprint,
        transform: Transform,
        attributes: dict[str, str] | None = None,
        parent: Actor | None = None,
    ) -> None:
        self.episode = episode
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
        """Its kind, as recordings number kinds."""
        return self.blueprint.kind

    @property
    def box(self) -> Box:
        """The box around it, in its own axes."""
        return self.blueprint.box

    def heights(self) -> tuple[float, float]:
        """Return the z of the lowest and of the highest point of its box in the world, in m."""
        return self.box.heights(self.transform)

    @property
    def is_hero(self) -> bool:
        """Whether its role name is hero."""
        return self.attributes.get("role_name") == HERO

    @property
    def transform(self) -> Transform:
        """A copy of its transform in the world. Setting it moves the actor; an attached one, relative to its parent.

        A vehicle or walker keeps its speed.
        """
        return self._place() if self.is_alive else self._transform.copy()

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform("the transform", value, of=self)
        self._transform = value.copy()
        self._move_body()

    def _place(self) -> Transform:
        """Return the transform in the world of a live actor."""
        return self._transform.copy() if self.parent is None else transforms([self])[0]

    def _move_body(self) -> None:
        """Move what the episode has of it besides itself to its transform, which is set."""

    @property
    def relative_transform(self) -> Transform:
        """Its transform relative to its parent; in the world, if it has none."""
        return self._transform.copy() if self.parent is not None else self.transform

    @property
    def velocity(self) -> Vector:
        """Its velocity in m/s."""
        return self._vector("velocity")

    @property
    def angular_velocity(self) -> Vector:
        """Its angular velocity in degrees/s."""
        return self._vector("angular_velocity")

    @property
    def acceleration(self) -> Vector:
        """Its acceleration in m/s²."""
        return self._vector("acceleration")

    def _vector(self, column: str) -> Vector:
        return Vector() if self.carrier is None else self.carrier._vector(column)

    @property
    def carrier(self) -> Actor | None:
        """The nearest actor with a motion of its own among those that it is attached to."""
        carrier = self.parent
        while carrier is not None and not carrier.has_motion:
            carrier = carrier.parent
        return carrier

    def follow_parent(self) -> None:
        """Take over position and motion from the parent; one without a motion of its own has its parent's in any case."""

    def update(self, place: Transform) -> None:
        """Act on other actors from a place at the end of the motion of a tick; triggers do."""

    def destroy(self) -> bool:
        """Destroy it and what is attached to it.

        Returns:
            False if it had been destroyed before.

        Raises:
            SimError: It belongs to the town.
        """
        if not self.is_alive:
            return False
        if self.is_of_town:
            raise SimError(f"{self!r} belongs to the town and cannot be destroyed")
        remaining, parents_first = [self], []
        while remaining:
            parents_first.append(remaining.pop())
            remaining += parents_first[-1].children
        for actor in parents_first:
            actor.mark_destroyed()
        for actor in reversed(parents_first):
            actor._leave()
        return True

    def _leave(self) -> None:
        """Leave the episode; nothing is attached to it any more."""
        if self.parent is not None:
            self.parent.children.remove(self)
        self._remove_body()
        del self.episode.actors[self.id]
        self.episode.pending.destroyed.append(self.id)

    def _remove_body(self) -> None:
        """Remove what the episode has of it besides itself."""

    def mark_destroyed(self) -> None:
        """Keep its last transform, and let everything that needs a live actor raise `DeadActor` from now on."""
        self._transform = self.transform
        self.is_alive = False

    def check(self) -> None:
        """Make sure that it is alive, or raise `DeadActor`."""
        if not self.is_alive:
            raise DeadActor(f"actor {self.id} ({self.type_id}) has been destroyed")


class Spectator(Actor):
    """The viewpoint of the user."""

    is_of_town = True


def transforms(actors: Sequence[Actor]) -> list[Transform]:
    """Return the transforms of actors in the world; each transform that others are relative to is computed once."""
    found: dict[Actor, Transform] = {}
    for actor in actors:
        base, chain = actor, []
        while base not in found and base.parent is not None and base.is_alive and not base.has_motion:
            chain.append(base)
            base = base.parent
        found[base] = place = found.get(base) or base.transform
        for each in reversed(chain):
            found[each] = place = place.attached(each._transform)
    return [found[actor] for actor in actors]


class ActorIds:
    """Gives each actor of a world, through all its episodes, an id of its own.

    As in CARLA, an actor can have an id that is wanted, if it is free, and later ones get larger ids. Unlike in CARLA, the
    id of a destroyed actor is not free: clients may still ask for that actor.
    """

    def __init__(self) -> None:
        self._next = 1
        self._gaps: list[range] = []  # the ids below the next one that no actor ever had, ascending

    def new(self, wanted: int | None = None) -> int:
        """Return an id that no actor ever had: the wanted one if it is free, from 1 to `LARGEST_WANTED`; else the next one.

        A `SimError` is raised if a world has had as many actors as it can have.
        """
        if wanted is not None and 0 < wanted <= LARGEST_WANTED:
            self.reserve(wanted)
            index = bisect_right(self._gaps, wanted, key=lambda gap: gap.start) - 1
            if index >= 0 and wanted in (gap := self._gaps[index]):
                rest = range(gap.start, wanted), range(wanted + 1, gap.stop)
                self._gaps[index : index + 1] = [part for part in rest if part]
                return wanted
        if self._next > LARGEST_ID:
            raise SimError(f"expected at most {LARGEST_ID} actors in all episodes of a world, found one more")
        self._next += 1
        return self._next - 1

    def reserve(self, largest: int) -> None:
        """Keep the free ids up to one for actors for which they are wanted; it has no effect beyond `LARGEST_WANTED`."""
        if self._next <= largest <= LARGEST_WANTED:
            self._gaps.append(range(self._next, largest + 1))
            self._next = largest + 1
