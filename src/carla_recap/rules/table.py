"""The table of conditions: a row for each, which the reader of rules, errors and documentation use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import NotSetUp
from carla_recap.queries.kinds import KINDS, kind_named
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
    quantity,
    texts,
)
from carla_recap.rules.measures import MeasureBounds
from carla_recap.rules.progress import DistanceDriven, Leaves, Passes, Reaches, Stays
from carla_recap.rules.reading import Key, UnexpectedKeys, keys_of
from carla_recap.rules.values import Quantity, Selector

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from carla_recap.queries.measures import Measure
    from carla_recap.rules.facts import Condition
    from carla_recap.rules.reading import KeyGroup, Reading


@dataclass(frozen=True, kw_only=True)
class ConditionKind:
    """A row of the table.

    Attributes:
        name: The name in a file of rules.
        text: When the condition is met, as in docs/ci.md.
        parts: The keys, and groups of keys.
        make: Returns the condition, from the values of the parts by field, or raises `UnexpectedKeys`.
        plain: The key whose value can be given in place of a table; empty: a table is needed.
        others: The field that gets all other keys; empty: there are no others.
    """

    name: str
    text: str
    parts: tuple[Key | KeyGroup, ...]
    make: Callable[..., Condition]
    plain: str = ""
    others: str = ""

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
        except UnexpectedKeys as error:
            reading.faults.append(f"{reading.prefix}: {error}")
            return None


def _measure(measure: Measure) -> ConditionKind:
    critical = "min" if measure.extreme == "least" else "max"
    names = ("min", "max") if measure.two_sided else (critical,)
    over_time = () if measure.of_events else (TOLERATE, FOR)
    return ConditionKind(
        name=measure.name,
        text="all values of the [measure](measures.md#definitions) are within the bounds",
        parts=(OF, bounds(quantity(measure.unit), *names), SCOPE, *over_time),
        make=partial(MeasureBounds, measure=measure.name),
    )


def _function(function: tuple[str, str, str], parameters: Mapping[str, Any]) -> FunctionCondition:
    condition = FunctionCondition(*function, parameters)
    try:
        condition.check()
    except NotSetUp as error:
        raise UnexpectedKeys(str(error)) from None
    except TypeError as error:
        raise UnexpectedKeys(
            f"{condition.module}:{condition.name}: {error}; the function gets the recording, then these by name"
        ) from None
    return condition


def _named(kinds: Iterable[ConditionKind]) -> Mapping[str, ConditionKind]:
    return {kind.name: kind for kind in kinds}


CONDITIONS: Final = _named(
    (
        ConditionKind(
            name="collisions",
            text="the number of collisions is within the bounds; one contact of two actors is one collision",
            parts=(
                OF,
                Key("with", ACTORS_OR_OBJECT, "the actors on the other side", field="other", default=Selector()),
                Key("at_fault", FLAG, "only those count that the actors of `of` have [caused](#fault)", default=False),
                bounds(COUNT),
                SCOPE,
            ),
            make=partial(IncidentCount, kinds=("collision",)),
        ),
        ConditionKind(
            name="incidents",
            text="the number of incidents of the kinds is within the bounds",
            parts=(
                Key(
                    "kind",
                    texts(
                        "kind, or list of kinds",
                        f"one or a list of {', '.join(kind.option for kind in KINDS.values())}",
                        lambda text: kind_named(text).name,
                    ),
                    "the [kinds](incidents.md#what-an-incident-is), such as `near-miss`",
                    field="kinds",
                    required=True,
                ),
                OF,
                bounds(COUNT),
                SCOPE,
            ),
            make=partial(IncidentCount, other=Selector()),
        ),
        ConditionKind(
            name="blocked",
            text="no vehicle or walker stands still for more than `max`",
            parts=(OF, Key("max", TIME, "the greatest valid value", field="longest", required=True)),
            make=LongestStop,
        ),
        ConditionKind(
            name="reaches",
            text="each of the actors comes to the place",
            parts=(OF, PLACE_KEYS, BEFORE),
            make=Reaches,
        ),
        ConditionKind(
            name="leaves",
            text="each of the actors is in the place, and leaves it",
            parts=(OF, PLACE_KEYS, BEFORE),
            make=Leaves,
        ),
        ConditionKind(
            name="stays_in",
            text="the actors are in the place all the time",
            parts=(OF, PLACE_KEYS, SCOPE, TOLERATE),
            make=partial(Stays, is_inside=True),
        ),
        ConditionKind(
            name="stays_out_of",
            text="the actors are at no time in the place",
            parts=(OF, PLACE_KEYS, SCOPE, TOLERATE),
            make=partial(Stays, is_inside=False),
        ),
        ConditionKind(
            name="passes",
            text="each of the actors comes to the places in their order; it may come to others in between",
            parts=(OF, Key("places", PLACES, "the places", required=True), BEFORE),
            make=Passes,
            plain="places",
        ),
        ConditionKind(
            name="distance",
            text="each of the actors drives that far; jumps do not count",
            parts=(OF, bounds(LENGTH), SCOPE),
            make=DistanceDriven,
        ),
        ConditionKind(
            name="duration",
            text="the recording is that long",
            parts=(bounds(TIME),),
            make=partial(Size, unit="s"),
        ),
        ConditionKind(
            name="frames",
            text="the recording has that many frames",
            parts=(bounds(COUNT),),
            make=partial(Size, unit="frames"),
        ),
        ConditionKind(
            name="actors",
            text="there are that many actors",
            parts=(OF, bounds(COUNT)),
            make=ActorCount,
        ),
        ConditionKind(
            name="map",
            text="the recording is of that map, or of one of a list; `Town01_Opt` is the same map as `Town01`",
            parts=(
                Key(
                    "name",
                    texts("name, or list of names", "the name of a map or a list of names"),
                    "the map",
                    field="names",
                    required=True,
                ),
            ),
            make=MapName,
            plain="name",
        ),
        ConditionKind(
            name="same_as",
            text="`carla-recap diff` finds no difference beyond the tolerance; see [compare two recordings](diff.md)",
            parts=(
                Key("baseline", BASELINE, "the recording to compare with, or the folder of it", required=True),
                Key("tolerance", LENGTH, "the distance that counts as equal", default=Quantity(0.0, "m")),
            ),
            make=SameAs,
        ),
        ConditionKind(
            name="condition",
            text="[a function in Python](#conditions-in-python) finds no offence; all other keys are its parameters",
            parts=(
                Key(
                    "function",
                    FUNCTION,
                    "the function, in a file or in a module, beside the rules or an installed one",
                    required=True,
                ),
            ),
            make=_function,
            plain="function",
            others="parameters",
        ),
        *map(_measure, MEASURES.values()),
    )
)
"""The conditions by name."""
