"""Which values attributes can have: the official client fails for good when it is told of an actor with any other.

It reads all attributes of all actors as soon as it hears of them, so that a single bad one would cost every client its list
of actors (`ActorAttributeValue` in LibCarla).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.server.table import CallError
from carla_recap.sim.actors.attributes import attribute_type

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary

_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,10}(\.0*)?")
_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?", re.IGNORECASE)
_LONGEST: Final = 64  # characters of a number: more of them tell nothing
_LARGEST_INT: Final = 2**31 - 1
_LARGEST_FLOAT: Final = 3.4028234663852886e38
_LARGEST_SHADE: Final = 255
_SHOWN: Final = 60  # characters of a value in a message
_SIDES: Final = ("image_size_x", "image_size_y")
LARGEST_SIDE: Final = 4096
"""Pixels: no image is wider or higher, which keeps a frame within 64 MiB."""


@dataclass(frozen=True, slots=True)
class _Type:
    """The type of an attribute.

    Attributes:
        is_one: Whether a text is a value of it.
        expected: What values look like.
        neutral: The value where nothing else is known.
    """

    is_one: Callable[[str], bool]
    expected: str
    neutral: str


def _is_bool(text: str) -> bool:
    return text.lower() in ("true", "false")


def _is_int(text: str) -> bool:
    return _WHOLE.fullmatch(text.strip(" ")) is not None and -_LARGEST_INT - 1 <= float(text) <= _LARGEST_INT


def _is_float(text: str) -> bool:
    is_number = len(text) <= _LONGEST and _NUMBER.fullmatch(text.strip(" ")) is not None
    return is_number and abs(float(text)) <= _LARGEST_FLOAT


def _is_colour(text: str) -> bool:
    shades = text.split(",")
    return len(shades) == 3 and all(_is_int(shade) and 0 <= float(shade) <= _LARGEST_SHADE for shade in shades)


_TYPES: Final = (  # as recordings number them
    _Type(_is_bool, "true or false", "false"),
    _Type(_is_int, "a whole number of 32 bits", "0"),
    _Type(_is_float, "a finite number of 32 bits", "0.0"),
    _Type(lambda _: True, "a text", ""),
    _Type(_is_colour, "three whole numbers from 0 to 255, as in 255,0,0", "0,0,0"),
)


def check_attributes(blueprint: Blueprint, attributes: Mapping[str, str]) -> None:
    """Make sure that clients can be told of an actor.

    Args:
        blueprint: What it is to be made from.
        attributes: What it is to have.

    Raises:
        CallError: An attribute has a value that is not of its type, or images would have no pixels, or too many.
    """
    for key, value in attributes.items():
        if value == blueprint.attributes.get(key):
            continue
        type = _TYPES[attribute_type(key)]
        if not type.is_one(value):
            raise _misfit(blueprint, key, value, type.expected)
        if key in _SIDES and not 1 <= float(value) <= LARGEST_SIDE:
            raise _misfit(blueprint, key, value, f"1 to {LARGEST_SIDE} pixels")


def told_attributes(blueprint: Blueprint, attributes: Mapping[str, str], library: BlueprintLibrary) -> dict[str, str]:
    """What clients are told that an actor has: of attributes with values that they could not read, the defaults.

    Args:
        blueprint: What it was made from; that of an actor of a recording has the recording's values.
        attributes: What it has.
        library: The blueprints with the defaults.
    """
    told = dict(attributes)
    for key, value in attributes.items():
        type = _TYPES[attribute_type(key)]
        if not type.is_one(value):
            defaults = library.get(blueprint.id).attributes if blueprint.id in library else {}
            told[key] = defaults.get(key, type.neutral)
    return told


def _misfit(blueprint: Blueprint, key: str, value: str, expected: str) -> CallError:
    return CallError(f"{blueprint.id}: {key} of {value[:_SHOWN]!r}: expected {expected}")
