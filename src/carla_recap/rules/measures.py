"""Conditions on measures: their extreme values, or their values over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ROAD_USERS
from carla_recap.model.motion import LONGEST_STEP, runs
from carla_recap.queries.measures import MEASURES
from carla_recap.queries.measures.definitions import NO_OTHER
from carla_recap.rules.facts import WHOLE, Condition, Finding, Measured, Needs, Offence
from carla_recap.rules.values import ANY, ANY_ACTOR, tolerated

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures import MeasureValues
    from carla_recap.rules.facts import Facts, Scope
    from carla_recap.rules.values import Bounds, Quantity, Selector
    from carla_recap.util.arrays import Booleans


@dataclass(frozen=True, slots=True)
class MeasureBounds(Condition):
    """Bounds of the values of a measure."""

    measure: str
    of: Selector
    bounds: Bounds
    scope: Scope = WHOLE
    tolerate: Quantity | None = None
    lasting: Quantity | None = None
    other: Selector = ANY_ACTOR

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        wanted = (Measured(self.measure, self.of, self.other),)
        if not self._is_over_time:
            return Needs(extremes=wanted)
        places = self.scope.places
        return Needs(values=wanted, incidents=self.scope.kinds, positions=(self.of,) if places else (), places=places)

    def __str__(self) -> str:
        lasting = "" if self.lasting is None else f" for {self.lasting}"
        return f"{self._name}: {self.bounds}{lasting}{tolerated(self.tolerate)}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        if self.lasting is not None:
            return self._lasts(facts)
        found = list(self._over_time(facts) if self._is_over_time else self._extremes(facts))
        found.sort(key=lambda each: -self._badness(each[0]))
        if not found:
            return self._unmeasured(facts)
        offences = tuple(offence for _, is_valid, offence in found if not is_valid)
        if offences:
            return Finding(False, f"the {self._name} {self._limit}", offences)
        extreme = "least" if self.bounds.most is None else "greatest"
        return Finding(True, f"the {extreme} {self._name} is {self.bounds.written.shown(found[0][0])}")

    @property
    def _is_over_time(self) -> bool:
        """Whether the extreme values of whole recordings do not suffice."""
        return not self.scope.is_whole or self.tolerate is not None or self._needs_values

    @property
    def _needs_values(self) -> bool:
        """Whether other values than the critical ones count, so that without any it is unknown whether all is well."""
        beyond = self.bounds.most if MEASURES[self.measure].extreme == "least" else self.bounds.least
        return self.lasting is not None or beyond is not None

    def _extremes(self, facts: Facts) -> Iterator[tuple[float, bool, Offence]]:
        """Yield the extreme value of each actor, whether it is valid, and the offence that it would be."""
        for row in facts.measures(self.other):
            chosen = row.measure == self.measure and self.of.matches(facts.actors.at(row.actor, row.time))
            if chosen and math.isfinite(row.value):
                offence = self._offence(facts, row.actor, row.other, row.value, row.time)
                yield row.value, self.bounds.contain(row.value), offence

    def _over_time(self, facts: Facts) -> Iterator[tuple[float, bool, Offence]]:
        """Yield the worst value of each interval in which the values of an actor are valid, or not; see `_extremes`."""
        for life, found, counts in self._measured(facts):
            valid = self._valid(found, counts)
            for is_valid in (True, False):
                for first, last in self._intervals(found, counts & (valid == is_valid)):
                    part = slice(first, last + 1)
                    row = first + int(np.argmax([self._badness(value) for value in found.value[part].tolist()]))
                    other = int(found.other[row])
                    value, time = float(found.value[row]), float(found.time[row])
                    offence = self._offence(facts, life.id, None if other == NO_OTHER else other, value, time)
                    if self.tolerate is not None:
                        offence = offence._replace(text=f"{offence.text}, for {found.time[last] - found.time[first]:.2f} s")
                    yield value, is_valid, offence

    def _lasts(self, facts: Facts) -> Finding:
        """Return the finding on whether each actor has valid values for long enough without a break."""
        assert self.lasting is not None
        offences, longest = [], []
        for life, found, counts in self._measured(facts):
            spans = [
                (found.time[last] - found.time[first], first)
                for first, last in runs(counts & self._valid(found, counts), np.diff(found.time) <= LONGEST_STEP)
            ]
            seconds, first = max(spans, default=(0.0, None))
            longest.append(seconds)
            if not spans or seconds < self.lasting.value - SAME_TIME:
                when = None if first is None else float(found.time[first])
                text = f"{life.name} for {seconds:.2f} s" if spans else f"{life.name} never"
                offences.append(Offence(text, when, (life.id,)))
        what = f"the {self._name} is"
        if not longest:
            return self._unmeasured(facts)
        if offences:
            return Finding(False, f"{what} not {self.bounds} for {self.lasting}", tuple(offences))
        return Finding(True, f"{what} {self.bounds} for {min(longest):.2f} s")

    def _unmeasured(self, facts: Facts) -> Finding:
        """Return the finding if there is no value, such as a time to collision where no paths meet."""
        absent = self.scope.absent(self.of, facts) or facts.absent(self.other)
        applies = not absent and not self._needs_values and self.measure != "speed"
        return Finding(True, f"no {self._name} was measured{absent}", applies=applies)

    def _measured(self, facts: Facts) -> Iterator[tuple[ActorLife, MeasureValues, Booleans]]:
        """Yield the values over time of each actor that has any within the scope, and in which frames it has one there."""
        for life in facts.actors:
            if life.kind in ROAD_USERS and self.of.matches(life):
                found = facts.values(self.measure, life, self.other)
                counts = self.scope.has(life, found.time, facts) & ~np.isnan(found.value)
                if counts.any():
                    yield life, found, counts

    def _valid(self, found: MeasureValues, counts: Booleans) -> Booleans:
        """Return which values are within the bounds, or outside no longer than is tolerated, among those that count."""
        least, most = self.bounds.limits
        valid = (found.value >= least) & (found.value <= most)
        if self.tolerate is not None:
            for first, last in self._intervals(found, counts & ~valid):
                if found.time[last] - found.time[first] <= self.tolerate.value + SAME_TIME:
                    valid[first : last + 1] = True
        return valid

    def _intervals(self, found: MeasureValues, flags: Booleans) -> Iterator[tuple[int, int]]:
        """Yield the first and the last of intervals; those of tolerated times go on between frames that are far apart."""
        longest = LONGEST_STEP if self.tolerate is None else math.inf
        return runs(flags, np.diff(found.time) <= longest)

    def _badness(self, value: float) -> float:
        """Return by how much a value is outside the bounds; negative within them."""
        least, most = self.bounds.limits
        return max(least - value, value - most)

    @property
    def _name(self) -> str:
        to = "" if self.other.text == ANY else f" with {self.other}"
        return f"{MEASURES[self.measure].title}{self.of.behind}{to}{self.scope}"

    @property
    def _limit(self) -> str:
        least, most = self.bounds.least, self.bounds.most
        if least is not None and most is not None:
            return f"is not {self.bounds}"
        return f"exceeds {most}" if least is None else f"falls below {least}"

    def _offence(self, facts: Facts, id: int, other: int | None, value: float, time: float) -> Offence:
        name, shown = facts.actors.name(id, time), self.bounds.written.shown(value)
        if other is None:
            return Offence(f"{name}, {shown}", time, (id,))
        return Offence(f"{name} and {facts.actors.name(other, time)}, {shown}", time, (id, other))
