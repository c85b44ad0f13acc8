"""The table of conditions: a row for each, and their keys, which the reader of rules, errors and documentation use."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import NotSetUp, RecapError
from carla_recap.model.lives import HERO
from carla_recap.queries.kinds import KINDS, kind_named
from carla_recap.queries.measures import MEASURES
from carla_recap.rules.counts import ActorCount, IncidentCount, LongestStop, MapName, SameAs, Size
from carla_recap.rules.facts import Scope
from carla_recap.rules.functions import FunctionCondition
from carla_recap.rules.measures import MeasureBounds
from carla_recap.rules.places import LANE_TYPES, Circle, Lanes, Polygon
from carla_recap.rules.progress import DistanceDriven, Leaves, Passes, PlaceDemand, Reaches, Stays
from carla_recap.rules.reading import LARGEST_COUNT, SHOWN, Key, KeyGroup, Unexpected, ValueType, keys_of
from carla_recap.rules.values import ANY, ANY_ACTOR, OBJECT, ROLE, UNITS, Bounds, Quantity, Selector
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.queries.measures import Measure
    from carla_recap.rules.facts import Condition
    from carla_recap.rules.places import Place
    from carla_recap.rules.reading import Reading

_LONGEST_PATH: Final = 4096  # characters
_QUANTITY: Final = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
_BLUEPRINT: Final = re.compile(r"[\w*?\[\]!-]+(\.[\w*?\[\]!-]+)+")
_NOUNS: Final = {"s": "time", "m": "distance", "m/s": "speed", "m/s²": "acceleration", "m/s³": "jerk"}


def _selector(*words: str) -> ValueType:
    expected = f"{', '.join(words)}, role:NAME or a blueprint such as vehicle.tesla.*"

    def read(value: Any, _: Reading) -> Selector | None:
        is_pattern = isinstance(value, str) and (
            (value.startswith(ROLE) and value != ROLE) or _BLUEPRINT.fullmatch(value) is not None
        )
        return Selector(value) if is_pattern or value in words else None

    return ValueType("actors", expected, read)


ACTORS: Final = _selector(HERO, "vehicle", "walker", ANY)
ACTORS_OR_OBJECT: Final = _selector(HERO, "vehicle", "walker", ANY, OBJECT)


def quantity(unit: str, least: float = -math.inf, *, is_open: bool = False) -> ValueType:
    """Return the type of quantities from a least value on, or above it if it `is_open`.

    They are in a unit; of those in `UNITS`, others of the same kind can be written.
    """
    units, noun = UNITS.get(unit, {}), _NOUNS.get(unit, "number")
    expected = f'a number in {unit}, or a text such as "1.5 {unit}" with one of the units {", ".join(units)}'
    too_small = f"a {noun} above {least:g}" if is_open else f"a {noun} of {least:g} or more"

    def read(value: Any, _: Reading) -> Quantity | None:
        found = None
        if type(value) in (int, float) and abs(value) <= 1e300:
            found = Quantity(float(value), unit)
        elif isinstance(value, str) and len(value) < SHOWN and (match := _QUANTITY.fullmatch(value)):
            size = units.get(match[2], math.nan)
            if math.isfinite(float(match[1]) * size):
                found = Quantity(float(match[1]) * size, match[2], size, f"{match[1]} {match[2]}")
        if found is not None and (found.value < least or (is_open and found.value == least)):
            raise Unexpected(too_small)
        return found

    return ValueType(noun, expected if units else "a number", read)


TIME: Final = quantity("s", 0.0)
LENGTH: Final = quantity("m", 0.0)


COUNT: Final = ValueType(
    "number",
    "a whole number of 0 or more",
    lambda value, _: Quantity(value) if type(value) is int and 0 <= value <= LARGEST_COUNT else None,
)
FLAG: Final = ValueType("`true` or `false`", "true or false", lambda value, _: value if isinstance(value, bool) else None)


def texts(
    name: str, expected: str, one: Callable[[str], str | None] = lambda each: each, *, or_int: bool = False
) -> ValueType:
    """Return the type of a text or of a list of texts, each of which a function changes; it returns None for a wrong one."""

    def read(value: Any, _: Reading) -> tuple[str, ...] | None:
        values = [
            str(each) if or_int and type(each) is int else each for each in (value if isinstance(value, list) else [value])
        ]
        found = [one(each) if isinstance(each, str) and each else None for each in values]
        return None if None in found or not found else tuple(dict.fromkeys(filter(None, found)))

    return ValueType(name, expected, read)


def kind_of(text: str) -> str | None:
    """Return the name of a kind of incidents; None if there is no such kind."""
    try:
        return kind_named(text).name
    except RecapError:
        return None


def _bounds(_: Reading, min: Quantity | None = None, max: Quantity | None = None) -> Bounds:
    if min is None and max is None:
        raise Unexpected("expected min or max, found no bound")
    if min is not None and max is not None and min.value > max.value:
        raise Unexpected(f"expected no more than max, found {min}", "min")
    return Bounds(min, max)


def bounds(type: ValueType, *names: str) -> KeyGroup:
    """Return the keys `min` and `max` of values of a type, or one of them."""
    meanings = {"min": "the least valid value", "max": "the greatest valid value"}
    return KeyGroup("bounds", tuple(Key(name, type, meanings[name]) for name in names or meanings), _bounds)


def _function(value: Any, reading: Reading) -> tuple[str, str, str] | None:
    module, _, name = value.rpartition(":") if isinstance(value, str) else ("", "", "")
    is_path = module.endswith(".py") and module.isprintable() and len(module) <= _LONGEST_PATH
    if name.isidentifier() and (is_path or all(part.isidentifier() for part in module.split("."))):
        return module, name, str(Path(reading.folder or ".").absolute())
    return None


FUNCTION: Final = ValueType(
    "`FILE.py:function` or `module:function`", 'a function as "FILE.py:function" or "module:function"', _function
)
OF: Final = Key("of", ACTORS, "the actors that are judged", default=ANY_ACTOR)


def _baseline(value: Any, reading: Reading) -> str | None:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_PATH:
        return None
    path = value if "://" in value else os.path.join(reading.folder, value)  # noqa: PTH118
    if "://" not in path and not os.path.exists(path):  # noqa: PTH110
        reading.faults.append(f"{reading.prefix}: expected {BASELINE.expected}, found no {visible(path)}")
        raise Unexpected
    return path


BASELINE: Final = ValueType("path", "the path of a recording, or of a folder of recordings", _baseline)


# --- places --------------------------------------------------------------------------------------------------------------

_MOST_CORNERS: Final = 1000
_FARTHEST: Final = 1e7  # m


def _corners(value: Any, reading: Reading) -> tuple[tuple[float, float], ...] | None:
    points = value if isinstance(value, list) else []
    if not 3 <= len(points) <= _MOST_CORNERS or not all(map(_is_point, points)):
        return None
    return tuple((float(x), reading.sign * y) for x, y in (points[:-1] if points[0] == points[-1] else points))


def _is_point(value: Any) -> bool:
    is_pair = isinstance(value, list) and len(value) == 2
    return is_pair and all(type(x) in (int, float) and abs(x) <= _FARTHEST for x in value)


COORDINATE: Final = quantity("m")
CORNERS: Final = ValueType("list of points", f"a list of 3 to {_MOST_CORNERS} points [x, y] in m", _corners)
ID: Final = texts("id, or list of ids", "an id in the map, or a list of ids", or_int=True)


def _named_place(value: Any, reading: Reading) -> Place:
    if not isinstance(value, str) or value not in reading.places:
        known = f"one of {', '.join(reading.places)}" if reading.places else "the name of a table [places.NAME]"
        raise Unexpected(known)
    if (place := reading.places[value]) is None:
        raise Unexpected
    return place


def _place(
    reading: Reading,
    named: Place | None,
    polygon: tuple[tuple[float, float], ...] | None,
    lanes: tuple[str, ...],
    road: tuple[str, ...],
    junction: tuple[str, ...],
    **circle: Quantity | None,
) -> Place:
    given = {name: value for name, value in circle.items() if value is not None}
    is_lanes = bool(lanes or road or junction)
    if (named is not None) + bool(given) + (polygon is not None) + is_lanes != 1:
        ways = "place, or x, y and within, or polygon, or lanes, road and junction"
        found = "several places" if given or is_lanes or named or polygon else "no place"
        raise Unexpected(f"expected {ways}, found {found}")
    if named is not None:
        return named
    if polygon is not None:
        area = Polygon(polygon)
        if (sides := area.crossing()) is not None:
            text = f"expected a polygon that does not cross itself, found sides {sides[0]} and {sides[1]} that cross"
            raise Unexpected(text, "polygon")
        if not area.area > 0:
            raise Unexpected("expected a polygon around an area, found none", "polygon")
        return area
    if is_lanes:
        return Lanes(lanes, road, junction)
    for name in ("x", "y", "within"):
        if name not in given:
            raise Unexpected("is missing; x, y and within make a place", name)
    within = given.pop("within")
    x, y, *z = (each.value for each in given.values())
    written = ", ".join(f"{each.value:.6g}" for each in given.values())
    return Circle(x, reading.sign * y, z[0] if z else None, within, f"({written})")


PLACE_KEYS: Final = KeyGroup(
    "place",
    (
        Key("place", ValueType("name", "", _named_place), "the name of a place, a table `[places.NAME]`", field="named"),
        Key("x", COORDINATE, "a point"),
        Key("y", COORDINATE, "a point"),
        Key("z", COORDINATE, "the height of the point; without it, heights do not count"),
        Key("within", quantity("m", 0.0, is_open=True), "the distance from the point within which the place is"),
        Key("polygon", CORNERS, "the corners as `[x, y]`; the sides must not cross"),
        Key(
            "lanes",
            texts(
                "lane type, or list",
                f"one or a list of {', '.join(LANE_TYPES)}",
                lambda each: each.lower() if each.lower() in LANE_TYPES else None,
            ),
            "the lanes of a type of OpenDRIVE, such as `sidewalk`; `driving` stands for all lanes for cars",
            default=(),
        ),
        Key("road", ID, "the lanes of a road of the map; all that are paved unless `lanes` says which", default=()),
        Key("junction", ID, 'those in a junction of the map; `"any"`: in all junctions', default=()),
    ),
    _place,
    title="a [place](#places)",
)


def place_of(value: Any, reading: Reading) -> Place:
    """Return the place that a name or a table is."""
    if not isinstance(value, dict):
        return _named_place(value, reading)
    if (found := reading.table((PLACE_KEYS,), value)) is None:
        raise Unexpected
    place: Place = found["place"]
    return place


PLACE: Final = ValueType("place", "the name of a place, or a table of its keys", place_of)


def _order(value: Any, reading: Reading) -> tuple[Place, ...] | None:
    if not isinstance(value, list) or not value:
        return None
    found = [reading.value(PLACE, each, f"{number}") for number, each in enumerate(value, 1)]
    if None in found:
        raise Unexpected
    return tuple(found)


PLACES: Final = ValueType("list of places", "a list of places", _order)


# --- scopes --------------------------------------------------------------------------------------------------------------


def _interval(value: Any, reading: Reading) -> tuple[Quantity, Quantity] | None:
    if not isinstance(value, list) or len(value) != 2:
        return None
    times = [TIME.read(each, reading) for each in value]
    if None in times:
        raise Unexpected(TIME.expected)
    start, stop = times
    return (start, stop) if start.value <= stop.value else None


INTERVAL: Final = ValueType("list of two times", 'two times in their order, such as ["10 s", "20 s"]', _interval)


def _occasion(value: Any, reading: Reading) -> str | Place:
    if not isinstance(value, str) or value in reading.places:
        return place_of(value, reading)
    if (kind := kind_of(value)) is None:
        names = ", ".join((*reading.places, *(kind.option for kind in KINDS.values())))
        raise Unexpected(f"one of {names}, or a table of the keys of a place")
    return kind


OCCASION: Final = ValueType("occasion", "a kind of incidents, or a place", _occasion)

SCOPE: Final = KeyGroup(
    "scope",
    (
        Key("during", INTERVAL, "from when until when, in seconds of the recording"),
        Key(
            "after",
            OCCASION,
            "the occasion from which on: a kind of incidents or a place, of which the actor's first counts",
        ),
        Key("until", OCCASION, "the occasion before which"),
        Key("where", PLACE, "the place in which the actor has to be"),
    ),
    lambda _, **values: Scope(**values),
    title="a [scope](#scopes)",
)
BEFORE: Final = Key("before", TIME, "the latest time, in seconds of the recording")
TOLERATE: Final = Key("tolerate", TIME, "how long the condition may be broken at a time")
FOR: Final = Key(
    "for",
    TIME,
    "how long values have to be within the bounds, once and without a break; without it, all the time",
    field="lasting",
)


# --- conditions --------------------------------------------------------------------------------------------------------


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
        plain = "" if isinstance(value, dict) else self.plain
        if not plain and not isinstance(value, dict):
            reading.refuse(value, f"a table of the keys {', '.join(key.name for key in keys_of(self.parts))}")
            return None
        values = reading.table(self.parts, {plain: value} if plain else value, plain=plain, others=self.others)
        try:
            return None if values is None else self.make(**values)
        except Unexpected as error:
            reading.faults.append(f"{reading.prefix}: {error}")
            return None


def _measure(measure: Measure) -> ConditionKind:
    critical = "min" if measure.extreme == "least" else "max"
    names = ("min", "max") if measure.two_sided else (critical,)
    over_time = () if measure.of_events else (TOLERATE, FOR)
    others = (_WITH,) if measure.other or measure.name == "post_encroachment_time" else ()
    return ConditionKind(
        measure.name,
        "all values of the [measure](measures.md#definitions) are within the bounds",
        (OF, *others, bounds(quantity(measure.unit), *names), SCOPE, *over_time),
        partial(MeasureBounds, measure=measure.name),
    )


def _at(demand: type[PlaceDemand]) -> Callable[..., PlaceDemand]:
    return lambda place, **others: demand(places=(place,), **others)


def _in_python(function: tuple[str, str, str], parameters: Mapping[str, Any]) -> FunctionCondition:
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
_WITH: Final = Key("with", ACTORS, "the actors on the other side", field="other", default=ANY_ACTOR)
_WITH_OBJECT: Final = replace(_WITH, type=ACTORS_OR_OBJECT)
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
        (OF, _WITH_OBJECT, _AT_FAULT, bounds(COUNT), SCOPE),
        partial(IncidentCount, kinds=("collision",)),
    ),
    ConditionKind(
        "incidents",
        "the number of incidents of the kinds is within the bounds",
        (_KINDS, OF, bounds(COUNT), SCOPE),
        partial(IncidentCount, other=ANY_ACTOR),
    ),
    ConditionKind("blocked", "no vehicle or walker stands still for more than `max`", (OF, _LONGEST), LongestStop),
    ConditionKind("reaches", "each of the actors comes to the place", (OF, PLACE_KEYS, BEFORE), _at(Reaches)),
    ConditionKind("leaves", "each of the actors is in the place, and leaves it", (OF, PLACE_KEYS, BEFORE), _at(Leaves)),
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
        "distance", "each of the actors drives that far; jumps do not count", (OF, bounds(LENGTH), SCOPE), DistanceDriven
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
        _in_python,
        plain="function",
        others="parameters",
    ),
    *map(_measure, MEASURES.values()),
)
CONDITIONS: Final[Mapping[str, ConditionKind]] = {kind.name: kind for kind in _TABLE}
"""The conditions by name."""
