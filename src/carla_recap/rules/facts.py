"""What conditions need to know of a recording, when and where they are judged, and what they find."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any, Final, NamedTuple, ParamSpec, TypeVar

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO, ROAD_USERS, ActorLife, ActorLives
from carla_recap.model.presence import RoadHeights
from carla_recap.queries.blocked import blocked
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import MEASURES, MeasureSearch, MeasureValues
from carla_recap.queries.recorded_actors import actors, never_there
from carla_recap.queries.roads import roads_of
from carla_recap.rules.values import ANY, OBJECT
from carla_recap.tables.trajectories import Trajectory, trajectories
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence

    from carla_recap.model.stationary import BlockedRow
    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.measures import MeasureRow
    from carla_recap.recording import Recording
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.rules.places import Occasion, Place
    from carla_recap.rules.values import Bounds, Quantity, Selector
    from carla_recap.tables.trajectories import Trajectories
    from carla_recap.util.arrays import Booleans, Floats

P = ParamSpec("P")
T = TypeVar("T")

_APART: Final = 0.5  # m between positions
_MAX_STEP: Final = 128.0  # m from one frame to the next, in which there are positions in between: 100 m/s, 1 s apart


class Offence(NamedTuple):
    """An event that a condition forbids.

    Attributes:
        text: What happens: a sentence without its full stop.
        time: The elapsed seconds; None if it has no time.
        actors: The ids of the actors.
    """

    text: str
    time: float | None = None
    actors: tuple[int, ...] = ()


class Finding(NamedTuple):
    """What a condition has found in a recording.

    Attributes:
        passes: Whether the recording meets the condition.
        message: What was found, in one line.
        offences: The events that it forbids, the first or the worst one first.
        applies: Whether there was anything to judge, such as an actor that the condition is about.
    """

    passes: bool
    message: str
    offences: tuple[Offence, ...] = ()
    applies: bool = True


def bounded(message: str, value: float, bounds: Bounds, offences: Sequence[Offence] = (), unit: str = "") -> Finding:
    """Return the finding on a value that has bounds, whose offences count if it is outside."""
    if bounds.contain(value):
        return Finding(True, message)
    return Finding(False, f"{message} instead of {bounds}{unit}", tuple(offences))


class Positions(NamedTuple):
    """The positions of an actor in each frame and in between, at most 0.5 m apart except where it jumps."""

    time: Floats  # elapsed seconds, ascending, (n,)
    points: Floats  # x, y, z in m, right-handed, (n, 3)
    distance: Floats  # driven so far, in m; jumps do not count, (n,)


class Measured(NamedTuple):
    """A measure of some actors, in relation to some others."""

    measure: str
    of: Selector
    other: Selector


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a condition needs to know of a recording, so that the answers for all conditions are found at once."""

    incidents: frozenset[str] = frozenset()  # their kinds
    stop_time: float | None = None  # the duration in s above which stops are needed; None: none are
    extremes: tuple[Measured, ...] = ()  # of which the extreme value is needed
    values: tuple[Measured, ...] = ()  # of which the values over time are needed
    positions: tuple[Selector, ...] = ()  # the actors of which they are needed
    places: tuple[Place, ...] = ()  # that these are compared with

    @property
    def roads(self) -> bool:
        """Whether the roads of the map are needed."""
        return (
            any(KINDS[kind].needs_roads for kind in self.incidents)
            or any(MEASURES[each.measure].needs_roads for each in (*self.extremes, *self.values))
            or any(place.needs_roads for place in self.places)
        )


class Condition:
    """What a rule demands: a frozen dataclass, whose fields are those of its keys in `CONDITIONS`, with their meanings."""

    __slots__ = ()

    def needs(self) -> Needs:
        """Return what the condition needs to know of a recording, beside its actors."""
        return Needs()

    def __str__(self) -> str:
        """Return the condition in words."""
        raise NotImplementedError

    def judge(self, facts: Facts) -> Finding:
        """Return the finding on a recording."""
        raise NotImplementedError


def _once(ask: Callable[P, T]) -> Callable[P, T]:
    """Change a method of `Facts` so that it answers a question once, or raises its error again."""

    @wraps(ask)
    def answer(*about: P.args, **more: P.kwargs) -> T:
        facts: Any = about[0]
        values = (*about[1:], *more.values())
        question = (ask.__name__, *(id(each) if isinstance(each, ActorLife) else each for each in values))
        if question not in facts.answers:
            try:
                facts.answers[question] = ask(*about, **more)
            except RecapError as error:
                facts.answers[question] = error
        if isinstance(found := facts.answers[question], RecapError):
            raise found
        return found  # type: ignore[no-any-return]

    return answer


class Facts:
    """Answers about a recording for the conditions of rules; each is computed once, when it is first needed."""

    def __init__(self, recording: Recording, needs: Iterable[Needs], road_map: str | None = None) -> None:
        self.recording = recording
        self._road_map = road_map
        self._needs = list(needs)
        self.answers: dict[tuple[Hashable, ...], Any] = {}  # that are known, and the errors, by question

    @property
    @_once
    def actors(self) -> ActorLives:
        """All actors."""
        self.recording.reader.expect_events()
        return ActorLives(actors(self.recording.reader))

    @property
    @_once
    def never_there(self) -> set[tuple[int, float]]:
        """The keys of the vehicles and walkers that are at no time near the roads."""
        return never_there(self.recording.reader, self.actors)

    @property
    @_once
    def incidents(self) -> Sequence[Incident]:
        """The incidents of all kinds that conditions are about, in order of time."""
        self.recording.reader.expect_events()
        wanted = frozenset(kind for each in self._needs for kind in each.incidents)
        of_road = {kind for kind in wanted if KINDS[kind].needs_roads}
        roads = self._roads if of_road else None
        kinds = wanted if roads is not None else wanted - of_road
        return incidents(self.recording.reader, IncidentOptions(kinds=kinds, roads=roads)) if kinds else []

    @property
    @_once
    def stops(self) -> Sequence[BlockedRow]:
        """The stops that any condition forbids, the longest first; none of actors that are not there."""
        shortest = min(each.stop_time for each in self._needs if each.stop_time is not None)
        found, heights = blocked(self.recording.reader, shortest), RoadHeights(list(self.actors))
        return [row for row in found if not heights.is_away(row.id, (row.x, row.y, row.z))]

    def measures(self, other: Selector) -> Sequence[MeasureRow]:
        """Return the extreme values of the measures of all actors that conditions are about, in relation to others."""
        return self._measured(other)[0]

    def values(self, measure: str, life: ActorLife, other: Selector) -> MeasureValues:
        """Return the values over time of a measure of an actor, in relation to others."""
        return self._measured(other)[1].get((measure, *life.key), MeasureValues.joined([]))

    @_once
    def _measured(self, other: Selector) -> tuple[Sequence[MeasureRow], Mapping[tuple[str, int, float], MeasureValues]]:
        """Return the extreme values, and those over time by measure and key, of conditions with the same others."""
        movers = [actor for actor in self.actors if actor.kind in ROAD_USERS]
        over_time: dict[str, set[int]] = {}
        for measure, of, to in (each for needs in self._needs for each in needs.values):
            if to == other:
                over_time.setdefault(measure, set()).update(life.id for life in movers if of.matches(life))
        wanted = [each for needs in self._needs for each in (*needs.extremes, *needs.values) if each.other == other]
        ids = {actor.id for actor in movers if any(each.of.matches(actor) for each in wanted)}
        others = None if other.text == ANY else other.matches
        if not ids or not any(map(other.matches, movers)):
            return [], {}
        roads = self._roads if any(MEASURES[each.measure].needs_roads for each in wanted) else None
        search = MeasureSearch(self.recording.reader, ids, roads=roads, over_time=over_time, others=others)
        return search.find(), search.values

    @property
    @_once
    def _roads(self) -> RoadNetwork | None:
        """The roads of the map; None if the map is not found."""
        return roads_of(self.recording.reader, self._road_map)

    def subjects(self, of: Selector) -> list[ActorLife]:
        """Return the actors that are chosen and have positions; any: vehicles and walkers; none that are never there."""
        chosen = [life for life in self.actors if of.matches_user(life)]
        if any(life.kind in ROAD_USERS for life in chosen):
            chosen = [life for life in chosen if life.key not in self.never_there]
        return [life for life in chosen if len(self.positions(life).time)]

    @_once
    def outside(self, place: Place, life: ActorLife) -> Floats:
        """Return how far the positions of an actor are outside a place, in m, (n,)."""
        return place.outside(self.positions(life).points, self.roads_with)

    def first(self, occasion: Occasion, life: ActorLife) -> float:
        """Return the first time at which an actor is in a place, or takes part in an incident of a kind; inf if never."""
        if isinstance(occasion, str):
            found = (each.start for each in self.incidents if each.kind == occasion and life.id in each.actors)
            return next((time for time in found if life.spawned_at <= time <= life.end), math.inf)
        within = np.flatnonzero(self.outside(occasion, life) <= 0)
        return float(self.positions(life).time[within[0]]) if len(within) else math.inf

    def is_in(self, place: Place, life: ActorLife, time: Floats) -> Booleans:
        """Return whether an actor is in a place at some times; not where its position is unknown."""
        known, within = self.positions(life).time, self.outside(place, life) <= 0
        if not len(known):
            return np.zeros(len(time), np.bool_)
        before = np.searchsorted(known, time + SAME_TIME, "right") - 1
        return np.asarray(within[np.maximum(before, 0)] & (before >= 0) & (time <= known[-1] + SAME_TIME))

    @_once
    def roads_with(self, lane_types: frozenset[str] | None) -> RoadNetwork:
        """Return the roads of the map, which has to be there, with some types of lanes; None: all that are paved."""
        found = roads_of(self.recording.reader, self._road_map, needed=True, lane_types=lane_types)
        assert found is not None
        return found

    @_once
    def positions(self, life: ActorLife) -> Positions:
        """Return the positions of an actor."""
        trajectory = self._trajectories.get(life.id, Trajectory.empty(life.id)).of_life(life).ascending()
        points = np.stack((trajectory.x, trajectory.y, trajectory.z), axis=1)
        if len(points) < 2:
            return Positions(trajectory.time, points, np.zeros(len(points)))
        steps = trajectory.steps
        self._warn_of_long_steps(life, trajectory.time, steps)
        counts = np.clip(np.ceil(np.nan_to_num(steps) / _APART), 1, _MAX_STEP / _APART).astype(np.int64)
        row = np.repeat(np.arange(len(steps)), counts)
        share = (np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[row]
        values = np.column_stack((trajectory.time, points, np.append(0.0, np.cumsum(np.nan_to_num(steps)))))
        dense = np.concatenate((values[row] + share[:, None] * (values[row + 1] - values[row]), values[-1:]))
        return Positions(dense[:, 0], dense[:, 1:4], dense[:, 4])

    def _warn_of_long_steps(self, life: ActorLife, time: Floats, steps: Floats) -> None:
        """Warn if places between two frames may be missed, which are too far apart."""
        long = np.flatnonzero(steps > _MAX_STEP)
        if len(long):
            first = (
                f"{life.name} moves {number(float(steps[long[0]]))} m from {time[long[0]]:.2f} to {time[long[0] + 1]:.2f} s"
            )
            text = f"{first}; of steps of more than {_MAX_STEP:g} m, some places in between are not judged"
            warnings.warn(f"{self.recording.location}: {text}", RecapWarning, stacklevel=2)

    @property
    @_once
    def _trajectories(self) -> Trajectories:
        """The trajectories of all actors whose positions conditions are about."""
        wanted = [of for each in self._needs for of in each.positions]
        ids = {life.id for life in self.actors if any(of.matches_user(life) for of in wanted)}
        return trajectories(self.recording.reader, ids)

    def absent(self, selector: Selector) -> str:
        """Return a remark if a recording has no such actors, else an empty text."""
        if selector.text in (ANY, OBJECT) or any(selector.matches(actor) for actor in self.actors):
            return ""
        return f" ({selector} is not in the recording)" if selector.text == HERO else f" (it has no {selector.text})"


@dataclass(frozen=True)
class Scope:
    """When and where a condition is judged; each attribute that is None does not limit it."""

    during: tuple[Quantity, Quantity] | None = None  # from when until when, in elapsed seconds
    after: Occasion | None = None  # from which on
    until: Occasion | None = None  # before which
    where: Place | None = None  # in which the actor has to be

    @property
    def is_whole(self) -> bool:
        """Whether all of a recording counts."""
        return self == WHOLE

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of incidents that begin or end it."""
        return frozenset(each for each in (self.after, self.until) if isinstance(each, str))

    @property
    def places(self) -> tuple[Place, ...]:
        """The places that it depends on."""
        return tuple(each for each in (self.after, self.until, self.where) if each is not None and not isinstance(each, str))

    def span(self, life: ActorLife, facts: Facts) -> tuple[float, float]:
        """Return from when until when times of an actor are within the scope, wherever it is."""
        start, stop = (-math.inf, math.inf) if self.during is None else (each.value for each in self.during)
        after, until = (None if each is None else facts.first(each, life) for each in (self.after, self.until))
        return max(start, -math.inf if after is None else after), min(stop, math.inf if until is None else until)

    def has(self, life: ActorLife, time: Floats, facts: Facts) -> Booleans:
        """Return which times of an actor are within the scope."""
        found = np.ones(len(time), np.bool_)
        if self.during is not None:
            start, stop = self.during
            found &= (time >= start.value - SAME_TIME) & (time <= stop.value + SAME_TIME)
        if self.after is not None:
            found &= time >= facts.first(self.after, life) - SAME_TIME
        if self.until is not None:
            found &= time < facts.first(self.until, life) - SAME_TIME
        if self.where is not None and found.any():
            found[found] = facts.is_in(self.where, life, time[found])
        return found

    def has_any(self, life: ActorLife, facts: Facts) -> bool:
        """Return whether any time of an actor is within the scope."""
        if self.is_whole:
            return True
        if self.places:
            return bool(self.has(life, facts.positions(life).time, facts).any())
        first = life.spawned_at if self.during is None else max(life.spawned_at, self.during[0].value)
        if self.after is not None:
            first = max(first, facts.first(self.after, life))
        is_there = first <= min(life.end, facts.recording.reader.extent().duration)
        return is_there and bool(self.has(life, np.array([first]), facts)[0])

    def absent(self, selector: Selector, facts: Facts) -> str:
        """Return a remark if a recording has no such actors, or none of them within the scope, else an empty text."""
        if remark := facts.absent(selector):
            return remark
        is_there = self.is_whole or any(self.has_any(life, facts) for life in facts.actors if selector.matches(life))
        return "" if is_there else " (no such actor is ever there)"

    def __str__(self) -> str:
        """Return the scope in words, with a space before them."""
        words = []
        if self.during is not None:
            words.append(f"from {self.during[0]} to {self.during[1]}")
        if self.after is not None:
            words.append(f"after {_occasion(self.after)}")
        if self.until is not None:
            words.append(f"until {_occasion(self.until)}")
        if self.where is not None:
            words.append(f"in {self.where}")
        return "".join(f" {each}" for each in words)


WHOLE: Final = Scope()
"""All of a recording."""


def _occasion(occasion: Occasion) -> str:
    return f"the first {KINDS[occasion].singular}" if isinstance(occasion, str) else f"reaching {occasion}"
