"""Differences of two recordings of a scenario: actors, paths, traffic lights, events.

Nothing is aligned: places are those of the map, and times are elapsed seconds.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO, ActorLife
from carla_recap.queries.incidents import Incident, incidents
from carla_recap.queries.matching import Match, MatchedBy, match
from carla_recap.queries.paths import PathDifference, RecordedPaths, StateDifference, compare
from carla_recap.roads.find import map_key
from carla_recap.tables import Rows
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.util.arrays import Floats

TIME_TOLERANCE: Final = 1.0
"""The seconds by which times may differ, if positions may differ, too."""

_SENSOR: Final = "sensor"
_SPECTATOR: Final = "spectator"  # the camera of a viewer, which is no part of the scenario
_SAME_EVENT: Final = 1.0  # s between events of both recordings that may be the same


@dataclass(frozen=True, slots=True)
class ComparedRecording:
    """One of the two recordings.

    Attributes:
        location: The path or URL.
        map_name: The map.
        frames: The number of frames.
        duration: The elapsed time of the last frame, in s.
        step: The median time between two frames, in s; NaN if there are fewer than two.
    """

    location: str
    map_name: str
    frames: int
    duration: float
    step: float


@dataclass(frozen=True, slots=True)
class ActorDifference:
    """An actor that is in both recordings, and how far its paths are apart.

    Attributes:
        id_a, id_b: Its ids.
        kind: The kind of actor.
        type_id_a, type_id_b: Its blueprints.
        role_name: Its role_name in the first recording.
        matched_by: How it was recognized.
        differs: Whether anything is beyond the tolerances.
        frames: The frames of the first recording in which both positions are known.
        first: The first time at which the distance is beyond the tolerance, in elapsed seconds; None if it never is.
        first_distance: The distance then, in m; None if it never is.
        mean, rms: The mean and the root mean square of the distance, in m; NaN if nothing was compared.
        max: The largest distance, in m; infinite where one of the positions is no number.
        max_at: When, in elapsed seconds; NaN if nothing was compared.
        final: The distance in the last frame that was compared, in m.
        heading: The largest difference of the headings, in degrees.
        spawned_at_a, spawned_at_b: When it appears, in elapsed seconds.
        destroyed_at_a, destroyed_at_b: When it disappears; None if it stays.
    """

    id_a: int
    id_b: int
    kind: str
    type_id_a: str
    type_id_b: str
    role_name: str
    matched_by: MatchedBy
    differs: bool
    frames: int
    first: float | None
    first_distance: float | None
    mean: float
    rms: float
    max: float
    max_at: float
    final: float
    heading: float
    spawned_at_a: float
    spawned_at_b: float
    destroyed_at_a: float | None
    destroyed_at_b: float | None


@dataclass(frozen=True, slots=True)
class LightDifference:
    """A traffic light that is in both recordings, and for how long its states differ.

    Attributes:
        id_a, id_b: Its ids.
        x, y: Its position in m, right-handed.
        differs: Whether the states differ for longer than the tolerance.
        first: The first time at which they differ, in elapsed seconds; None if they never do.
        seconds: The time during which they differ, in s.
    """

    id_a: int
    id_b: int
    x: float
    y: float
    differs: bool
    first: float | None
    seconds: float


@dataclass(frozen=True, slots=True)
class EventDifference:
    """An incident that is in one recording alone, or at another time in the other one.

    Attributes:
        kind: The kind of incident.
        start_a, start_b: When it begins, in elapsed seconds; None if it is not in that recording.
        actors_a, actors_b: The ids of its actors; empty if it is not in that recording.
        text: A description, a sentence without its full stop.
    """

    kind: str
    start_a: float | None
    start_b: float | None
    actors_a: tuple[int, ...]
    actors_b: tuple[int, ...]
    text: str


class ActorDifferences(Rows[ActorDifference]):
    """The actors of both recordings: those that differ first, and of these the largest distance first."""

    row_type = ActorDifference
    row_units: ClassVar = {
        **dict.fromkeys(("first", "max_at"), "s"),
        **dict.fromkeys(("first_distance", "mean", "rms", "max", "final"), "m"),
        **dict.fromkeys(("spawned_at_a", "spawned_at_b", "destroyed_at_a", "destroyed_at_b"), "s"),
        "heading": "deg",
    }


class UnmatchedActors(Rows[ActorLife]):
    """The actors that are in one of the recordings alone, in order of appearance."""

    row_type = ActorLife
    row_units: ClassVar = {"spawned_at": "s", "destroyed_at": "s"}


class LightDifferences(Rows[LightDifference]):
    """The traffic lights of both recordings, those that differ longest first."""

    row_type = LightDifference
    row_units: ClassVar = {"x": "m", "y": "m", "first": "s", "seconds": "s"}


class EventDifferences(Rows[EventDifference]):
    """The incidents that are not in both recordings, in order of time."""

    row_type = EventDifference
    row_units: ClassVar = {"start_a": "s", "start_b": "s"}


@dataclass(frozen=True, eq=False)
class Differences:
    """The differences of two recordings, a and b.

    Attributes:
        a, b: The recordings.
        tolerance: The distance in m that counts as equal.
        time_tolerance: The time in s that counts as equal.
        actors: The actors that are in both.
        missing: The actors that are in a alone.
        extra: The actors that are in b alone.
        lights: The traffic lights that are in both.
        events: The incidents that are not in both.
        clock: The first time at which the times of the frames differ, or one recording ends; None if they are equal.
    """

    a: ComparedRecording
    b: ComparedRecording
    tolerance: float
    time_tolerance: float
    actors: ActorDifferences
    missing: UnmatchedActors
    extra: UnmatchedActors
    lights: LightDifferences
    events: EventDifferences
    clock: float | None

    @property
    def equal(self) -> bool:
        """Whether nothing is beyond the tolerances."""
        return not self.reasons

    @property
    def first(self) -> ActorDifference | None:
        """The hero if its path is beyond the tolerance, else the first vehicle, else the first actor; None if there is none.

        Of several at the same time, it is the farthest.
        """
        rows = (row for row in self.actors if row.first is not None)
        return min(rows, key=lambda row: (_rank(row), row.first, -(row.first_distance or 0)), default=None)

    @property
    def reasons(self) -> list[str]:
        """What differs, in sentences without their full stops, the most important first; empty if nothing does."""
        return list(_reasons(self))

    @property
    def summary(self) -> str:
        """The answer in one line."""
        reasons = self.reasons
        return "; ".join(reasons) if reasons else f"equal within {self.tolerance:g} m"


def differences(
    a: Reader, b: Reader, *, tolerance: float = 0.0, time_tolerance: float | None = None, events: bool = True
) -> Differences:
    """Return the differences of two recordings of a scenario, such as of two runs of a test; see `Recording.diff`.

    Actors are matched as in `carla_recap.queries.matching.match`; the spectator is left out, and sensors that are in
    one recording alone do not count. Positions are compared at the times of the frames of a, with b interpolated where it
    has no frame at that time. With a tolerance of 0, the times of frames, the headings and the numbers of poses have to be
    equal, too. The time tolerance is that of spawns, ends, events and states of traffic lights.
    """
    for name, value in (("tolerance", tolerance), ("time tolerance", time_tolerance)):
        if value is not None and not value >= 0:
            raise RecapError(f"a {name} of {value:g} cannot be; it must be 0 or more")
    if time_tolerance is None:
        time_tolerance = TIME_TOLERANCE if tolerance > 0 else 0.0
    return _Comparison((RecordedPaths(a), RecordedPaths(b)), tolerance, time_tolerance).answer(events=events)


class _Comparison:
    """Two recordings, and what counts as equal; see `differences`."""

    def __init__(self, sides: tuple[RecordedPaths, RecordedPaths], tolerance: float, time_tolerance: float) -> None:
        self._sides = a, b = sides
        self._tolerance, self._time_tolerance = tolerance, time_tolerance
        self._about = _about(a), _about(b)
        self._clock = _clock(a.elapsed, b.elapsed)
        candidates = [[n for n, life in enumerate(side.lives) if life.type_id != _SPECTATOR] for side in sides]
        matches = match(*([side.lives[n] for n in some] for side, some in zip(sides, candidates, strict=True)))
        self._matches = [Match(candidates[0][a], candidates[1][b], by) for a, b, by in matches]
        self._paths, self._states = compare(a, b, {match.a: match.b for match in self._matches}, tolerance)
        self._matches += [Match(a.unknown[id], b.unknown[id], "id") for id in sorted(a.unknown.keys() & b.unknown.keys())]
        self._tracks = [{match[side]: track for track, match in enumerate(self._matches)} for side in (0, 1)]

    def answer(self, *, events: bool) -> Differences:
        """Return all differences."""
        lights = [self._light(match) for match in self._matches if self._sides[0].lives[match.a].kind == "traffic_light"]
        missing, extra = (
            [life for n, life in enumerate(side.lives) if n not in tracks and life.type_id != _SPECTATOR]
            for side, tracks in zip(self._sides, self._tracks, strict=True)
        )
        return Differences(
            *self._about,
            self._tolerance,
            self._time_tolerance,
            ActorDifferences(sorted(map(self._actor, self._matches), key=_by_size)),
            UnmatchedActors(missing),
            UnmatchedActors(extra),
            LightDifferences(sorted(lights, key=lambda row: (not row.differs, -row.seconds, row.id_a))),
            EventDifferences(self._events() if events else []),
            self._clock,
        )

    def _lives(self, match: Match) -> tuple[ActorLife, ActorLife]:
        return self._sides[0].lives[match.a], self._sides[1].lives[match.b]

    def _actor(self, match: Match) -> ActorDifference:
        (a, b), in_a, in_b = self._lives(match), self._sides[0].poses[match.a], self._sides[1].poses[match.b]
        path, is_exact = self._paths.get(match.a, PathDifference()), not self._tolerance
        is_apart = path.first is not None or (is_exact and path.heading > 0)
        is_everywhere = in_a == in_b == path.frames if is_exact and self._clock is None else (in_a == 0) == (in_b == 0)
        return ActorDifference(
            id_a=a.id,
            id_b=b.id,
            kind=a.kind,
            type_id_a=a.type_id,
            type_id_b=b.type_id,
            role_name=a.role_name,
            matched_by=match.by,
            differs=is_apart or not is_everywhere or a.type_id != b.type_id or self._lives_differ(a, b),
            spawned_at_a=a.spawned_at,
            spawned_at_b=b.spawned_at,
            destroyed_at_a=a.destroyed_at,
            destroyed_at_b=b.destroyed_at,
            **{field.name: getattr(path, field.name) for field in fields(path)[:-3]},
        )

    def _lives_differ(self, a: ActorLife, b: ActorLife) -> bool:
        allowed = self._time_tolerance
        if _is_apart(a.spawned_at, b.spawned_at, allowed):
            return True
        if a.destroyed_at is None and b.destroyed_at is None:
            return False
        end_a, end_b = (
            about.duration if life.destroyed_at is None else life.destroyed_at
            for about, life in zip(self._about, (a, b), strict=True)
        )
        only_one = (a.destroyed_at is None) != (b.destroyed_at is None)
        return _is_apart(end_a, end_b, allowed) or (only_one and not allowed)

    def _light(self, match: Match) -> LightDifference:
        a, b = self._lives(match)
        found = self._states.get(match.a, StateDifference())
        differs = found.first is not None and (found.seconds > self._time_tolerance or not self._time_tolerance)
        return LightDifference(a.id, b.id, *a.place[:2], differs, found.first, found.seconds)

    def _events(self) -> list[EventDifference]:
        """Return the incidents that are in one recording alone, or in both at different times, in order of time."""
        window = max(_SAME_EVENT, self._time_tolerance)
        rows: list[EventDifference] = []
        subjects: dict[Hashable, tuple[list[Incident], list[Incident]]] = defaultdict(lambda: ([], []))
        for side in (0, 1):
            for incident in incidents(self._sides[side].source):
                subjects[self._subject(side, incident)][side].append(incident)
        for pair in subjects.values():
            starts = [np.array([incident.start for incident in each]) for each in pair]
            with np.errstate(invalid="ignore"):
                apart = np.nan_to_num(np.abs(starts[0][:, None] - starts[1]), nan=0.0, posinf=np.inf)
            places = np.argwhere(apart <= window)
            left = [set(range(len(each))) for each in pair]
            for a, b in places[np.argsort(apart[tuple(places.T)], kind="stable")].tolist():  # the nearest first
                if a in left[0] and b in left[1]:
                    left[0].remove(a)
                    left[1].remove(b)
                    if _is_apart(pair[0][a].start, pair[1][b].start, self._time_tolerance):
                        rows.append(_event(pair[0][a], pair[1][b]))
            rows += [_event(pair[0][a], None) for a in left[0]] + [_event(None, pair[1][b]) for b in left[1]]
        return sorted(rows, key=lambda row: (_start(row), row.kind))

    def _subject(self, side: int, incident: Incident) -> Hashable:
        """Return what is equal of incidents of both recordings: the kind and the actors."""
        found: list[tuple[int, int]] = []
        for id in incident.actors:
            number = self._sides[side].number(id, incident.start)
            if number is None:
                found.append((-1, id))
            elif (track := self._tracks[side].get(number)) is not None:
                found.append((2, track))
            else:
                is_spectator = self._sides[side].lives[number].type_id == _SPECTATOR
                found.append((3, 0) if is_spectator else (side, number))
        return incident.kind, tuple(sorted(found))


def _about(side: RecordedPaths) -> ComparedRecording:
    with np.errstate(invalid="ignore"):
        steps = np.diff(side.elapsed)
    steps = steps[np.isfinite(steps)]
    extent, map_name = side.source.extent(), readable(side.source.header.map_name)
    step = float(np.median(steps)) if len(steps) else math.nan
    return ComparedRecording(side.source.location, map_name, extent.frames, extent.duration, step)


def _clock(a: Floats, b: Floats) -> float | None:
    """Return the first time at which only one recording has a frame; None if there is none."""
    count = min(len(a), len(b))
    with np.errstate(invalid="ignore"):
        near = np.abs(a[:count] - b[:count]) <= SAME_TIME
    different = ~(near | (a[:count] == b[:count]) | (np.isnan(a[:count]) & np.isnan(b[:count])))
    if different.any():
        row = int(different.argmax())
        return float(np.fmin(a[row], b[row]))
    longer = a if len(a) > count else b
    return float(longer[count]) if len(longer) > count else None


def _is_apart(time: float, other: float, allowed: float) -> bool:
    """Return whether two times differ by more than is allowed; two that are no numbers do not."""
    if time == other or (math.isnan(time) and math.isnan(other)):
        return False
    return not abs(time - other) <= allowed + SAME_TIME


def _by_size(row: ActorDifference) -> tuple[bool, float, float, int]:
    """Return what rows are sorted by: the largest difference first."""
    return not row.differs, -row.max if row.max > 0 else 0.0, -row.heading, row.id_a


def _event(a: Incident | None, b: Incident | None) -> EventDifference:
    known = a or b
    assert known is not None
    start_a, start_b = (each.start if each else None for each in (a, b))
    actors_a, actors_b = (each.actors if each else () for each in (a, b))
    return EventDifference(known.kind, start_a, start_b, actors_a, actors_b, known.text)


def _start(row: EventDifference) -> float:
    return min(start for start in (row.start_a, row.start_b) if start is not None)


# --- the summary ---------------------------------------------------------------------------------------------------------


def _reasons(found: Differences) -> Iterator[str]:
    a, b = found.a, found.b
    if map_key(a.map_name) != map_key(b.map_name):
        yield f"the maps are {a.map_name or 'unnamed'} and {b.map_name or 'unnamed'}"
    first = found.first
    if first is not None:
        earlier = [row.first for row in found.actors if row.first is not None and row.first < (first.first or 0.0)]
        yield f"the paths differ from {first.first:.2f} s on: {name_of(first)} by {metres(first.first_distance)}"
        if earlier:
            yield f"{_count(len(earlier), 'other actor')} before, from {min(earlier):.2f} s on"
    different = [row for row in found.actors if row.differs]
    if different:
        yield f"{len(different)} of {_count(len(found.actors), 'actor')} {_differ(different)}, {_largest(different)}"
    for alone, side in ((found.missing, "A"), (found.extra, "B")):
        count = sum(actor.kind != _SENSOR for actor in alone)
        if count:
            yield f"{_count(count, 'actor')} only in {side}"
    lights = [row for row in found.lights if row.differs]
    if lights:
        since = min(row.first for row in lights if row.first is not None)
        yield f"{len(lights)} of {_count(len(found.lights), 'traffic light')} {_differ(lights)}, first at {since:.2f} s"
    if found.events:
        yield f"{_count(len(found.events), 'event')} {_differ(found.events)}, first {event_text(found.events[0])}"
    if found.clock is not None and (not found.tolerance or _is_apart(a.duration, b.duration, found.time_tolerance)):
        same = a.frames == b.frames and not _is_apart(a.duration, b.duration, 0.0)
        sizes = f"{a.frames} frames in {a.duration:.2f} s, and {b.frames} in {b.duration:.2f} s"
        yield f"the times of frames differ from {found.clock:.2f} s on" if same else sizes


def _rank(row: ActorDifference) -> int:
    """Return how much an actor matters: heroes most, then vehicles."""
    if row.role_name == HERO:
        return 0
    return 1 if row.kind == "vehicle" else 2


def _differ(rows: Sequence[object]) -> str:
    return "differs" if len(rows) == 1 else "differ"


def name_of(row: ActorDifference) -> str:
    """Return the name of an actor: its blueprint, whether it is the hero, its id or ids."""
    name = row.type_id_a or "unknown"
    if row.type_id_b != row.type_id_a:
        name += f" or {row.type_id_b or 'unknown'}"
    ids = str(row.id_a) if row.id_a == row.id_b else f"{row.id_a}, {row.id_b}"
    return f"{name} (hero, {ids})" if row.role_name == HERO else f"{name} ({ids})"


def metres(distance: float | None) -> str:
    """Return a distance with its unit, in as many digits as say something."""
    if distance is None or not math.isfinite(distance):
        return "an unknown distance"
    return f"{distance:.2f} m" if distance >= 0.1 or not distance else f"{distance:.2g} m"


def event_text(row: EventDifference) -> str:
    """Return an event that differs in words."""
    if row.start_b is None:
        return f"only in A, at {row.start_a:.2f} s: {row.text}"
    if row.start_a is None:
        return f"only in B, at {row.start_b:.2f} s: {row.text}"
    return f"at {row.start_a:.2f} s and at {row.start_b:.2f} s: {row.text}"


def _largest(rows: Sequence[ActorDifference]) -> str:
    row = max(rows, key=lambda row: row.max if row.max > 0 else 0.0)
    return f"at most by {metres(row.max)}" if row.max > 0 else "but not in position"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
