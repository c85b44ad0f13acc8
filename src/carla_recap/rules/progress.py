"""Conditions on where actors drive, how far, and in which order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO
from carla_recap.model.motion import runs
from carla_recap.rules.facts import WHOLE, Condition, Finding, Needs, Offence
from carla_recap.rules.values import ANY, ROLE, tolerated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.model.lives import ActorLife
    from carla_recap.rules.facts import Facts, Scope
    from carla_recap.rules.places import Place
    from carla_recap.rules.values import Bounds, Quantity, Selector


@dataclass(frozen=True, slots=True)
class PlaceDemand(Condition):
    """A demand that each of some actors does something at places; the base of `Reaches`, `Leaves` and `Passes`."""

    of: Selector
    places: tuple[Place, ...]
    before: Quantity | None = None

    verbs: ClassVar[tuple[str, str]]
    """The verb for several actors, and for one."""

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        return Needs(positions=(self.of,), places=self.places)

    def __str__(self) -> str:
        return f"{_subject(self.of, *self.verbs)} {self._what}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        subjects, offences, times = facts.subjects(self.of), [], []
        latest = math.inf if self.before is None else self.before.value + SAME_TIME
        for life in subjects:
            time = self._time(facts, life)
            if time < math.inf and time <= latest:
                times.append(time)
            elif time < math.inf:
                offences.append(Offence(f"{life.name} {self.verbs[1]} {self._last} at {time:.2f} s", time, (life.id,)))
            else:
                offences.append(self._never(facts, life))
        return _each(self.of, subjects, offences, self.verbs, self._what, facts, times)

    @property
    def _what(self) -> str:
        limit = "" if self.before is None else f" before {self.before}"
        return f"{', then '.join(map(str, self.places))}{limit}"

    @property
    def _last(self) -> str:
        """The last place in the text of an offence."""
        return "it"

    def _time(self, facts: Facts, life: ActorLife) -> float:
        """Return the elapsed seconds at which an actor meets the demand; inf if it never does."""
        raise NotImplementedError

    def _never(self, facts: Facts, life: ActorLife) -> Offence:
        """Return the offence of an actor that never meets the demand."""
        raise NotImplementedError


class Reaches(PlaceDemand):
    """A demand that actors come to a place."""

    __slots__ = ()
    verbs = ("reach", "reaches")

    def _time(self, facts: Facts, life: ActorLife) -> float:
        return facts.first(self.places[0], life)

    def _never(self, facts: Facts, life: ActorLife) -> Offence:
        outside = facts.outside(self.places[0], life)
        nearest = int(outside.argmin())
        away, when = float(outside[nearest]), float(facts.positions(life).time[nearest])
        if away == math.inf:
            return Offence(f"{life.name} is never near it", None, (life.id,))
        return Offence(f"{life.name} is {away:.2f} m away at {when:.2f} s, when it is nearest", when, (life.id,))


class Leaves(PlaceDemand):
    """A demand that actors are in a place, and leave it."""

    __slots__ = ()
    verbs = ("leave", "leaves")

    def _time(self, facts: Facts, life: ActorLife) -> float:
        time, outside = facts.positions(life).time, facts.outside(self.places[0], life)
        after = np.flatnonzero((time > facts.first(self.places[0], life)) & (outside > 0))
        return float(time[after[0]]) if len(after) else math.inf

    def _never(self, facts: Facts, life: ActorLife) -> Offence:
        if facts.first(self.places[0], life) == math.inf:
            return Offence(f"{life.name} is never in it", None, (life.id,))
        return Offence(f"{life.name} is in it to the end", float(facts.positions(life).time[-1]), (life.id,))


class Passes(PlaceDemand):
    """A demand that actors come to places in their order."""

    __slots__ = ()
    verbs = ("pass", "passes")

    @property
    def _last(self) -> str:
        return str(self.places[-1])

    def _reached(self, facts: Facts, life: ActorLife) -> list[float]:
        """Return when an actor comes to the places, one after another, up to the first one that it does not come to."""
        time, found = facts.positions(life).time, list[float]()
        for place in self.places:
            later = np.flatnonzero((facts.outside(place, life) <= 0) & (time >= (found[-1] if found else -math.inf)))
            if not len(later):
                break
            found.append(float(time[later[0]]))
        return found

    def _time(self, facts: Facts, life: ActorLife) -> float:
        found = self._reached(facts, life)
        return found[-1] if len(found) == len(self.places) else math.inf

    def _never(self, facts: Facts, life: ActorLife) -> Offence:
        found = self._reached(facts, life)
        place = self.places[len(found)]
        if not found:
            return Offence(f"{life.name} does not pass {place}", None, (life.id,))
        early = ", but before" if facts.first(place, life) < math.inf else ""
        return Offence(
            f"{life.name} does not pass {place} after {self.places[len(found) - 1]}{early}", found[-1], (life.id,)
        )


@dataclass(frozen=True, slots=True)
class Stays(Condition):
    """A demand that actors stay in a place, or out of it."""

    of: Selector
    place: Place
    is_inside: bool = True
    tolerate: Quantity | None = None
    scope: Scope = WHOLE

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        places = (self.place, *self.scope.places)
        return Needs(positions=(self.of,), places=places, incidents=self.scope.kinds)

    def __str__(self) -> str:
        return f"{_subject(self.of, 'stay', 'stays')} {self._within} {self.place}{self.scope}{tolerated(self.tolerate)}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        subjects, offences = [], []
        for life in facts.subjects(self.of):
            time, outside = facts.positions(life).time, facts.outside(self.place, life)
            counts = self.scope.has(life, time, facts)
            if counts.any():
                subjects.append(life)
            for first, last in runs(counts & ((outside > 0) == self.is_inside), np.ones(len(time) - 1, np.bool_)):
                seconds = float(time[last] - time[first])
                if self.tolerate is not None and seconds <= self.tolerate.value + SAME_TIME:
                    continue
                far = float(outside[first : last + 1].max())
                by = f", by up to {far:.2f} m" if self.is_inside and math.isfinite(far) else ""
                text = f"{life.name} is {'outside' if self.is_inside else 'in it'} for {seconds:.2f} s{by}"
                offences.append(Offence(text, float(time[first]), (life.id,)))
        offences.sort(key=lambda offence: offence.time or 0.0)
        verbs = f"stay {self._within}", f"stays {self._within}"
        return _each(self.of, subjects, offences, verbs, f"{self.place}{self.scope}", facts, is_demand=False)

    @property
    def _within(self) -> str:
        return "in" if self.is_inside else "out of"


@dataclass(frozen=True, slots=True)
class DistanceDriven(Condition):
    """Bounds of the distance that actors drive."""

    of: Selector
    bounds: Bounds
    scope: Scope = WHOLE

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        return Needs(positions=(self.of,), places=self.scope.places, incidents=self.scope.kinds)

    def __str__(self) -> str:
        return f"distance{self.of.behind}{self.scope}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
        subjects, offences, shown = facts.subjects(self.of), [], self.bounds.written.shown
        driven, applies = [], False
        for life in subjects:
            time, distance = facts.positions(life).time, facts.positions(life).distance
            counts, (start, stop) = self.scope.has(life, time, facts), self.scope.span(life, facts)
            applies |= bool(counts.any())
            within = np.interp(np.clip(time, start, max(start, stop)), time, distance)
            steps = np.diff(within, prepend=within[:1])
            if self.scope.where is not None:
                inside = facts.is_in(self.scope.where, life, time)
                steps[1:] *= inside[1:] & inside[:-1]
            total = float(steps.sum())
            driven.append(total)
            if not self.bounds.contain(total):
                beyond = np.flatnonzero(np.cumsum(steps) > self.bounds.limits[1])
                when = time[beyond[0]] if len(beyond) else time[counts][-1] if counts.any() else time[-1]
                offences.append(Offence(f"{life.name}, {shown(total)}", float(when), (life.id,)))
        name = f"distance{self.of.behind}{self.scope}"
        if not subjects:
            message = f"no {name} was measured{facts.absent(self.of)}"
            return Finding(self.bounds.least is None, message, applies=False)
        if offences:
            return Finding(False, f"the {name} is not {self.bounds}", tuple(offences))
        message = f"the {'least ' if len(driven) > 1 else ''}{name} is {shown(min(driven))}"
        return Finding(True, message, applies=applies)


def _each(
    of: Selector,
    subjects: Sequence[ActorLife],
    offences: Sequence[Offence],
    verbs: tuple[str, str],
    what: str,
    facts: Facts,
    times: Sequence[float] = (),
    *,
    is_demand: bool = True,
) -> Finding:
    """Return the finding of a condition that each actor has to meet, those of a demand also if there are none.

    `times` are those at which actors meet it; `verbs`, for several actors and for one, have the object `what`.
    """
    plural, singular = verbs
    if not subjects:
        return Finding(not is_demand, f"no actor to {plural} {what}{facts.absent(of)}", applies=False)
    if len(subjects) == 1:
        who = str(of) if of.text == HERO or of.text.startswith(ROLE) else subjects[0].name
        done, failed = f"{who} {singular}", f"{who} does not {plural}"
    else:
        several = "vehicles and walkers" if of.text == ANY else "heroes" if of.text == HERO else str(of)
        done = f"{len(subjects)} {several} {plural}"
        count = len({offence.actors for offence in offences})
        failed = f"{count} of {len(subjects)} {several} {'does' if count == 1 else 'do'} not {plural}"
    if offences:
        return Finding(False, f"{failed} {what}", tuple(offences))
    last = f"{', the last' if len(times) > 1 else ''} at {max(times):.2f} s" if times else ""
    return Finding(True, f"{done} {what}{last}")


def _subject(of: Selector, plural: str, singular: str) -> str:
    """Return some actors in words, and a verb."""
    if of.text == ANY:
        return f"vehicles and walkers {plural}"
    return f"{of} {singular if of.text == HERO or of.text.startswith(ROLE) else plural}"
