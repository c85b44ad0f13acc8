"""The actors of a recording: when each appears and disappears, and its properties."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.model.records import CM, NO_ACTOR, ActorKind, Spawn
from carla_recap.queries import Answer
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Packet


HERO: Final = "hero"
ActorName = int | Literal["hero"]
"""An actor: its id, or "hero", the first one with that role name."""


@dataclass(frozen=True, slots=True)
class BoundingBox:
    """The bounding box of an actor in its own axes, right-handed (x forward, y left, z up): centre and half extents in m."""

    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float


@dataclass(slots=True)
class Actor:
    """An actor of a recording.

    Attributes:
        id: The actor id; if a recording uses it again, each actor that had it is listed.
        type_id: The blueprint, such as vehicle.tesla.model3.
        kind: The kind: vehicle, walker, traffic_light, traffic_sign, sensor, other; or CARLA's number, if unknown.
        role_name: The attribute role_name, "" without one.
        spawned_at: The elapsed seconds at which it appears.
        destroyed_at: The elapsed seconds at which it disappears; None if it stays.
        parent: The actor that it is attached to, if any.
        attributes: All attributes, as text.
        bounding_box: Its bounding box; None unless a finite one of positive size is recorded.
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

    @property
    def is_hero(self) -> bool:
        """Whether its role_name is hero."""
        return self.role_name == HERO


class RecordedActors(Answer[Actor]):
    """The actors of a recording, in order of appearance."""

    row_type = Actor
    row_units: ClassVar = {"spawned_at": "s", "destroyed_at": "s"}


def actors(source: Reader) -> RecordedActors:
    """Return the actors of a recording; on MCAP, they are read from the events alone.

    Raises:
        FormatError: The file contradicts its format.
    """
    collector = ActorCollector()
    for frame in source.frames(TYPES, sparse=True):
        for packet in frame.packets:
            collector.add(packet, frame.elapsed)
    return RecordedActors(collector.actors, source, compat=False)


def find_actor(location: object, known: Iterable[Actor], wanted: ActorName, what: str = "actor", purpose: str = "") -> Actor:
    """Return the actor that is asked for; of several that had its id, the first.

    Args:
        location: The recording, for messages.
        known: The actors that can be asked for.
        wanted: An id, or "hero".
        what: The noun for such an actor, for messages.
        purpose: What it is needed for, for messages, such as "to follow".

    Raises:
        RecapError: There is no such actor; the message names the hero, and vehicles and walkers of near ids.
    """
    known, end = list(known), f" {purpose}" if purpose else ""
    if wanted != HERO and not isinstance(wanted, Integral):
        raise RecapError(f"{location}: an actor id or 'hero' was expected{end}, found {wanted!r}")
    found = next((actor for actor in known if (actor.is_hero if wanted == HERO else actor.id == wanted)), None)
    if found is not None:
        return found
    if wanted == HERO:
        raise RecapError(f"{location}: there is no hero{end} (no {what} has the role_name hero)")
    ranks = {"vehicle": 0, "walker": 1}
    movers = [actor for actor in known if actor.is_hero or actor.kind in ranks]
    near = sorted(
        movers or known, key=lambda actor: (not actor.is_hero, ranks.get(actor.kind, len(ranks)), abs(actor.id - wanted))
    )
    names = {actor.id: f"{actor.id} ({HERO if actor.is_hero else actor.kind.replace('_', ' ')})" for actor in near}
    some = ", ".join(list(names.values())[:3]) or "none"
    raise RecapError(f"{location}: no {what} {wanted}{end}; known ids are {some}")


TYPES: Final = ("spawned", "destroyed", "parented", "bounding_boxes")
"""The record types that describe actors."""


class ActorCollector:
    """Collects the actors that are described by packets.

    Attributes:
        actors: The actors, in order of appearance.
    """

    def __init__(self) -> None:
        self.actors: list[Actor] = []
        self._present: dict[int, Actor] = {}

    def add(self, packet: Packet, elapsed: float) -> None:
        """Add a packet of a frame at a time in seconds; packets of other types than `TYPES` do not count."""
        name, records, present = packet.type.name if packet.type else "", packet.records, self._present
        if name not in TYPES:
            return
        if name == "spawned":
            for spawn in records:
                self._spawn(spawn, elapsed)
            return
        for id, *values in records.tolist():  # type: ignore[union-attr]
            if id not in present:
                continue
            if name == "destroyed":
                present.pop(id).destroyed_at = elapsed
            elif name == "parented":
                (present[id].parent,) = values
            elif all(map(math.isfinite, values)) and min(values[3:]) > 0:
                x, y, z, *extent = (value * CM for value in values)
                present[id].bounding_box = BoundingBox(x, -y, z, *extent)

    def _spawn(self, spawn: Spawn, elapsed: float) -> None:
        attributes = {readable(item.key): readable(item.value) for item in spawn.attributes}
        kind = ActorKind(spawn.kind).name.lower() if spawn.kind in _KINDS else str(spawn.kind)
        role_name = attributes.get("role_name", "")
        actor = Actor(spawn.id, readable(spawn.type_id), kind, role_name, elapsed, attributes=attributes)
        self._present[spawn.id] = actor
        self.actors.append(actor)


_KINDS: Final = frozenset(ActorKind)


class ActorsByTime:
    """The actors that had an id at some time."""

    def __init__(self, actors: Iterable[Actor]) -> None:
        self._actors: dict[int, list[Actor]] = defaultdict(list)
        self._spawned: dict[int, list[float]] = defaultdict(list)
        for actor in actors:
            self._actors[actor.id].append(actor)
            self._spawned[actor.id].append(actor.spawned_at)

    def ids(self, kind: str) -> list[int]:
        """Return the ids that an actor of a kind had at some time."""
        return [id for id, actors in self._actors.items() if any(actor.kind == kind for actor in actors)]

    def get(self, id: int, time: float) -> Actor | None:
        """Return the actor that had an id at a time; None if unknown."""
        if id not in self._actors:
            return None
        return self._actors[id][max(bisect_right(self._spawned[id], time) - 1, 0)]

    def kind(self, id: int, time: float) -> str:
        """Return the kind of an actor; empty if unknown."""
        actor = self.get(id, time)
        return actor.kind if actor else ""

    def type_ids(self, ids: tuple[int, ...], time: float) -> tuple[str, ...]:
        """Return the blueprints of actors; empty for unknown actors."""
        return tuple(actor.type_id if (actor := self.get(id, time)) else "" for id in ids)

    def is_no_actor(self, id: int) -> bool:
        """Return whether an id stands for an object that is no actor; before CARLA 0.9.13 that is 0."""
        return id == NO_ACTOR or (id == 0 and id not in self._actors)

    def name(self, id: int, time: float) -> str:
        """Return the name of an actor for a text."""
        if self.is_no_actor(id):
            return "something that is no actor"
        actor = self.get(id, time)
        if actor is None:
            return f"actor {id}"
        return "hero" if actor.is_hero else f"{actor.type_id} ({id})"
