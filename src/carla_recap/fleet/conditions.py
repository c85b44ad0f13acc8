"""Conditions: what a rule demands of a recording, and how a recording is found to meet it or not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeVar

from carla_recap.errors import RecapError
from carla_recap.formats import SUFFIXES
from carla_recap.model.actors import HERO, ROAD_USERS, ActorLives
from carla_recap.model.presence import RoadHeights
from carla_recap.queries.actors import actors, never_there
from carla_recap.queries.blocked import blocked
from carla_recap.queries.differences import differences, metres, name_of
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import MEASURES, measures
from carla_recap.queries.roads import roads_of
from carla_recap.recording import open_recording
from carla_recap.roads.find import plain_name
from carla_recap.util.text import number, readable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from carla_recap.model.actors import ActorLife
    from carla_recap.model.stationary import BlockedRow
    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.measures import MeasureRow
    from carla_recap.recording import Recording
    from carla_recap.roads.network import RoadNetwork

T = TypeVar("T")

ANY: Final = "any"
OBJECT: Final = "object"
"""The other side of a collision with a static object, such as a building."""
ROLE: Final = "role:"

_LARGE: Final = 1e6  # from which on a value is shown with an exponent
_MANY: Final = {HERO: "the hero", "vehicle": "vehicles", "walker": "walkers", OBJECT: "static objects"}


class Offence(NamedTuple):
    """An event that a condition forbids.

    Attributes:
        text: What happens: a sentence without its full stop.
        time: When, in elapsed seconds; None if it has no time.
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
    """

    passes: bool
    message: str
    offences: tuple[Offence, ...] = ()


@dataclass(frozen=True, slots=True)
class Selector:
    """Some of the actors of a recording.

    Attributes:
        text: `hero`, `vehicle`, `walker`, `any`, `object`, `role:NAME`, or a blueprint such as `vehicle.tesla.*`.
    """

    text: str = ANY

    def matches(self, actor: ActorLife | None) -> bool:
        """Return whether an actor is one of them; None stands for an actor whose spawn is not recorded."""
        if self.text == ANY or actor is None:
            return self.text == ANY
        if self.text == HERO:
            return actor.is_hero
        if self.text.startswith(ROLE):
            return actor.role_name == self.text.removeprefix(ROLE)
        return fnmatchcase(actor.type_id, self.text) if "." in self.text else actor.kind == self.text

    def __str__(self) -> str:
        if self.text.startswith(ROLE):
            return f"the actor of the role {self.text.removeprefix(ROLE)}"
        return _MANY.get(self.text, self.text)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of a rule, and how it is written there.

    Attributes:
        value: The quantity, in the unit of what it bounds.
        unit: The unit in which it is written, such as `g`; empty for a number of things.
        size: That unit in the unit of the value, such as 9.80665.
        text: The quantity as a text, such as `0.8 g`; empty: a number.
    """

    value: float
    unit: str = ""
    size: float = 1.0
    text: str = ""

    def __str__(self) -> str:
        return self.text or f"{self.value:.5g} {self.unit}".rstrip()

    def shown(self, value: float) -> str:
        """Return another value in the unit in which this one is written, with at least the digits of its own unit."""
        scaled = value / self.size
        digits = 2 if self.size <= 1 else 3
        return f"{scaled:.{digits}f} {self.unit}" if abs(scaled) < _LARGE else f"{number(scaled)} {self.unit}"


@dataclass(frozen=True, slots=True)
class Bounds:
    """The least and the greatest valid number; None where there is none.

    Attributes:
        least: The least valid number.
        most: The greatest one.
    """

    least: Quantity | None = None
    most: Quantity | None = None

    @property
    def written(self) -> Quantity:
        """The bound whose unit values are shown in: one that is written with its unit, if any is."""
        given = [each for each in (self.most, self.least) if each is not None]
        return next((each for each in given if each.text), given[0])

    def contain(self, value: float) -> bool:
        """Return whether a number is valid; NaN is not."""
        least, most = self.least, self.most
        return (least is None or value >= least.value) and (most is None or value <= most.value)

    def __str__(self) -> str:
        least, most = self.least, self.most
        if least is None or most is None:
            return f"at most {most}" if least is None else f"at least {least}"
        if least.value == most.value:
            return f"exactly {least}"
        if not self.written.text:
            least = replace(least, unit="")  # the unit follows once
        return f"at least {least} and at most {most}"


class Facts:
    """What the conditions of some rules ask of a recording; each question is asked once, and only if a rule needs it.

    Args:
        recording: The recording.
        conditions: All conditions that will be judged.
        road_map: The map, or the folder of maps; None: the usual folders.
    """

    def __init__(self, recording: Recording, conditions: Iterable[Condition], road_map: str | None = None) -> None:
        self.recording = recording
        self._road_map = road_map
        conditions = list(conditions)
        self._kinds = frozenset(kind for each in conditions if isinstance(each, IncidentCount) for kind in each.kinds)
        self._stop_times = [each.longest.value for each in conditions if isinstance(each, LongestStop)]
        self._measured = [each.of for each in conditions if isinstance(each, MeasureBounds)]
        self._road_measures = [
            each.measure for each in conditions if isinstance(each, MeasureBounds) and MEASURES[each.measure].needs_roads
        ]
        self._answers: dict[str, Any] = {}

    @property
    def actors(self) -> ActorLives:
        """All actors."""
        return self._once("actors", lambda: ActorLives(actors(self.recording.reader)))

    @property
    def never_there(self) -> set[int]:
        """The ids of the vehicles and walkers that are at no time near the roads."""
        return self._once("never there", lambda: never_there(self.recording.reader, list(self.actors)))

    @property
    def incidents(self) -> Sequence[Incident]:
        """The incidents of all kinds that conditions are about, in order of time."""

        def ask() -> Sequence[Incident]:
            of_road = {kind for kind in self._kinds if KINDS[kind].needs_roads}
            roads = self._roads if of_road else None
            kinds = self._kinds if roads is not None else self._kinds - of_road
            return incidents(self.recording.reader, IncidentOptions(kinds=kinds, roads=roads)) if kinds else []

        return self._once("incidents", ask)

    @property
    def stops(self) -> Sequence[BlockedRow]:
        """The stops that any condition forbids, the longest first; none of actors that are not there."""

        def ask() -> Sequence[BlockedRow]:
            found, heights = blocked(self.recording.reader, min(self._stop_times)), RoadHeights(list(self.actors))
            return [row for row in found if not heights.is_away(row.id, (row.x, row.y, row.z))]

        return self._once("stops", ask)

    @property
    def measures(self) -> Sequence[MeasureRow]:
        """The extreme values of the measures of all actors that conditions are about."""

        def ask() -> Sequence[MeasureRow]:
            movers = [actor for actor in self.actors if actor.kind in ROAD_USERS]
            ids = {actor.id for actor in movers if any(of.matches(actor) for of in self._measured)}
            roads = self._roads if self._road_measures else None
            return measures(self.recording.reader, ids, roads=roads) if ids else []

        return self._once("measures", ask)

    @property
    def _roads(self) -> RoadNetwork | None:
        """The roads of the map; None if the map is not found."""
        return self._once("roads", lambda: roads_of(self.recording.reader, self._road_map))

    def check_roads(self) -> None:
        """Check that the map is found.

        Raises:
            RecapError: It is not, or is damaged.
        """
        if self._roads is None:
            roads_of(self.recording.reader, self._road_map, needed=True)

    def absent(self, selector: Selector) -> str:
        """Return a remark if a recording has no such actors, else an empty text."""
        if selector.text in (ANY, OBJECT) or any(selector.matches(actor) for actor in self.actors):
            return ""
        return f" ({selector} is not in the recording)" if selector.text == HERO else f" (it has no {selector.text})"

    def _once(self, question: str, ask: Callable[[], T]) -> T:
        """Return the answer to a question, or raise its error again."""
        if question not in self._answers:
            try:
                self._answers[question] = ask()
            except RecapError as error:
                self._answers[question] = error
        answer: T | RecapError = self._answers[question]
        if isinstance(answer, RecapError):
            raise answer
        return answer


class Condition(Protocol):
    """What a rule demands."""

    def text(self) -> str:
        """Return the condition in words."""
        ...

    def judge(self, facts: Facts) -> Finding:
        """Return what a recording has of it.

        Raises:
            RecapError: The recording is damaged.
        """
        ...


@dataclass(frozen=True, slots=True)
class IncidentCount:
    """The number of incidents of some kinds.

    Attributes:
        kinds: The kinds, such as `collision`.
        of: The actors of which one takes part.
        other: The actors of which another one takes part, in a collision.
        bounds: The valid numbers.
        at_fault: Whether only collisions count that the first actors have caused; see `Contact.is_caused_by`.
    """

    kinds: tuple[str, ...]
    of: Selector
    other: Selector
    bounds: Bounds
    at_fault: bool = False

    def text(self) -> str:
        """See `Condition.text`."""
        kinds = _listed(KINDS[kind].plural for kind in self.kinds)
        return f"{kinds}{self._sides()}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        if any(KINDS[kind].needs_roads for kind in self.kinds):
            facts.check_roads()
        found = [incident for incident in facts.incidents if incident.kind in self.kinds and self._counts(incident, facts)]
        nouns = (KINDS[kind].singular if len(found) == 1 else KINDS[kind].plural for kind in self.kinds)
        message = f"{len(found) or 'no'} {_listed(nouns)}"
        message += self._sides()
        if self.bounds.contain(len(found)):
            return Finding(True, message + ("" if found else facts.absent(self.of)))
        offences = tuple(Offence(each.text, each.start, each.actors) for each in found)
        return Finding(False, f"{message} instead of {self.bounds}", offences)

    def _sides(self) -> str:
        of = f" caused by {self.of}" if self.at_fault and self.of.text != ANY else _of(self.of)
        return of if self.other.text == ANY else f"{of} with {self.other}"

    def _counts(self, incident: Incident, facts: Facts) -> bool:
        involved = [facts.actors.at(id, incident.start) for id in incident.actors]
        chosen = [
            self.of.matches(actor) and not (self.at_fault and incident.contact and not incident.contact.is_caused_by(id))
            for id, actor in zip(incident.actors, involved, strict=True)
        ]
        if self.other.text == OBJECT:
            return len(involved) == 1 and chosen[0]
        if self.other.text == ANY:
            return any(chosen)
        others = reversed(involved)
        return len(involved) == 2 and any(one and self.other.matches(two) for one, two in zip(chosen, others, strict=True))


@dataclass(frozen=True, slots=True)
class LongestStop:
    """How long vehicles and walkers stand still.

    Attributes:
        of: The actors; any: vehicles and walkers.
        longest: The longest valid time, in s.
    """

    of: Selector
    longest: Quantity

    def text(self) -> str:
        """See `Condition.text`."""
        return f"standing still{_of(self.of)}: at most {self.longest}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        stops = [row for row in facts.stops if row.duration > self.longest.value]
        found = [row for row in stops if self._counts(facts.actors.at(row.id, row.start))]
        if not found:
            return Finding(True, f"no stop{_of(self.of)} of more than {self.longest}{facts.absent(self.of)}")
        offences = []
        for row in found:
            duration = f"{row.duration:.1f} s" if self.longest.unit == "s" else self.longest.shown(row.duration)
            text = f"{facts.actors.name(row.id, row.start)} stands still for {duration}"
            offences.append(Offence(text, row.start, (row.id,)))
        count = "1 stop" if len(found) == 1 else f"{len(found)} stops"
        return Finding(False, f"{count}{_of(self.of)} of more than {self.longest}", tuple(offences))

    def _counts(self, actor: ActorLife | None) -> bool:
        if self.of.text == ANY:
            return actor is not None and actor.kind in ROAD_USERS
        return self.of.matches(actor)


@dataclass(frozen=True, slots=True)
class MeasureBounds:
    """The least or the greatest value of a measure, whichever is critical.

    Attributes:
        measure: The measure, such as `time_to_collision`.
        of: The actors; any: vehicles and walkers.
        bounds: The valid values, in the measure's unit.
    """

    measure: str
    of: Selector
    bounds: Bounds

    def text(self) -> str:
        """See `Condition.text`."""
        return f"{self._name()}{_of(self.of)}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        if MEASURES[self.measure].needs_roads:
            facts.check_roads()
        found = [
            row
            for row in facts.measures
            if row.measure == self.measure
            and self.of.matches(facts.actors.at(row.actor, row.time))
            and math.isfinite(row.value)
        ]
        measure = MEASURES[self.measure]
        found.sort(key=lambda row: measure.key(row.value))
        if not found:
            return Finding(True, f"no {self._name()}{_of(self.of)} was measured{facts.absent(self.of)}")
        offences = tuple(self._offence(row, facts) for row in found if not self.bounds.contain(row.value))
        message = f"the {measure.extreme} {self._name()}{_of(self.of)} is {self.bounds.written.shown(found[0].value)}"
        if not offences:
            return Finding(True, message)
        least, most = self.bounds.least, self.bounds.most
        limit = f"exceeds {most}" if least is None else f"falls below {least}"
        return Finding(False, f"the {self._name()}{_of(self.of)} {limit}", offences)

    def _name(self) -> str:
        return MEASURES[self.measure].title

    def _offence(self, row: MeasureRow, facts: Facts) -> Offence:
        name, value = facts.actors.name(row.actor, row.time), self.bounds.written.shown(row.value)
        if row.other is None:
            return Offence(f"{name}, {value}", row.time, (row.actor,))
        other = facts.actors.name(row.other, row.time)
        return Offence(f"{name} and {other}, {value}", row.time, (row.actor, row.other))


@dataclass(frozen=True, slots=True)
class SameAs:
    """That a recording shows the same as a baseline.

    Attributes:
        baseline: The baseline, or the folder of baselines, in which that of a recording has the same name.
        tolerance: The distance that counts as equal, in m.
    """

    baseline: str
    tolerance: Quantity

    def text(self) -> str:
        """See `Condition.text`."""
        return f"the same as {self.baseline}, within {self.tolerance}"

    def exists(self) -> bool:
        """Return whether the baseline, or the folder, is there; what a URL names may be."""
        return "://" in self.baseline or Path(self.baseline).exists()

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        reader = facts.recording.reader
        path = self._path(str(getattr(reader, "location", reader.path)))
        with open_recording(path) as baseline:
            found = differences(baseline.reader, reader, tolerance=self.tolerance.value)
        if found.equal:
            return Finding(True, f"equal to {path} within {self.tolerance}")
        offences = [Offence(reason) for reason in found.reasons]
        if found.first is not None:
            text = f"{name_of(found.first)} is {metres(found.first.first_distance)} apart"
            offences.insert(0, Offence(text, found.first.first, (found.first.id_b,)))
        return Finding(False, f"differs from {path}", tuple(offences))

    def _path(self, recording: str) -> str:
        """Return the path of the baseline of a recording.

        Raises:
            RecapError: The folder has none.
        """
        name = Path(recording.partition("?")[0])
        if "://" in self.baseline and self.baseline.endswith("/"):
            return self.baseline + name.name
        if not Path(self.baseline).is_dir():
            return self.baseline
        stem = name.stem
        for suffix in SUFFIXES:
            path = Path(self.baseline, stem + suffix)
            if path.exists():
                return str(path)
        raise RecapError(f"{self.baseline}: has no baseline {stem}{' or '.join(SUFFIXES)}")


@dataclass(frozen=True, slots=True)
class Size:
    """The length of the recording.

    Attributes:
        unit: `s`: the duration counts, or `frames`: their number.
        bounds: The valid numbers.
    """

    unit: str
    bounds: Bounds

    def text(self) -> str:
        """See `Condition.text`."""
        return f"length of the recording: {self.bounds}{self._unit}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        extent = facts.recording.reader.extent()
        value = extent.duration if self.unit == "s" else extent.frames
        written = self.bounds.written
        length = written.shown(value) if written.text else f"{number(value) if self.unit == 's' else value} {self.unit}"
        message = f"the recording has {length}"
        if self.bounds.contain(value):
            return Finding(True, message)
        return Finding(False, f"{message} instead of {self.bounds}{self._unit}")

    @property
    def _unit(self) -> str:
        """What is counted, behind bounds that have no unit."""
        return "" if self.unit == "s" else f" {self.unit}"


@dataclass(frozen=True, slots=True)
class ActorCount:
    """The number of actors.

    Attributes:
        of: The actors.
        bounds: The valid numbers.
    """

    of: Selector
    bounds: Bounds

    def text(self) -> str:
        """See `Condition.text`."""
        return f"number of actors, {self.of}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        found = [actor for actor in facts.actors if self.of.matches(actor)]
        if any(actor.kind in ROAD_USERS for actor in found):
            found = [actor for actor in found if actor.id not in facts.never_there]
        message = f"{len(found)} {'actor' if len(found) == 1 else 'actors'} ({self.of})"
        if self.bounds.contain(len(found)):
            return Finding(True, message)
        most = len(found) if self.bounds.most is None else int(self.bounds.most.value)
        surplus = sorted(found, key=lambda actor: actor.spawned_at)[most:]
        offences = tuple(Offence(f"{each.name} appears", each.spawned_at, (each.id,)) for each in surplus)
        return Finding(False, f"{message} instead of {self.bounds}", offences)


@dataclass(frozen=True, slots=True)
class MapName:
    """The map of the recording.

    Attributes:
        names: The valid names, without folders; the layered variant of a map (`_Opt`) is the same map.
    """

    names: tuple[str, ...]

    def text(self) -> str:
        """See `Condition.text`."""
        return f"map: {' or '.join(self.names)}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        name = readable(facts.recording.header.map_name)
        message = f"the map is {plain_name(name) or 'not recorded'}"
        if map_key(name) in map(map_key, self.names):
            return Finding(True, message)
        return Finding(False, f"{message} instead of {' or '.join(self.names)}")


def map_key(name: str) -> str:
    """Return a map's name as it is compared."""
    return plain_name(name).lower().removesuffix("_opt")


def _of(selector: Selector) -> str:
    return "" if selector.text == ANY else f" of {selector}"


def _listed(words: Iterable[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last
