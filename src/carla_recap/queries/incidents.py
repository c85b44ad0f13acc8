"""What went wrong in a recording: collisions, vehicles and walkers that stood still for long, and hard braking."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Literal

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import CM, NO_ACTOR
from carla_recap.queries.actors import actors
from carla_recap.queries.answer import Answer
from carla_recap.queries.blocked import blocked as find_blocked
from carla_recap.queries.braking import HALF_WINDOW, SHORTEST, hard_braking

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Frame
    from carla_recap.queries.actors import Actor, Actors

Kind = Literal["collision", "blocked", "hard braking"]

HARD: Final = 6.0
"""The deceleration from which on braking is hard, in m/s²."""

_TOGETHER: Final = 1.0  # s; records of a pair that are less apart are of one contact
_AFTERMATH: Final = 0.5  # s; so long after a contact, slowing down is part of it
_LOOK_UPS: Final = 500  # frames that are found by index; more are found by reading all
_KMH: Final = 3.6  # km/h in m/s
_ROAD_USERS: Final = ("vehicle", "walker")

Place = tuple[float, float, float]
_NOWHERE: Final[Place] = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Incident:
    """Something that went wrong.

    Attributes:
        kind: What it is: a collision, somebody who is blocked, hard braking.
        start: When it begins, in elapsed seconds.
        stop: When it ends; of a collision, the time of its last record.
        actors: Who is part of it, the one to follow first: the hero, else a vehicle, else a walker. What was hit but is no
            actor (a wall, a kerb) is not among them.
        type_ids: The blueprint of each of them; empty for an unknown actor.
        x, y, z: Where the first actor is at the start: m, right-handed. NaN where nothing tells.
        text: What happened, as a sentence without its full stop.
    """

    kind: Kind
    start: float
    stop: float
    actors: tuple[int, ...]
    type_ids: tuple[str, ...]
    x: float
    y: float
    z: float
    text: str


class Incidents(Answer[Incident]):
    """The incidents of a recording, in order of time."""

    row_type = Incident
    row_units: ClassVar = {"start": "s", "stop": "s", "x": "m", "y": "m", "z": "m"}


def incidents(
    source: Reader,
    *,
    collisions: bool = True,
    blocked: bool = True,
    braking: bool = True,
    min_time: float = 30.0,
    min_distance: float = 10.0,
    deceleration: float = HARD,
) -> Incidents:
    """What went wrong, sorted by start, then kind.

    A contact of two actors is one collision, however many frames record it. Slowing down that begins right after a contact
    is part of it, and no braking.

    Args:
        source: The recording. For collisions alone, only the events of an MCAP file are read, and where they took place.
        collisions: Tell of collisions.
        blocked: Tell of vehicles and walkers that stood still.
        braking: Tell of vehicles that braked hard, for at least 0.3 s.
        min_time: How long one must stand still to be blocked, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        deceleration: From which deceleration on braking is hard, in m/s².

    Raises:
        RecapError: The deceleration is not above 0.
        FormatError: The file contradicts its format.
    """
    if not deceleration > 0:
        raise RecapError(f"a deceleration of {deceleration:g} m/s² is no braking; it must be above 0")
    cast = _Cast(actors(source))
    contacts = _contacts(source) if collisions or braking else []
    found: list[Incident] = []
    if collisions:
        found += _collisions(source, contacts, cast)
    if blocked:
        found += _blocked(source, cast, min_time, min_distance)
    if braking:
        found += _braking(source, contacts, cast, deceleration)
    return Incidents(sorted(found, key=lambda incident: (incident.start, incident.kind)), source, compat=False)


class _Cast:
    """Who had an id at some time."""

    def __init__(self, all: Actors) -> None:
        self._actors: dict[int, list[Actor]] = defaultdict(list)
        self._since: dict[int, list[float]] = defaultdict(list)
        for actor in all:
            self._actors[actor.id].append(actor)
            self._since[actor.id].append(actor.spawned_at)

    def ids(self, kind: str) -> list[int]:
        """The ids that were of a kind at some time."""
        return [id for id, those in self._actors.items() if any(actor.kind == kind for actor in those)]

    def who(self, id: int, time: float) -> Actor | None:
        """The actor; None for an unknown one."""
        if id not in self._actors:
            return None
        return self._actors[id][max(bisect_right(self._since[id], time) - 1, 0)]

    def kind(self, id: int, time: float) -> str:
        """What an actor is; empty for an unknown one."""
        actor = self.who(id, time)
        return actor.kind if actor else ""

    def type_ids(self, ids: tuple[int, ...], time: float) -> tuple[str, ...]:
        """Blueprints; empty for unknown actors."""
        return tuple(actor.type_id if (actor := self.who(id, time)) else "" for id in ids)

    def is_nothing(self, id: int) -> bool:
        """Whether an id stands for what is no actor; before CARLA 0.9.13 it is 0."""
        return id == NO_ACTOR or (id == 0 and id not in self._actors)

    def name(self, id: int, time: float) -> str:
        """An actor in words."""
        if self.is_nothing(id):
            return "something that is no actor"
        actor = self.who(id, time)
        if actor is None:
            return f"actor {id}"
        return "hero" if actor.is_hero else f"{actor.type_id} ({id})"


# --- collisions ----------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Contact:
    """Two actors touch, the first with a collision sensor: from when to when, and the frame in which it begins."""

    ids: tuple[int, int]
    heroes: tuple[bool, bool]
    index: int
    start: float
    stop: float


def _contacts(source: Reader) -> list[_Contact]:
    contacts: list[_Contact] = []
    latest: dict[frozenset[int], _Contact] = {}
    for frame in source.frames(("collisions",), sparse=True):
        for _, id1, id2, hero1, hero2 in frame["collisions"].tolist():
            pair = frozenset((id1, id2))
            contact = latest.get(pair)
            if contact is not None and abs(frame.elapsed - contact.stop) < _TOGETHER:
                contact.stop = frame.elapsed
            else:
                contact = _Contact((id1, id2), (bool(hero1), bool(hero2)), frame.index, frame.elapsed, frame.elapsed)
                latest[pair] = contact
                contacts.append(contact)
    return contacts


def _collisions(source: Reader, contacts: list[_Contact], cast: _Cast) -> Iterator[Incident]:
    places = _places(source, contacts)
    for contact in contacts:
        first, second = _sides(contact, cast)
        if cast.is_nothing(first):
            continue
        ids = (first,) if cast.is_nothing(second) else (first, second)
        place = next((places[contact.index, id] for id in ids if (contact.index, id) in places), _NOWHERE)
        text = f"{cast.name(first, contact.start)} collides with {cast.name(second, contact.start)}"
        yield Incident("collision", contact.start, contact.stop, ids, cast.type_ids(ids, contact.start), *place, text)


def _sides(contact: _Contact, cast: _Cast) -> tuple[int, int]:
    """Both actors, the hero first, or a vehicle, or a walker, or the one with the sensor; what is no actor last."""

    def rank(side: int) -> int:
        id = contact.ids[side]
        actor = cast.who(id, contact.start)
        if cast.is_nothing(id):
            return 5
        if contact.heroes[side] or (actor and actor.is_hero):
            return 0
        return 1 + (*_ROAD_USERS, actor.kind).index(actor.kind) if actor else 4

    first, second = sorted((0, 1), key=rank)
    return contact.ids[first], contact.ids[second]


def _places(source: Reader, contacts: list[_Contact]) -> dict[tuple[int, int], Place]:
    """Where actors are when they touch, by frame and id."""
    wanted: dict[int, set[int]] = defaultdict(set)
    for contact in contacts:
        wanted[contact.index].update(contact.ids)
    places = {}
    for frame in _frames(source, {contact.index: contact.start for contact in contacts}):
        records = frame["transforms"]
        for row in np.flatnonzero(np.isin(records["id"], list(wanted[frame.index]))).tolist():
            id, x, y, z, *_ = records[row].tolist()
            places[frame.index, id] = _metres(x, y, z)
    return places


def _frames(source: Reader, times: dict[int, float]) -> Iterator[Frame]:
    """Some frames, with transforms; `times`: the elapsed seconds of each, by its index."""
    steady = getattr(source, "metadata", {}).get("steady_clock") == "1"
    if steady and len(times) <= _LOOK_UPS:
        for index, time in times.items():
            near = source.frames(("transforms",), start=time, stop=time + 2 * SAME_TIME)
            yield from (frame for frame in near if frame.index == index)
    elif times:
        for batch in source.batches(("transforms",)):
            rows = (row for row in range(len(batch)) if batch.index + row in times)
            yield from (batch.frame(row) for row in rows)


# --- the others ----------------------------------------------------------------------------------------------------------


def _blocked(source: Reader, cast: _Cast, min_time: float, min_distance: float) -> Iterator[Incident]:
    for row in find_blocked(source, min_time, min_distance):
        if cast.kind(row.id, row.start) in _ROAD_USERS:
            text = f"{cast.name(row.id, row.start)} stands still for {row.duration:.0f} s"
            place = _metres(row.x, row.y, row.z)
            yield Incident("blocked", row.start, row.start + row.duration, (row.id,), (row.type_id,), *place, text)


def _braking(source: Reader, contacts: list[_Contact], cast: _Cast, deceleration: float) -> Iterator[Incident]:
    touching = _touching(contacts)
    for row in hard_braking(source, cast.ids("vehicle"), deceleration):
        spans, ids = touching.get(row.id, []), (row.id,)
        later = bisect_right(spans, (row.start, math.inf))
        stop = min(row.stop, spans[later][0]) if later < len(spans) else row.stop
        in_contact = later > 0 and row.start <= spans[later - 1][1]
        if in_contact or stop - row.start < SHORTEST or cast.kind(row.id, row.start) != "vehicle":
            continue
        text = f"{cast.name(row.id, row.start)} brakes hard at {row.speed * _KMH:.0f} km/h"
        place = _metres(row.x, row.y, row.z)
        yield Incident("hard braking", row.start, stop, ids, cast.type_ids(ids, row.start), *place, text)


def _touching(contacts: list[_Contact]) -> dict[int, list[tuple[float, float]]]:
    """By actor, when contacts slow it down, in order of time; what overlaps is one."""
    touching: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for contact in sorted(contacts, key=lambda contact: contact.start):
        start, stop = contact.start - HALF_WINDOW, contact.stop + _AFTERMATH
        for id in contact.ids:
            spans = touching[id]
            if spans and start <= spans[-1][1]:
                spans[-1] = (spans[-1][0], max(stop, spans[-1][1]))
            else:
                spans.append((start, stop))
    return touching


def _metres(x: float, y: float, z: float) -> Place:
    return x * CM, 0.0 - y * CM, z * CM
