"""The keys of conditions and places, and the types of their values."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.conditions.reading import (
    LARGEST_COUNT,
    SHOWN,
    Key,
    KeyGroup,
    UnexpectedKeys,
    UnexpectedValue,
    ValueType,
)
from carla_recap.fleet.conditions.values import ANY, OBJECT, ROLE, UNITS, Bounds, Quantity, Selector
from carla_recap.model.actors import HERO

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.fleet.conditions.reading import Reading

_QUANTITY: Final = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
_BLUEPRINT: Final = re.compile(r"[\w*?\[\]!-]+(\.[\w*?\[\]!-]+)+")
_NOUNS: Final = {"s": "time", "m": "distance", "m/s": "speed", "m/s²": "acceleration", "m/s³": "jerk"}


def _selector(*words: str) -> ValueType:
    expected = f"{', '.join(words)}, role:NAME or a blueprint such as vehicle.tesla.*"

    def read(value: Any, _: Reading) -> Selector:
        is_pattern = isinstance(value, str) and (
            (value.startswith(ROLE) and value != ROLE) or _BLUEPRINT.fullmatch(value) is not None
        )
        if not is_pattern and value not in words:
            raise UnexpectedValue(expected)
        return Selector(value)

    return ValueType("actors", expected, read)


ACTORS: Final = _selector(HERO, "vehicle", "walker", ANY)
ACTORS_OR_OBJECT: Final = _selector(HERO, "vehicle", "walker", ANY, OBJECT)


def quantity(unit: str, least: float = -math.inf, *, is_open: bool = False) -> ValueType:
    """Return the type of quantities.

    Args:
        unit: Their unit; of those in `UNITS`, others of the same kind can be written.
        least: The least value.
        is_open: Whether values have to be above it.
    """
    units, noun = UNITS.get(unit, {}), _NOUNS.get(unit, "number")
    expected = f'a number in {unit}, or a text such as "1.5 {unit}" with one of the units {", ".join(units)},'
    too_small = f"a {noun} above {least:g}" if is_open else f"a {noun} of {least:g} or more"

    def read(value: Any, _: Reading) -> Quantity:
        found = None
        if type(value) in (int, float) and abs(value) <= 1e300:
            found = Quantity(float(value), unit)
        elif isinstance(value, str) and len(value) < SHOWN and (match := _QUANTITY.fullmatch(value)):
            size = units.get(match[2], math.nan)
            if math.isfinite(float(match[1]) * size):
                found = Quantity(float(match[1]) * size, match[2], size, f"{match[1]} {match[2]}")
        if found is None:
            raise UnexpectedValue(expected if units else "a number")
        if found.value < least or (is_open and found.value == least):
            raise UnexpectedValue(too_small)
        return found

    return ValueType(noun, expected if units else "a number", read)


TIME: Final = quantity("s", 0.0)
LENGTH: Final = quantity("m", 0.0)


def _count(value: Any, _: Reading) -> Quantity:
    if type(value) is not int or not 0 <= value <= LARGEST_COUNT:
        raise UnexpectedValue(COUNT.expected)
    return Quantity(value)


COUNT: Final = ValueType("number", "a whole number of 0 or more", _count)


def _flag(value: Any, _: Reading) -> bool:
    if not isinstance(value, bool):
        raise UnexpectedValue(FLAG.expected)
    return value


FLAG: Final = ValueType("`true` or `false`", "true or false", _flag)


def texts(name: str, expected: str, one: Callable[[str], str] = str, *, single: bool = False) -> ValueType:
    """Return the type of a text or of a list of texts.

    Args:
        name: See `ValueType`.
        expected: See `ValueType`.
        one: Changes each text, or raises a `RecapError`.
        single: Whether a list is wrong.
    """

    def read(value: Any, _: Reading) -> tuple[str, ...]:
        values = value if isinstance(value, list) and not single else [value]
        if not values or not all(isinstance(each, str) and each for each in values):
            raise UnexpectedValue(expected)
        try:
            return tuple(dict.fromkeys(map(one, values)))
        except RecapError:
            raise UnexpectedValue(expected) from None

    return ValueType(name, expected, read)


def _bounds(_: Reading, min: Quantity | None = None, max: Quantity | None = None) -> Bounds:
    if min is None and max is None:
        raise UnexpectedKeys("has no bound; min or max was expected")
    if min is not None and max is not None and min.value > max.value:
        raise UnexpectedKeys(f"{min}; no more than max was expected", "min")
    return Bounds(min, max)


def bounds(type: ValueType, *names: str) -> KeyGroup:
    """Return the keys `min` and `max` of values of a type, or one of them."""
    texts = {"min": "the least valid value", "max": "the greatest valid value"}
    return KeyGroup("bounds", tuple(Key(name, type, texts[name]) for name in names or texts), _bounds)


OF: Final = Key("of", ACTORS, "the actors that are judged", default=Selector())


def _baseline(value: Any, reading: Reading) -> str:
    if not isinstance(value, str) or not value:
        raise UnexpectedValue(BASELINE.expected)
    path = value if "://" in value else os.path.join(reading.folder, value)  # noqa: PTH118
    if "://" not in path and not Path(path).exists():
        reading.faults.append(f"{reading.prefix}: there is no {path}; {BASELINE.expected} was expected")
        raise UnexpectedValue
    return path


BASELINE: Final = ValueType("path", "the path of a recording, or of a folder of recordings,", _baseline)
