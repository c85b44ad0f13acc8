"""The attributes of actors: their types, which values are of a type, and which are restricted."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.sensors.kinds import SENSOR_ATTRIBUTES
from carla_recap.sim.validation import LARGEST

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,10}(\.0*)?")
_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?", re.IGNORECASE)
_LONGEST: Final = 64  # characters of a number
_LARGEST_INT: Final = 2**31 - 1
_LARGEST_FLOAT: Final = 3.4028234663852886e38
_LARGEST_SHADE: Final = 255
_BOOL, _INT, _FLOAT, _STRING, _COLOUR = range(5)


@dataclass(frozen=True, slots=True)
class AttributeType:
    """The type of an attribute: what accepts texts as values, what is expected, for errors, and a value to fall back to."""

    accepts: Callable[[str], bool]
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


ATTRIBUTE_TYPES: Final = (
    AttributeType(_is_bool, "true or false", "false"),
    AttributeType(_is_int, "a whole number of 32 bits", "0"),
    AttributeType(_is_float, "a finite number of 32 bits", "0.0"),
    AttributeType(lambda _: True, "a text", ""),
    AttributeType(_is_colour, "three whole numbers from 0 to 255, as in 255,0,0", "0,0,0"),
)
"""The types by their codes in recordings: bool, int, float, string and colour."""

_KEYS: Final = {
    _BOOL: "sticky_control terramechanics has_lights has_dynamic_doors is_invincible can_use_wheelchair use_wheelchair"
    " ros_publish_tf",
    _INT: "number_of_wheels generation driver_id",
    _STRING: "role_name ros_name ros_frame_id base_type special_type object_type gender age size mesh_path",
    _FLOAT: "speed friction extent_x extent_y extent_z mass scale",
    _COLOUR: "color",
}
_CODES: Final = {bool: _BOOL, int: _INT, float: _FLOAT, str: _STRING}
_OF_SENSORS: Final = {key: each for sensor in SENSOR_ATTRIBUTES.values() for key, each in sensor.items()}
_TYPES: Final = {key: code for code, keys in _KEYS.items() for key in keys.split()} | {
    key: _CODES[each.type] for key, each in _OF_SENSORS.items()
}
_RESTRICTED: Final = frozenset(("driver_id", "use_wheelchair", *(key for key, each in _OF_SENSORS.items() if each.choices)))


def attribute_type(key: str) -> int:
    """Return the code of an attribute's type in recordings; that of a string for an unknown attribute."""
    return _TYPES.get(key, _STRING)


def is_restricted(key: str) -> bool:
    """Return whether an attribute is meant to have recommended values only."""
    return key in _RESTRICTED


def number(attributes: Mapping[str, str], key: str, otherwise: float, most: float = LARGEST) -> float:
    """Return an attribute from 0 to `most`, in CARLA's notation as well: 3.5f; any other one counts as `otherwise`."""
    try:
        value = float(attributes[key].removesuffix("f"))
    except (KeyError, ValueError):
        return otherwise
    return value if 0 <= value <= most else otherwise
