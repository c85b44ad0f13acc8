"""Scopes: when and where a condition is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.kinds import KINDS

if TYPE_CHECKING:
    from carla_recap.model.lives import ActorLife
    from carla_recap.rules.facts import Facts
    from carla_recap.rules.places import Occasion, Place
    from carla_recap.rules.values import Quantity, Selector
    from carla_recap.util.arrays import Booleans, Floats


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
