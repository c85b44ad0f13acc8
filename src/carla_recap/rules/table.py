"""The table of conditions: a row for each, which the reader of rules, errors and documentation use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import NotSetUp
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import MEASURES
from carla_recap.rules.counts import ActorCount, IncidentCount, LongestStop, MapName, SameAs, Size
from carla_recap.rules.functions import FunctionCondition
from carla_recap.rules.keys import (
    ACTORS_OR_OBJECT,
    BASELINE,
    BEFORE,
    COUNT,
    FLAG,
    FOR,
    FUNCTION,
    LENGTH,
    OF,
    PLACE_KEYS,
    PLACES,
    SCOPE,
    TIME,
    TOLERATE,
    bounds,
    kind_of,
    quantity,
    texts,
)
from carla_recap.rules.measures import MeasureBounds
from carla_recap.rules.progress import DistanceDriven, Leaves, Passes, Reaches, Stays
from carla_recap.rules.reading import Key, Unexpected, keys_of
from carla_recap.rules.values import Quantity, Selector

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.queries.measures import Measure
    from carla_recap.rules.facts import Condition
    from carla_recap.rules.reading import KeyGroup, Reading


@dataclass(frozen=True)
class ConditionKind:
    """A row of the table."""

    name: str  # in a file of rules
    text: str  # when the condition is met, as in docs/ci.md
    parts: tuple[Key | KeyGroup, ...]
    make: Callable[..., Condition]  # returns the condition, from the values of the parts by field, or raises `Unexpected`
    plain: str = ""  # the key whose value can be given in place of a table; empty: a table is needed
    others: str = ""  # the field that gets all other keys; empty: there are no others

    def read(self, value: Any, reading: Reading) -> Condition | None:
        """Return the condition that a value of a file is; None, and faults, if it is wrong."""
        if isinstance(value, dict):
            values = reading.table(self.parts, value, others=self.others)
        elif self.plain:
            values = reading.table(self.parts, {self.plain: value}, plain=self.plain, others=self.others)
        else:
            reading.refuse(value, f"a table of the keys {', '.join(key.name for key in keys_of(self.parts))}")
            return None
        try:
            return None if values is None else self.make(**values)
        except Unexpected as error:
            reading.faults.append(f"{reading.prefix}: {error}")
            return None


def _measure(measure: Measure) -> ConditionKind:
    critical = "min" if measure.extreme == "least" else "max"
    names = ("min", "max") if measure.two_sided else (critical,)
    over_time = () if measure.of_events else (TOLERATE, FOR)
    return ConditionKind(
        measure.name,
        "all values of the [measure](measures.md#definitions) are within the bounds",
        (OF, bounds(quantity(measure.unit), *names), SCOPE, *over_time),
        partial(MeasureBounds, measure=measure.name),
    )


def _function(function: tuple[str, str, str], parameters: Mapping[str, Any]) -> FunctionCondition:
    condition = FunctionCondition(*function, parameters)
    try:
        condition.check()
    except NotSetUp as error:
        raise Unexpected(str(error)) from None
    except TypeError as error:
        raise Unexpected(
            f"{condition.module}:{condition.name}: {error}; the function gets the recording, then these by name"
        ) from None
    return condition


_KINDS: Final = Key(
    "kind",
    texts("kind, or list of kinds", f"one or a list of {', '.join(kind.option for kind in KINDS.values())}", kind_of),
    "the [kinds](incidents.md#what-an-incident-is), such as `near-miss`",
    field="kinds",
    required=True,
)
_WITH: Final = Key("with", ACTORS_OR_OBJECT, "the actors on the other side", field="other", default=Selector())
_AT_FAULT: Final = Key("at_fault", FLAG, "only those count that the actors of `of` have [caused](#fault)", default=False)
_LONGEST: Final = Key("max", TIME, "the greatest valid value", field="longest", required=True)
_ORDER: Final = Key("places", PLACES, "the places", required=True)
_MAPS: Final = Key(
    "name", texts("name, or list of names", "the name of a map or a list of names"), "the map", field="names", required=True
)
_BASELINE: Final = Key("baseline", BASELINE, "the recording to compare with, or the folder of it", required=True)
_TOLERANCE: Final = Key("tolerance", LENGTH, "the distance that counts as equal", default=Quantity(0.0, "m"))
_FUNCTION: Final = Key(
    "function", FUNCTION, "the function, in a file or in a module, beside the rules or an installed one", required=True
)

_TABLE: Final = (
    ConditionKind(
        "collisions",
        "the number of collisions is within the bounds; one contact of two actors is one collision",
        (OF, _WITH, _AT_FAULT, bounds(COUNT), SCOPE),
        partial(IncidentCount, kinds=("collision",)),
    ),
    ConditionKind(
        "incidents",
        "the number of incidents of the kinds is within the bounds",
        (_KINDS, OF, bounds(COUNT), SCOPE),
        partial(IncidentCount, other=Selector()),
    ),
    ConditionKind("blocked", "no vehicle or walker stands still for more than `max`", (OF, _LONGEST), LongestStop),
    ConditionKind("reaches", "each of the actors comes to the place", (OF, PLACE_KEYS, BEFORE), Reaches),
    ConditionKind("leaves", "each of the actors is in the place, and leaves it", (OF, PLACE_KEYS, BEFORE), Leaves),
    ConditionKind("stays_in", "the actors are in the place all the time", (OF, PLACE_KEYS, SCOPE, TOLERATE), Stays),
    ConditionKind(
        "stays_out_of",
        "the actors are at no time in the place",
        (OF, PLACE_KEYS, SCOPE, TOLERATE),
        partial(Stays, is_inside=False),
    ),
    ConditionKind(
        "passes",
        "each of the actors comes to the places in their order; it may come to others in between",
        (OF, _ORDER, BEFORE),
        Passes,
        plain="places",
    ),
    ConditionKind(
        "distance",
        "each of the actors drives that far; jumps do not count",
        (OF, bounds(LENGTH), SCOPE),
        DistanceDriven,
    ),
    ConditionKind("duration", "the recording is that long", (bounds(TIME),), partial(Size, unit="s")),
    ConditionKind("frames", "the recording has that many frames", (bounds(COUNT),), partial(Size, unit="frames")),
    ConditionKind("actors", "there are that many actors", (OF, bounds(COUNT)), ActorCount),
    ConditionKind(
        "map",
        "the recording is of that map, or of one of a list; `Town01_Opt` is the same map as `Town01`",
        (_MAPS,),
        MapName,
        plain="name",
    ),
    ConditionKind(
        "same_as",
        "`carla-recap diff` finds no difference beyond the tolerance; see [compare two recordings](diff.md)",
        (_BASELINE, _TOLERANCE),
        SameAs,
    ),
    ConditionKind(
        "condition",
        "[a function in Python](#conditions-in-python) finds no offence; all other keys are its parameters",
        (_FUNCTION,),
        _function,
        plain="function",
        others="parameters",
    ),
    *map(_measure, MEASURES.values()),
)
CONDITIONS: Final[Mapping[str, ConditionKind]] = {kind.name: kind for kind in _TABLE}
"""The conditions by name."""
