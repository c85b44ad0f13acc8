"""Conditions on measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carla_recap.fleet.conditions.facts import Finding, Needs, Offence
from carla_recap.queries.measures import MEASURES

if TYPE_CHECKING:
    from carla_recap.fleet.conditions.facts import Facts
    from carla_recap.fleet.conditions.values import Bounds, Selector
    from carla_recap.queries.measures import MeasureRow


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

    def needs(self) -> Needs:
        """See `Condition.needs`."""
        return Needs(extremes=((self.measure, self.of),))

    def text(self) -> str:
        """See `Condition.text`."""
        return f"{self._name()}{self.of.behind}: {self.bounds}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`."""
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
            return Finding(True, f"no {self._name()}{self.of.behind} was measured{facts.absent(self.of)}")
        offences = tuple(self._offence(row, facts) for row in found if not self.bounds.contain(row.value))
        message = f"the {measure.extreme} {self._name()}{self.of.behind} is {self.bounds.written.shown(found[0].value)}"
        if not offences:
            return Finding(True, message)
        least, most = self.bounds.least, self.bounds.most
        limit = f"exceeds {most}" if least is None else f"falls below {least}"
        return Finding(False, f"the {self._name()}{self.of.behind} {limit}", offences)

    def _name(self) -> str:
        return MEASURES[self.measure].title

    def _offence(self, row: MeasureRow, facts: Facts) -> Offence:
        name, value = facts.actors.name(row.actor, row.time), self.bounds.written.shown(row.value)
        if row.other is None:
            return Offence(f"{name}, {value}", row.time, (row.actor,))
        other = facts.actors.name(row.other, row.time)
        return Offence(f"{name} and {other}, {value}", row.time, (row.actor, row.other))
