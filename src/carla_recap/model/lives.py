"""The actors of a recording: who had an id when, and the order in which CARLA iterates over them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from math import isqrt
from numbers import Integral
from typing import TYPE_CHECKING, Final, Generic, Literal, TypeVar

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.motion import place_in_metres
from carla_recap.model.records import CM, NO_ACTOR, ActorKind, Physics, Spawn
from carla_recap.util.text import first_of, readable

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.frame import Packet

A = TypeVar("A")

HERO: Final = "hero"
ActorName = int | Literal["hero"]
"""An actor: its id, or "hero", the first one with that role name, vehicles and walkers before others."""
ROAD_USERS: Final = ("vehicle", "walker")
"""The kinds of actors that take part in traffic, the most important first."""
STATIC_OBJECT: Final = "a static object"
"""What a text calls an object that is no actor, such as a building or a barrier."""
TYPES: Final = ("spawned", "destroyed", "parented", "bounding_boxes")
"""The record types that describe actors."""

_KINDS: Final = {kind.value: kind.name.lower() for kind in ActorKind}


@dataclass(frozen=True, slots=True)
class BoundingBox:
    """The bounding box of an actor in its own axes, right-handed (x forward, y left, z up): centre and half extents in m."""

    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float

    @classmethod
    def of(cls, sizes: Sequence[float]) -> BoundingBox | None:
        """Return the box of centre and half extents in cm, left-handed; None unless it is finite and has a size."""
        if not all(map(math.isfinite, sizes)) or min(sizes[3:]) <= 0:
            return None
        x, y, z, *extent = (size * CM for size in sizes)
        return cls(x, 0.0 - y, z, *extent)


@dataclass(slots=True)
class ActorLife:
    """An actor of a recording, from its spawn to its end.

    Attributes:
        id: The actor id; if a recording uses it again, each actor that had it has a life.
        type_id: The blueprint, such as vehicle.tesla.model3.
        kind: The kind: vehicle, walker, traffic_light, traffic_sign, sensor, other; or CARLA's number, if unknown.
        role_name: The attribute role_name, "" without one.
        spawned_at: The elapsed seconds at which it appears.
        destroyed_at: The elapsed seconds at which it disappears; None if it stays.
        parent: The actor that it is attached to, if any.
        attributes: All attributes, as text.
        bounding_box: Its bounding box; None unless a finite one of positive size is recorded.
        attached: Whether it was attached when it was spawned: the pose of its spawn is then in the parent's axes.
        spawn: The record of its spawn, with its pose in cm and degrees, left-handed.
        physics: The latest record of its physics, in a replay; None without one.
        physics_pose: Its pose in the frame of that record; None if the frame has none.

    The last four are no columns of a table.
    """

    id: int
    type_id: str
    kind: str
    role_name: str
    spawned_at: float
    destroyed_at: float | None = None
    parent: int | None = None
    attributes: dict[str, str] = field(default_factory=dict)
    bounding_box: BoundingBox | None = None
    attached: bool = field(default=False, repr=False)
    spawn: Spawn = field(kw_only=True, repr=False, compare=False)
    physics: Physics | None = field(default=None, repr=False, compare=False)
    physics_pose: tuple[float, ...] | None = field(default=None, repr=False, compare=False)

    @classmethod
    def of(cls, spawn: Spawn, elapsed: float) -> ActorLife:
        """Return an actor that appears at some elapsed seconds."""
        attributes = {readable(item.key): readable(item.value) for item in spawn.attributes}
        kind = _KINDS.get(spawn.kind, str(spawn.kind))
        role_name = attributes.get("role_name", "")
        return cls(spawn.id, readable(spawn.type_id), kind, role_name, elapsed, attributes=attributes, spawn=spawn)

    @property
    def is_hero(self) -> bool:
        """Whether its role_name is hero."""
        return self.role_name == HERO

    @property
    def key(self) -> tuple[int, float]:
        """The id and the time at which it appears, which no other actor has both of."""
        return self.id, self.spawned_at

    @property
    def end(self) -> float:
        """The elapsed seconds at which it disappears; inf if it stays."""
        return math.inf if self.destroyed_at is None else self.destroyed_at

    @property
    def place(self) -> tuple[float, float, float]:
        """The place of its spawn, in m, right-handed; in the parent's axes if it is `attached`."""
        return place_in_metres(self.spawn.x, self.spawn.y, self.spawn.z)

    @property
    def spawn_pose(self) -> NDArray[np.float64]:
        """x, y, z in cm and roll, pitch, yaw in degrees, left-handed; in the parent's axes if it is `attached`."""
        spawn = self.spawn
        return np.array((spawn.x, spawn.y, spawn.z, spawn.roll, spawn.pitch, spawn.yaw))

    @property
    def name(self) -> str:
        """What a text calls it."""
        return HERO if self.is_hero else f"{self.type_id} ({self.id})"


class ActorLives:
    """All actors of a recording, by id and time; iterable in order of appearance, in which they are given and added."""

    def __init__(self, lives: Iterable[ActorLife] = ()) -> None:
        self._by_id: dict[int, list[ActorLife]] = {}
        self._all: list[ActorLife] = []
        self._present: dict[int, ActorLife] = {}
        for life in lives:
            self._append(life)

    def __iter__(self) -> Iterator[ActorLife]:
        return iter(self._all)

    def add(self, packets: Iterable[Packet], elapsed: float) -> None:
        """Add the packets of a frame at a time in seconds; packets of other types than `TYPES` do not count."""
        present, new = self._present, set[int]()
        for packet in packets:
            name = packet.type.name if packet.type else ""
            if name == "spawned":
                for spawn in packet.records:
                    if spawn.id in present:  # whose end is not recorded
                        present[spawn.id].destroyed_at = elapsed
                    life = present[spawn.id] = ActorLife.of(spawn, elapsed)
                    new.add(spawn.id)
                    self._append(life)
            elif name in TYPES:
                for id, *values in packet.records.tolist():  # type: ignore[union-attr]
                    if id not in present:
                        continue
                    if name == "destroyed":
                        present.pop(id).destroyed_at = elapsed
                    elif name == "parented":
                        (present[id].parent,) = values
                        present[id].attached = id in new
                    elif (box := BoundingBox.of(values)) is not None:
                        present[id].bounding_box = box

    def _append(self, life: ActorLife) -> None:
        self._all.append(life)
        self._by_id.setdefault(life.id, []).append(life)

    def at(self, id: int, time: float) -> ActorLife | None:
        """Return the actor that had an id at a time; the first one to have it, if none had it yet; None if unknown."""
        lives = self._by_id.get(id)
        return lives[max(bisect_right(lives, time, key=lambda life: life.spawned_at) - 1, 0)] if lives else None

    def ids(self, *kinds: str) -> list[int]:
        """Return the ids that an actor of some kinds had at some time; without kinds, all ids."""
        return [id for id, lives in self._by_id.items() if not kinds or any(life.kind in kinds for life in lives)]

    def reuses(self) -> dict[int, list[float]]:
        """Return, by id, the times at which an actor gets the id of another one."""
        return {id: [life.spawned_at for life in lives[1:]] for id, lives in self._by_id.items() if len(lives) > 1}

    def kind(self, id: int, time: float) -> str:
        """Return the kind of an actor; empty if unknown."""
        life = self.at(id, time)
        return life.kind if life else ""

    def type_ids(self, ids: Iterable[int], time: float) -> tuple[str, ...]:
        """Return the blueprints of actors; empty for unknown actors."""
        return tuple(life.type_id if (life := self.at(id, time)) else "" for id in ids)

    def is_object(self, id: int) -> bool:
        """Return whether an id stands for a static object, which is no actor."""
        return is_object(id, self._by_id)

    def is_fixed(self, id: int, time: float) -> bool:
        """Return whether an id stands for what never moves: a static object, or a traffic light."""
        return self.is_object(id) or self.kind(id, time) == "traffic_light"

    def name(self, id: int, time: float) -> str:
        """Return what a text calls an actor or a static object."""
        if self.is_object(id):
            return STATIC_OBJECT
        life = self.at(id, time)
        return life.name if life else f"actor {id}"


def is_object(id: int, actors: Container[int]) -> bool:
    """Return whether an id stands for a static object, which is none of the actors; before CARLA 0.9.13 that is 0."""
    return id == NO_ACTOR or (id == 0 and id not in actors)


def ranked(ids: tuple[int, int], actors: Mapping[int, ActorLife], heroes: tuple[bool, bool]) -> tuple[int, int]:
    """Return both ids of a collision: the hero first, else a vehicle, a walker, the actor with the sensor; an object last.

    The id of the actor with the sensor is given first, as is whether it is recorded as the hero.
    """

    def rank(side: int) -> int:
        actor = actors.get(ids[side])
        if is_object(ids[side], actors):
            return 5
        if heroes[side] or (actor and actor.is_hero):
            return 0
        return 1 + (*ROAD_USERS, actor.kind).index(actor.kind) if actor else 4

    first, second = sorted((0, 1), key=rank)
    return ids[first], ids[second]


def find_actor(
    location: object, known: Iterable[ActorLife], wanted: ActorName, what: str = "actor", purpose: str = ""
) -> ActorLife:
    """Return the actor that is asked for by its id, or as "hero"; of several that had its id, the first.

    If there is none, a `RecapError` names the hero, and vehicles and walkers of near ids; it calls the actor `what`, and
    says the purpose, such as "to follow".
    """
    known, end = list(known), f" {purpose}" if purpose else ""
    if wanted != HERO and not isinstance(wanted, Integral):
        raise RecapError(f"{location}: expected an actor id or 'hero'{end}, found {wanted!r}")
    matching = heroes_of(known) if wanted == HERO else (actor for actor in known if actor.id == wanted)
    found = next(iter(matching), None)
    if found is not None:
        return found
    if wanted == HERO:
        raise RecapError(f"{location}: there is no hero{end} (no {what} has the role_name hero)")
    ranks = {kind: rank for rank, kind in enumerate(ROAD_USERS)}
    movers = [actor for actor in known if actor.is_hero or actor.kind in ranks]
    near = sorted(
        movers or known, key=lambda actor: (not actor.is_hero, ranks.get(actor.kind, len(ranks)), abs(actor.id - wanted))
    )
    names = {actor.id: f"{actor.id} ({HERO if actor.is_hero else actor.kind.replace('_', ' ')})" for actor in near}
    raise RecapError(f"{location}: no {what} {wanted}{end}; known ids are {first_of(list(names.values()))}")


def heroes_of(known: Iterable[ActorLife]) -> list[ActorLife]:
    """Return the actors whose role_name is hero, vehicles and walkers first."""
    return sorted((actor for actor in known if actor.is_hero), key=lambda actor: actor.kind not in ROAD_USERS)


class PresentActors(Generic[A]):
    """The actors that are present, by id, in the order of their spawns.

    When an actor is destroyed, CARLA removes the one that was spawned last instead, or id 0 before any spawn; with `compat`,
    this is reproduced.
    """

    def __init__(self, *, compat: bool) -> None:
        self.actors: dict[int, A] = {}
        self._compat = compat
        self._newest = 0

    def spawn(self, id: int, actor: A) -> None:
        """Add an actor."""
        self.actors[id] = actor
        self._newest = id

    def destroy(self, id: int) -> A | None:
        """Remove an actor and return it; None if it is not present."""
        return self.actors.pop(self._newest if self._compat else id, None)


class HashOrder:
    """Ids in the order in which CARLA iterates over its table of actors, an `unordered_map` of libc++.

    The hash of an id is the id itself. All entries form one linked list, in which the entries of a bucket are neighbours: a
    new entry becomes the first of its bucket, and a new bucket is inserted at the front of the list. A full table first
    grows to a prime number of buckets that is at least twice the number before.
    """

    def __init__(self) -> None:
        self._size = self._count = 0  # the numbers of buckets and entries
        self._buckets: dict[int, deque[int]] = {}  # those with entries, the last one in front

    def ids(self) -> Iterator[int]:
        """Yield the ids."""
        return (id for bucket in reversed(self._buckets.values()) for id in bucket)

    def add(self, id: int) -> None:
        """Add an id if it is not present."""
        if self._size and id in self._buckets.get(id % self._size, ()):
            return
        if self._count >= self._size:
            # The number of buckets is a power of two only in a table of 2, which grows from an empty one.
            self._grow(_next_prime(max(2 * self._size + 1, 2)))
        self._count += 1
        self._buckets.setdefault(id % self._size, deque()).appendleft(id)

    def remove(self, id: int) -> None:
        """Remove an id that is present."""
        bucket = self._buckets[id % self._size]
        bucket.remove(id)
        self._count -= 1
        if not bucket:
            del self._buckets[id % self._size]

    def _grow(self, size: int) -> None:
        """Distribute the list over more buckets: each entry becomes the first of its bucket, or follows on the last."""
        buckets: dict[int, deque[int]] = {}
        latest = None
        for id in self.ids():
            bucket = buckets.get(id % size)
            if bucket is None:
                latest, buckets[id % size] = id % size, deque((id,))
            elif latest == id % size:
                bucket.append(id)
            else:
                bucket.appendleft(id)
        self._size, self._buckets = size, dict(reversed(buckets.items()))


def _next_prime(number: int) -> int:
    while any(number % divisor == 0 for divisor in range(2, isqrt(number) + 1)):
        number += 1
    return number
