"""What finds incidents in the frames of a recording: a detector for one kind of incident, or for several."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Final, Literal, TypedDict

from carla_recap.errors import RecapError
from carla_recap.model.braking import HALF_WINDOW, HARD, Braking, BrakingDetector
from carla_recap.model.contacts import UNKNOWN, Contact, Impact
from carla_recap.model.lives import ROAD_USERS, ranked
from carla_recap.model.motion import MAX_DECELERATION, MOTION, place_in_metres
from carla_recap.model.presence import RoadHeights
from carla_recap.model.stationary import MIN_DISTANCE, MIN_TIME, StationaryTracker, check_limits
from carla_recap.model.stationary import TYPES as STATIONARY_TYPES
from carla_recap.queries.blocked import blocked, listed_intervals, longest_first
from carla_recap.queries.contacts import LOOK_UPS, ImpactSearch, impacts, is_known, joined, read_spans
from carla_recap.queries.measures.definitions import DURATION, MEASURES, RELATIVE_SPEED
from carla_recap.queries.measures.near_misses import (
    LONGEST,
    POST_ENCROACHMENT_TIME,
    REQUIRED_DECELERATION,
    TIME_TO_COLLISION,
    NearMissDetector,
)
from carla_recap.queries.measures.road import BEFORE, RoadSearch
from carla_recap.queries.measures.road import TYPES as ROAD_TYPES

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.contacts import Contacts
    from carla_recap.model.lives import ActorLives, ActorName
    from carla_recap.model.stationary import BlockedRow
    from carla_recap.queries.measures.definitions import Measure
    from carla_recap.queries.measures.series import SeriesCollector
    from carla_recap.roads.network import RoadNetwork


_KMH: Final = 3.6  # km/h in m/s
_AROUND: Final = 2.5  # s around hard braking that are read to compute its deceleration


@dataclass(frozen=True, slots=True)
class Incident:
    """What went wrong at a time, or nearly did.

    Attributes:
        kind: What it is, as in the table of kinds: "collision", "near miss" and so on.
        start: The beginning, in elapsed seconds.
        stop: The end, in elapsed seconds; of a collision, the time of its last record.
        actors: The ids of the actors, the most important first: the hero, else a vehicle, else a walker. A static object
            (a wall, a kerb) is not included.
        type_ids: The blueprint of each actor; empty for an unknown actor.
        x, y, z: The position of the first actor at the start, in m, right-handed; NaN where it is unknown. Of a near miss,
            where it happens: the position at `time` of the actor that approaches, or arrives second where paths cross.
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


@dataclass(frozen=True, kw_only=True)
class IncidentOptions:
    """Which incidents to find, and what counts as one.

    Attributes:
        kinds: The kinds, such as `["near miss"]`, with spaces or hyphens; None: those that the events of a recording
            contain (collisions, hard braking and long stops); "all": all.
        roads: The roads of the map, for kinds that need them; None: those of the map of the recording.
        road_map: The OpenDRIVE file of this map, or the folder to look in; None: the usual folders.
        min_time: The shortest time without a movement that is a long stop, in s.
        min_distance: The distance at which an actor has moved, in cm.
        deceleration: The deceleration from which on braking is hard, in m/s²; below 34.3, of CARLA's tyres.
        time_to_collision: The greatest time to collision of a near miss, in s; 60 at most.
        post_encroachment_time: The greatest post-encroachment time of a near miss, in s; 60 at most.
        required_deceleration: The least deceleration that a near miss by its time to collision requires, in m/s²; 0: any.
        start: The elapsed seconds from which on to look for incidents. Collisions, long stops, and what crosses a path or a
            stop line, may begin before.
        stop: The elapsed seconds until which to look for them. Long stops may end after.
        actor: The actor that has to take part in them; None: any.

    Raises:
        RecapError: A limit of long stops is below 0 or NaN, the deceleration is not above 0 and below 34.3 m/s², a time of
            near misses is below 0 or above 60 s, or the deceleration that they require is below 0.
    """

    kinds: Collection[str] | Literal["all"] | None = None
    roads: RoadNetwork | None = None
    road_map: str | None = None
    min_time: float = MIN_TIME
    min_distance: float = MIN_DISTANCE
    deceleration: float = HARD
    time_to_collision: float = TIME_TO_COLLISION
    post_encroachment_time: float = POST_ENCROACHMENT_TIME
    required_deceleration: float = REQUIRED_DECELERATION
    start: float = -math.inf
    stop: float = math.inf
    actor: ActorName | None = None

    def __post_init__(self) -> None:
        check_limits(self.min_time, self.min_distance)
        if not 0 < self.deceleration < MAX_DECELERATION:
            limits = f"above 0 and below {MAX_DECELERATION:g} m/s², of CARLA's tyres"
            raise RecapError(f"deceleration is {self.deceleration:g} m/s²; expected one {limits}")
        for name in ("time_to_collision", "post_encroachment_time"):
            if not 0 <= (time := getattr(self, name)) <= LONGEST:
                raise RecapError(f"{name} is {time:g} s; expected 0 to {LONGEST:g} s")
        if not 0 <= self.required_deceleration < math.inf:
            raise RecapError(f"required_deceleration is {self.required_deceleration:g} m/s²; expected 0 or more")

    @property
    def is_whole(self) -> bool:
        """Whether all of the recording is looked at."""
        return self.start == -math.inf and self.stop == math.inf


class IncidentKeywords(TypedDict, total=False):
    """The fields of `IncidentOptions`, as keywords."""

    kinds: Collection[str] | Literal["all"] | None
    roads: RoadNetwork | None
    road_map: str | None
    min_time: float
    min_distance: float
    deceleration: float
    time_to_collision: float
    post_encroachment_time: float
    required_deceleration: float
    start: float
    stop: float
    actor: ActorName | None


@dataclass(frozen=True, kw_only=True)
class Search:
    """What detectors know of a recording before its frames are read."""

    source: Reader
    options: IncidentOptions
    actors: ActorLives
    contacts: Contacts
    near: Collection[int] | None = None  # the actors whose near misses count; None for all
    series: SeriesCollector | None = None  # gets the motion in which near misses are found, too

    def incident(
        self,
        kind: str,
        ids: tuple[int, ...],
        span: tuple[float, float],
        place: tuple[float, float, float],
        measure: Measure,
        extreme: tuple[float, float],
        threshold: float,
        text: str,
    ) -> Incident:
        """Return an incident of actors, of a beginning and an end, at a place; with the critical value and its time."""
        types, (value, time) = self.actors.type_ids(ids, span[0]), extreme
        return Incident(
            kind, *span, ids, types, *place, measure.name, value, measure.unit, threshold=threshold, time=time, text=text
        )


class Detector:
    """Finds the incidents of some kinds: it is made of a `Search`, gets the batches, and returns what it has found."""

    types: Collection[str] = ()
    """The record types that it needs; none if it needs no frames."""
    also: Collection[str] = ()
    """The record types that it uses, too, if frames are read."""
    every_frame: ClassVar[bool] = False
    """Whether it always reads every frame."""
    needs_roads: ClassVar[bool] = False
    """Whether it needs the roads of the map."""
    span: tuple[float, float] | None = None
    """The times from which on and before which it needs frames, in elapsed seconds; None: the part that is looked at."""

    def __init__(self, search: Search, process: Callable[[Batch], object] | None = None) -> None:
        self._search, self._process = search, process

    def add(self, batch: Batch) -> None:
        """Process the next frames."""
        if self._process is not None:
            self._process(batch)

    def finish(self) -> Iterable[Incident]:
        """Return the incidents, in any order."""
        raise NotImplementedError


class CollisionIncidents(Detector):
    """Finds collisions: the contacts of actors, with the place and the speed at which they begin."""

    def __init__(self, search: Search) -> None:
        stop = search.options.stop
        self._contacts = [each for each in search.contacts if stop == math.inf or not each.start >= stop]
        self._impacts = ImpactSearch(contact.key for contact in self._contacts)
        super().__init__(search, partial(self._impacts.batch, is_whole=search.options.start == -math.inf))
        self.also = MOTION if self._impacts.missing else ()

    def finish(self) -> Iterator[Incident]:
        """See `Detector.finish`; the impacts that the batches did not have are looked up."""
        actors, contacts, found = self._search.actors, self._contacts, self._impacts.found
        missing = {contact.key: contact.start for contact in contacts if contact.key not in found}
        found = found | impacts(self._search.source, missing)
        for contact in contacts:
            if contact.key in found:
                contact.impact = found[contact.key].with_fixed(*(actors.is_fixed(id, contact.start) for id in contact.ids))
            known = {id: life for id in contact.ids if (life := actors.at(id, contact.start))}
            first, second = ranked(contact.ids, known, contact.heroes)
            if not actors.is_object(first):
                yield self._incident(contact, first, second)

    def _incident(self, contact: Contact, first: int, second: int) -> Incident:
        actors = self._search.actors
        ids = (first,) if actors.is_object(second) else (first, second)
        impact = contact.impact or Impact(*contact.key)
        known = dict(zip(contact.ids, impact.positions, strict=True))
        place = place_in_metres(*next((known[id] for id in ids if is_known(known[id])), UNKNOWN))
        text = f"{actors.name(first, contact.start)} collides with {actors.name(second, contact.start)}"
        span, extreme = (contact.start, contact.stop), (impact.relative_speed, contact.start)
        found = self._search.incident("collision", ids, span, place, RELATIVE_SPEED, extreme, math.nan, text)
        return replace(found, contact=contact)


class LongStopIncidents(Detector):
    """Finds vehicles and walkers that do not move for long."""

    def __init__(self, search: Search) -> None:
        source, limits = search.source, (search.options.min_time, search.options.min_distance)
        self._heights = RoadHeights(list(search.actors))
        self._listed: Sequence[BlockedRow] | None = listed_intervals(source, *limits)
        if self._listed is None and not search.options.is_whole:  # of a part, stops may begin before and end behind it
            self._listed = blocked(source, *limits)
        self._tracker = StationaryTracker(source.header.table, *limits) if self._listed is None else None
        self.types = STATIONARY_TYPES if self._tracker else ()
        super().__init__(search, self._tracker.batch if self._tracker else None)

    def finish(self) -> Iterator[Incident]:
        """See `Detector.finish`."""
        rows = self._tracker.finish() if self._tracker else self._listed or ()
        yield from map(self._incident, filter(self._counts, longest_first(rows)))

    def _counts(self, row: BlockedRow) -> bool:
        """Return whether a row is of a road user that is there, by where others have been spawned."""
        is_user = self._search.actors.kind(row.id, row.start) in ROAD_USERS
        return is_user and not self._heights.is_away(row.id, (row.x, row.y, row.z))

    def _incident(self, row: BlockedRow) -> Incident:
        stop, threshold = row.start + row.duration, self._search.options.min_time
        place, extreme = place_in_metres(row.x, row.y, row.z), (row.duration, stop)
        text = f"{self._search.actors.name(row.id, row.start)} stands still for {row.duration:.0f} s"
        return self._search.incident("blocked", (row.id,), (row.start, stop), place, DURATION, extreme, threshold, text)


def listed_braking(source: Reader, deceleration: float) -> list[Braking] | None:
    """Return the hard braking from a deceleration in m/s² on, in no order; None if the file does not list it."""
    part = source.digest("braking")
    rows = part.read() if part is not None and part.limits == (deceleration,) else None
    return None if rows is None else [Braking(*row) for row in rows]


class HardBrakingIncidents(Detector):
    """Finds vehicles that brake hard: not because of a contact, and not harder than tyres can."""

    def __init__(self, search: Search) -> None:
        deceleration = search.options.deceleration
        self._listed = listed_braking(search.source, deceleration) if search.options.is_whole else None
        is_listed = self._listed is not None
        self._detector = None if is_listed else BrakingDetector(search.actors.ids("vehicle"), deceleration)
        self.types = MOTION if self._detector else ()
        super().__init__(search, self._detector.batch if self._detector else None)

    def finish(self) -> Iterator[Incident]:
        """See `Detector.finish`."""
        search, deceleration = self._search, MEASURES["deceleration"]
        found = list(self._apart_from_contacts(self._detector.finish() if self._detector else self._listed or ()))
        detector = self._detector or self._looked_up(found)
        for row in filter(None, map(detector.by_tyres, found)):
            span, place = (row.start, row.stop), place_in_metres(row.x, row.y, row.z)
            text = f"{search.actors.name(row.id, row.start)} brakes hard at {row.speed * _KMH:.0f} km/h"
            extreme, threshold = detector.hardest(row.id, *span), search.options.deceleration
            yield search.incident("hard braking", (row.id,), span, place, deceleration, extreme, threshold, text)

    def _apart_from_contacts(self, rows: Iterable[Braking]) -> Iterator[Braking]:
        """Yield the braking of vehicles that no contact causes; it ends at the latest when one begins."""
        for row in rows:
            life = self._search.actors.at(row.id, row.start)
            spans = self._search.contacts.affected(life, HALF_WINDOW) if life else []
            later = bisect_right(spans, (row.start, math.inf))
            stop = min(row.stop, spans[later][0]) if later < len(spans) else row.stop
            in_contact = later > 0 and row.start <= spans[later - 1][1]
            if not in_contact and life and life.kind == "vehicle":
                yield row._replace(stop=stop)

    def _looked_up(self, found: Iterable[Braking]) -> BrakingDetector:
        """Return a detector that has processed the frames around known hard braking."""
        detector = BrakingDetector({row.id for row in found}, self._search.options.deceleration)
        spans = joined((row.start - _AROUND, row.stop + _AROUND) for row in found)
        whole = [(-math.inf, math.inf)]
        for batches in read_spans(self._search.source, spans if len(spans) <= LOOK_UPS else whole):
            for batch in batches:
                detector.batch(batch)
        detector.finish()
        return detector


class NearMissIncidents(Detector):
    """Finds near misses."""

    types = MOTION
    every_frame = True

    def __init__(self, search: Search) -> None:
        ids = None if search.near is None else frozenset(search.near)
        self._detector = NearMissDetector(
            search.actors,
            search.contacts,
            ids,
            series=search.series,
            time_to_collision=search.options.time_to_collision,
            post_encroachment_time=search.options.post_encroachment_time,
            required_deceleration=search.options.required_deceleration,
            start=search.options.start,
            stop=search.options.stop,
        )
        super().__init__(search, self._detector.batch)
        self.span = self._detector.span

    def finish(self) -> Iterator[Incident]:
        """See `Detector.finish`."""
        options = self._search.options
        for row in self._detector.finish():
            first, second = row.one.name, row.other.name
            at = f"at {row.time:.2f} s" + ("" if math.isnan(row.speed) else f", at {row.speed * _KMH:.0f} km/h")
            if row.time_to_collision == 0:
                text = f"{first} touches {second} {at}, though no collision is recorded"
            elif row.time_to_collision < math.inf:
                text = f"{first} comes within {row.time_to_collision:.1f} s of {second} {at}"
            else:
                text = f"{first} crosses the path of {second} {row.post_encroachment_time:.1f} s after it {at}"
            pair = (row.other, row.one) if row.other.is_hero or row.one.kind == "walker" else (row.one, row.other)
            ids = pair[0].id, pair[1].id
            measure = "time_to_collision" if row.time_to_collision < math.inf else "post_encroachment_time"
            span, extreme, threshold = (row.start, row.stop), (getattr(row, measure), row.time), getattr(options, measure)
            found = self._search.incident("near miss", ids, span, row.place, MEASURES[measure], extreme, threshold, text)
            yield replace(found, type_ids=(pair[0].type_id, pair[1].type_id))


class RoadIncidents(Detector):
    """Finds vehicles that break a rule of the road."""

    types = ROAD_TYPES
    every_frame = needs_roads = True

    def __init__(self, search: Search) -> None:
        assert search.options.roads is not None
        start, stop = search.options.start, search.options.stop
        self._roads = RoadSearch(search.source, search.options.roads, search.actors, start=start)
        super().__init__(search, self._roads.add)
        self.span = start - BEFORE, stop

    def finish(self) -> Iterator[Incident]:
        """See `Detector.finish`."""
        for kind, actor, span, place, measure, extreme, threshold, text in self._roads.finish():
            text = f"{actor.name} {text}"
            yield self._search.incident(kind, (actor.id,), span, place, MEASURES[measure], extreme, threshold, text)
