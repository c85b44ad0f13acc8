"""Incidents: collisions, actors that do not move for long, hard braking, near misses, and broken rules of the road."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.model.actors import ROAD_USERS, ActorLives
from carla_recap.model.actors import TYPES as ACTOR_TYPES
from carla_recap.model.braking import HALF_WINDOW, HARD, SHORTEST, BrakingDetector
from carla_recap.model.braking import TYPES as BRAKING_TYPES
from carla_recap.model.contacts import MOTION, UNKNOWN, Contact, Contacts, Impact
from carla_recap.model.records import CM
from carla_recap.model.stationary import TYPES as STATIONARY_TYPES
from carla_recap.model.stationary import StationaryTracker
from carla_recap.queries import Answer
from carla_recap.queries.blocked import longest_first
from carla_recap.queries.contacts import ImpactSearch, impacts, is_known
from carla_recap.queries.kinds import KINDS, kind_named
from carla_recap.queries.measures.near_misses import POST_ENCROACHMENT_TIME, TIME_TO_COLLISION, NearMissDetector
from carla_recap.queries.measures.near_misses import TYPES as MOTION_TYPES
from carla_recap.queries.measures.road import TYPES as ROAD_TYPES
from carla_recap.queries.measures.road import RoadSearch
from carla_recap.queries.measures.table import DURATION, MEASURES, RELATIVE_SPEED

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.braking import Braking
    from carla_recap.model.stationary import BlockedRow
    from carla_recap.queries.measures.near_misses import NearMiss
    from carla_recap.queries.measures.over_time import SeriesCollector
    from carla_recap.queries.measures.road import RoadEvent
    from carla_recap.roads.network import RoadNetwork

_KMH: Final = 3.6  # km/h in m/s
_AROUND: Final = 2.5  # s around hard braking that are read to compute its deceleration
_LOOK_UPS: Final = 100  # times that are read one by one; for more, all frames are read

Position = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Incident:
    """What went wrong at a time, or nearly did.

    Attributes:
        kind: What it is.
        start: The beginning, in elapsed seconds.
        stop: The end, in elapsed seconds; of a collision, the time of its last record.
        actors: The ids of the actors, the most important first: the hero, else a vehicle, else a walker. A static object
            (a wall, a kerb) is not included.
        type_ids: The blueprint of each actor; empty for an unknown actor.
        x, y, z: The position of the first actor at the start, in m, right-handed; NaN where it is unknown.
        measure: What is measured, such as `time_to_collision`.
        value: Its most critical value; NaN where it is unknown.
        unit: The unit of the value.
        threshold: The value from which on it is an incident; NaN if there is none.
        time: When the value is most critical, in elapsed seconds.
        text: A description: a sentence without its full stop.
        contact: The contact, of a collision, which knows who has caused it; no column of a table.
    """

    kind: str
    start: float
    stop: float
    actors: tuple[int, ...]
    type_ids: tuple[str, ...]
    x: float
    y: float
    z: float
    measure: str
    value: float
    unit: str
    threshold: float
    time: float
    text: str
    contact: Contact | None = field(default=None, repr=False, compare=False)


class Incidents(Answer[Incident]):
    """The incidents of a recording, in order of time."""

    row_type = Incident
    row_units: ClassVar = {"start": "s", "stop": "s", "x": "m", "y": "m", "z": "m", "time": "s"}


def incidents(
    source: Reader,
    *,
    kinds: Collection[str] | Literal["all"] | None = None,
    roads: RoadNetwork | None = None,
    min_time: float = 30.0,
    min_distance: float = 10.0,
    deceleration: float = HARD,
    start: float = -math.inf,
    stop: float = math.inf,
) -> Incidents:
    """Return the incidents of a recording, sorted by start, then kind.

    A contact of two actors is one collision, in however many frames it is recorded. A deceleration that begins right after a
    contact is part of it and no hard braking, and an encounter that ends in a collision is no near miss.

    Args:
        source: The recording. For collisions alone, only the events of an MCAP file and the frames of collisions are read.
        kinds: The kinds to include: "collision"; "blocked", vehicles and walkers that do not move for long; "hard braking",
            of vehicles, for at least 0.3 s; "near miss"; with roads "red light", "stop sign", "off road", "wrong way" and
            "speeding". None: the first three; "all": all, those of the road if there are roads.
        roads: The roads of the map, such as `carla_recap.roads.find_road_network` returns them; for the kinds of the road.
        min_time: The shortest time without a movement to include, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        deceleration: The deceleration from which on braking is hard, in m/s².
        start: The elapsed seconds from which on to look for incidents.
        stop: The elapsed seconds until which to look for them. Long stops in MCAP files may begin and end outside.

    Raises:
        RecapError: The deceleration is not above 0, there is no such kind, or a kind needs roads.
        FormatError: The file contradicts its format.
    """
    search = IncidentSearch(
        source,
        kinds=kinds,
        roads=roads,
        min_time=min_time,
        min_distance=min_distance,
        deceleration=deceleration,
        start=start,
        stop=stop,
    )
    search.read()
    return search.finish()


class IncidentSearch:
    """Finds the incidents of a recording in its batches, which are read for something else, too.

    Args and errors are those of `incidents`; besides, `near` are the actors whose near misses count, None for all, and
    `series` gets the motion that these are found in. The spawns, the ends and the collisions of all actors are read at once.
    """

    def __init__(
        self,
        source: Reader,
        *,
        kinds: Collection[str] | Literal["all"] | None = None,
        roads: RoadNetwork | None = None,
        min_time: float = 30.0,
        min_distance: float = 10.0,
        deceleration: float = HARD,
        start: float = -math.inf,
        stop: float = math.inf,
        near: Collection[int] | None = None,
        series: SeriesCollector | None = None,
    ) -> None:
        if not deceleration > 0:
            raise RecapError(f"a deceleration of {deceleration:g} m/s² is no braking; it must be above 0")
        wanted = _wanted(kinds, roads)
        collisions, braking = "collision" in wanted, "hard braking" in wanted
        self._source, self._start, self._stop = source, start, stop
        self._min_time, self._deceleration = min_time, deceleration
        self._actors, self._contacts, touching = ActorLives(), Contacts(), Contacts()
        for frame in source.frames((*ACTOR_TYPES, "collisions"), sparse=True, stop=stop):
            if not frame.elapsed < start:
                self._contacts.add(frame)
            touching.add(frame)
            for packet in frame.packets:
                self._actors.add(packet, frame.elapsed)
        self._intervals = source.stationary_intervals(min_time, min_distance) if "blocked" in wanted else []
        is_listed = self._intervals is not None
        self._tracker = None if is_listed else StationaryTracker(source.header.table, min_time, min_distance)
        is_whole = start == -math.inf and stop == math.inf
        self._braked = source.hard_braking(deceleration) if braking and is_whole else None
        is_needed = braking and self._braked is None
        self._detector = BrakingDetector(self._actors.ids("vehicle"), deceleration) if is_needed else None
        ids = None if near is None else frozenset(near)
        detector = NearMissDetector(self._actors, touching, ids, series=series) if "near miss" in wanted else None
        self._near = detector
        self._kinds = wanted
        of_road = any(KINDS[kind].needs_roads for kind in wanted)
        self._roads = RoadSearch(source, roads, self._actors) if roads is not None and of_road else None
        self._collisions = collisions
        self._impacts = ImpactSearch(contact.key for contact in self._contacts if collisions)

    def read(self) -> None:
        """Read the recording as far as it matters.

        Raises:
            FormatError: The file contradicts its format.
        """
        source = self._source
        types = {*(STATIONARY_TYPES if self._tracker else ()), *(BRAKING_TYPES if self._detector else ())}
        types |= {*(MOTION_TYPES if self._near else ()), *(ROAD_TYPES if self._roads else ())}
        if types:
            types |= {*(MOTION if self._impacts.missing else ())}
            for batch in source.batches((*types, "transforms"), start=self._start, stop=self._stop):
                self.add(batch)

    def add(self, batch: Batch) -> None:
        """Process the next frames.

        They have at least their transforms, velocities, spawns and destructions, and for roads their states of lights.
        """
        if self._roads:
            self._roads.add(batch)
        if self._tracker:
            self._tracker.batch(batch)
        if self._detector:
            self._detector.batch(batch)
        if self._near:
            self._near.batch(batch)
        self._impacts.batch(batch, is_whole=self._start == -math.inf)

    def _located(self) -> Contacts:
        """Return the contacts with their impacts; what the batches had none of is looked up."""
        found = self._impacts.found
        missing = {contact.key: contact.start for contact in self._contacts if contact.key not in found}
        found = found | impacts(self._source, missing)
        for contact in self._contacts:
            if contact.key in found:
                fixed = (self._actors.is_fixed(id, contact.start) for id in contact.ids)
                contact.impact = found[contact.key].with_fixed(*fixed)
        return self._contacts

    def finish(self) -> Incidents:
        """Return the incidents."""
        contacts, actors, start, stop = self._contacts, self._actors, self._start, self._stop
        found: list[Incident] = []
        if self._collisions:
            found += _collisions(self._located(), actors)
        stops = longest_first(self._tracker.finish() if self._tracker else self._intervals or [])
        found += _blocked(stops, actors, self._min_time)
        braked = self._detector.finish() if self._detector else self._braked
        found += _braking(braked or (), self._detector, self._source, self._deceleration, contacts, actors)
        found += _near_misses(self._near.finish() if self._near else (), actors)
        found += _of_road(self._roads.finish(), actors, self._kinds) if self._roads else ()
        found = [incident for incident in found if not (incident.start > stop or incident.stop < start)]
        return Incidents(sorted(found, key=lambda incident: (incident.start, incident.kind)), self._source, compat=False)


def _wanted(kinds: Collection[str] | Literal["all"] | None, roads: RoadNetwork | None) -> frozenset[str]:
    """Return the kinds to find.

    Raises:
        RecapError: There is no such kind, or one needs roads.
    """
    if kinds is None:
        return frozenset(name for name, kind in KINDS.items() if not kind.every_frame)
    if kinds == "all":
        return frozenset(name for name, kind in KINDS.items() if roads is not None or not kind.needs_roads)
    wanted = frozenset(kind_named(kind).name for kind in ((kinds,) if isinstance(kinds, str) else kinds))
    of_road = [name for name, kind in KINDS.items() if kind.needs_roads and name in wanted]
    if roads is None and of_road:
        raise RecapError(f"incidents of the road need its map: {', '.join(of_road)}")
    return wanted


def _of_road(events: Iterable[RoadEvent], actors: ActorLives, kinds: Collection[str]) -> Iterator[Incident]:
    for event in events:
        if event.kind in kinds and actors.kind(event.id, event.start) == "vehicle":
            ids = (event.id,)
            type_ids = actors.type_ids(ids, event.start)
            text = f"{actors.name(event.id, event.start)} {event.text}"
            yield Incident(
                event.kind,
                event.start,
                event.stop,
                ids,
                type_ids,
                *(event.x, event.y, event.z),
                measure=event.measure,
                value=event.value,
                unit=MEASURES[event.measure].unit,
                threshold=event.threshold,
                time=event.time,
                text=text,
            )


# --- collisions ----------------------------------------------------------------------------------------------------------


def _collisions(contacts: Contacts, actors: ActorLives) -> Iterator[Incident]:
    for contact in contacts:
        first, second = _ranked(contact, actors)
        if actors.is_object(first):
            continue
        ids = (first,) if actors.is_object(second) else (first, second)
        impact = contact.impact or Impact(*contact.key)
        known = dict(zip(contact.ids, impact.positions, strict=True))
        position = _metres(*next((known[id] for id in ids if is_known(known[id])), UNKNOWN))
        text = f"{actors.name(first, contact.start)} collides with {actors.name(second, contact.start)}"
        type_ids = actors.type_ids(ids, contact.start)
        yield Incident(
            "collision",
            contact.start,
            contact.stop,
            ids,
            type_ids,
            *position,
            measure=RELATIVE_SPEED.name,
            value=impact.relative_speed,
            unit=RELATIVE_SPEED.unit,
            threshold=math.nan,
            time=contact.start,
            text=text,
            contact=contact,
        )


def _ranked(contact: Contact, actors: ActorLives) -> tuple[int, int]:
    """Return both ids: the hero first, else a vehicle, a walker, the actor with the sensor; a static object last."""

    def rank(side: int) -> int:
        id = contact.ids[side]
        actor = actors.at(id, contact.start)
        if actors.is_object(id):
            return 5
        if contact.heroes[side] or (actor and actor.is_hero):
            return 0
        return 1 + (*ROAD_USERS, actor.kind).index(actor.kind) if actor else 4

    first, second = sorted((0, 1), key=rank)
    return contact.ids[first], contact.ids[second]


# --- blocked actors and hard braking -------------------------------------------------------------------------------------


def _blocked(rows: Iterable[BlockedRow], actors: ActorLives, min_time: float) -> Iterator[Incident]:
    for row in rows:
        if actors.kind(row.id, row.start) in ROAD_USERS:
            text = f"{actors.name(row.id, row.start)} stands still for {row.duration:.0f} s"
            position, stop = _metres(row.x, row.y, row.z), row.start + row.duration
            yield Incident(
                "blocked",
                row.start,
                stop,
                (row.id,),
                (row.type_id,),
                *position,
                measure=DURATION.name,
                value=row.duration,
                unit="s",
                threshold=min_time,
                time=stop,
                text=text,
            )


def _braking(
    rows: Iterable[Braking],
    detector: BrakingDetector | None,
    source: Reader,
    deceleration: float,
    contacts: Contacts,
    actors: ActorLives,
) -> Iterator[Incident]:
    found: list[tuple[Braking, float]] = []
    for row in rows:
        spans = contacts.affected(row.id, HALF_WINDOW)
        later = bisect_right(spans, (row.start, math.inf))
        stop = min(row.stop, spans[later][0]) if later < len(spans) else row.stop
        in_contact = later > 0 and row.start <= spans[later - 1][1]
        if not in_contact and stop - row.start >= SHORTEST and actors.kind(row.id, row.start) == "vehicle":
            found.append((row, stop))
    detector = detector or _detector_of(found, source, deceleration)
    for row, stop in found:
        text = f"{actors.name(row.id, row.start)} brakes hard at {row.speed * _KMH:.0f} km/h"
        value, time = detector.hardest(row.id, row.start, stop)
        yield Incident(
            "hard braking",
            row.start,
            stop,
            (row.id,),
            actors.type_ids((row.id,), row.start),
            *_metres(row.x, row.y, row.z),
            measure="deceleration",
            value=value,
            unit="m/s²",
            threshold=deceleration,
            time=time,
            text=text,
        )


def _detector_of(found: Iterable[tuple[Braking, float]], source: Reader, deceleration: float) -> BrakingDetector:
    """Return a detector that has processed the frames around known hard braking."""
    detector = BrakingDetector({row.id for row, _ in found}, deceleration)
    spans: list[tuple[float, float]] = []
    for start, stop in sorted((row.start - _AROUND, stop + _AROUND) for row, stop in found):
        if spans and start <= spans[-1][1]:
            spans[-1] = (spans[-1][0], max(stop, spans[-1][1]))
        else:
            spans.append((start, stop))
    for start, stop in spans if len(spans) <= _LOOK_UPS else [(-math.inf, math.inf)]:
        for batch in source.batches(BRAKING_TYPES, start=start, stop=stop):
            detector.batch(batch)
    detector.finish()
    return detector


def _near_misses(rows: Iterable[NearMiss], actors: ActorLives) -> Iterator[Incident]:
    for row in rows:
        first, second = (actors.name(id, row.start) for id in (row.id1, row.id2))
        at = f"at {row.time:.2f} s, at {row.speed * _KMH:.0f} km/h"
        if row.time_to_collision == 0:
            text = f"{first} touches {second} {at}, though no collision is recorded"
        elif row.time_to_collision < math.inf:
            text = f"{first} comes within {row.time_to_collision:.1f} s of {second} {at}"
        else:
            text = f"{first} crosses the path of {second} {row.post_encroachment_time:.1f} s after it {at}"
        ids, other = (row.id1, row.id2), actors.at(row.id2, row.start)
        if (other is not None and other.is_hero) or actors.kind(row.id1, row.start) == "walker":
            ids = ids[::-1]
        by_collision = row.time_to_collision < math.inf
        yield Incident(
            "near miss",
            row.start,
            row.stop,
            ids,
            actors.type_ids(ids, row.start),
            *(row.x, row.y, row.z),
            measure="time_to_collision" if by_collision else "post_encroachment_time",
            value=row.time_to_collision if by_collision else row.post_encroachment_time,
            unit="s",
            threshold=TIME_TO_COLLISION if by_collision else POST_ENCROACHMENT_TIME,
            time=row.time,
            text=text,
        )


def _metres(x: float, y: float, z: float) -> Position:
    return x * CM, 0.0 - y * CM, z * CM
