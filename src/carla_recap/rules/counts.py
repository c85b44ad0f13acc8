"""Conditions on what there is in a recording: incidents, stops, actors, frames, the map, the same as in a baseline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.formats import SUFFIXES
from carla_recap.formats.sources import unsigned
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ROAD_USERS
from carla_recap.queries.differences import differences, metres, name_of
from carla_recap.queries.kinds import KINDS
from carla_recap.recording import open_recording
from carla_recap.roads.find import map_key, plain_name
from carla_recap.rules.facts import WHOLE, Condition, Finding, Needs, Offence, bounded
from carla_recap.rules.values import ANY, OBJECT, listed
from carla_recap.util.text import number, readable

if TYPE_CHECKING:
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.rules.facts import Facts, Scope
    from carla_recap.rules.values import Bounds, Quantity, Selector


@dataclass(frozen=True, slots=True)
class IncidentCount(Condition):
    """Bounds of the number of incidents of some kinds."""

    kinds: tuple[str, ...]
    of: Selector
    other: Selector
    bounds: Bounds
    at_fault: bool = False
    scope: Scope = WHOLE

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        places = self.scope.places
        kinds = frozenset(self.kinds) | self.scope.kinds
        return Needs(incidents=kinds, positions=(self.of,) if places else (), places=places)

    def __str__(self) -> str:
        kinds = listed(KINDS[kind].plural for kind in self.kinds)
        return f"{kinds}{self._sides()}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        found = [incident for incident in facts.incidents if incident.kind in self.kinds and self._counts(incident, facts)]
        nouns = (KINDS[kind].singular if len(found) == 1 else KINDS[kind].plural for kind in self.kinds)
        message = f"{len(found) or 'no'} {listed(nouns)}{self._sides()}"
        if not found and self.bounds.contain(0):
            absent = self.scope.absent(self.of, facts) or facts.absent(self.other)
            return Finding(True, message + absent, applies=not absent)
        return bounded(message, len(found), self.bounds, [Offence(each.text, each.start, each.actors) for each in found])

    def _sides(self) -> str:
        of = f" caused by {self.of}" if self.at_fault and self.of.text != ANY else self.of.behind
        return f"{of if self.other.text == ANY else f'{of} with {self.other}'}{self.scope}"

    def _counts(self, incident: Incident, facts: Facts) -> bool:
        involved = [facts.actors.at(id, incident.start) for id in incident.actors]
        chosen = [
            self.of.matches(actor)
            and not (self.at_fault and incident.contact and not incident.contact.is_caused_by(id))
            and self._is_within(actor, incident.start, facts)
            for id, actor in zip(incident.actors, involved, strict=True)
        ]
        if self.other.text == OBJECT:
            return len(involved) == 1 and chosen[0]
        if self.other.text == ANY:
            return any(chosen)
        others = reversed(involved)
        return len(involved) == 2 and any(one and self.other.matches(two) for one, two in zip(chosen, others, strict=True))

    def _is_within(self, actor: ActorLife | None, time: float, facts: Facts) -> bool:
        """Return whether a time of an actor is within the scope; that of an unknown one only if there is none."""
        if actor is None or self.scope.is_whole:
            return self.scope.is_whole
        return bool(self.scope.has(actor, np.array([time]), facts)[0])


@dataclass(frozen=True, slots=True)
class LongestStop(Condition):
    """The longest time for which vehicles and walkers stand still."""

    of: Selector
    longest: Quantity

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        return Needs(stop_time=self.longest.value)

    def __str__(self) -> str:
        return f"standing still{self.of.behind}: at most {self.longest}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        stops = [row for row in facts.stops if row.duration > self.longest.value + SAME_TIME]
        found = [row for row in stops if self.of.matches_user(facts.actors.at(row.id, row.start))]
        if not found:
            absent = facts.absent(self.of)
            return Finding(True, f"no stop{self.of.behind} of more than {self.longest}{absent}", applies=not absent)
        offences = []
        for row in found:
            duration = f"{row.duration:.1f} s" if self.longest.unit == "s" else self.longest.shown(row.duration)
            text = f"{facts.actors.name(row.id, row.start)} stands still for {duration}"
            offences.append(Offence(text, row.start, (row.id,)))
        count = "1 stop" if len(found) == 1 else f"{len(found)} stops"
        return Finding(False, f"{count}{self.of.behind} of more than {self.longest}", tuple(offences))


@dataclass(frozen=True, slots=True)
class Size(Condition):
    """Bounds of the length of the recording."""

    unit: str
    bounds: Bounds

    def __str__(self) -> str:
        return f"length of the recording: {self.bounds}{self._unit}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        extent = facts.recording.reader.extent()
        value = extent.duration if self.unit == "s" else extent.frames
        written = self.bounds.written
        length = written.shown(value) if written.text else f"{number(value) if self.unit == 's' else value} {self.unit}"
        length = "an unknown length" if math.isnan(value) else length
        return bounded(f"the recording has {length}", value, self.bounds, unit=self._unit)

    @property
    def _unit(self) -> str:
        """The suffix of bounds that are written without a unit."""
        return "" if self.unit == "s" else f" {self.unit}"


@dataclass(frozen=True, slots=True)
class ActorCount(Condition):
    """Bounds of the number of actors."""

    of: Selector
    bounds: Bounds

    def __str__(self) -> str:
        return f"number of actors, {self.of}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        found = [actor for actor in facts.actors if self.of.matches(actor)]
        if any(actor.kind in ROAD_USERS for actor in found):
            found = [actor for actor in found if actor.key not in facts.never_there]
        message = f"{len(found)} {'actor' if len(found) == 1 else 'actors'} ({self.of})"
        most = len(found) if self.bounds.most is None else int(self.bounds.most.value)
        surplus = sorted(found, key=lambda actor: actor.spawned_at)[most:]
        offences = [Offence(f"{each.name} appears", each.spawned_at, (each.id,)) for each in surplus]
        return bounded(message, len(found), self.bounds, offences)


@dataclass(frozen=True, slots=True)
class MapName(Condition):
    """The map of the recording."""

    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"map: {' or '.join(self.names)}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        name = readable(facts.recording.header.map_name)
        message = f"the map is {plain_name(name) or 'not recorded'}"
        if map_key(name) in map(map_key, self.names):
            return Finding(True, message)
        return Finding(False, f"{message} instead of {' or '.join(self.names)}")


@dataclass(frozen=True, slots=True)
class SameAs(Condition):
    """A demand that a recording shows the same as a baseline."""

    baseline: str
    tolerance: Quantity

    def __str__(self) -> str:
        return f"the same as {self.baseline}, within {self.tolerance}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        reader = facts.recording.reader
        reader.expect_events()
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
        """Return the path of the baseline of a recording."""
        name = Path(unsigned(recording))
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
