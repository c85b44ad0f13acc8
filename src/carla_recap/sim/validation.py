"""Checks of values from outside: recordings and the physics engine cannot handle all of them.

Each raises SimError, and takes the name of what it checks, and optionally its owner (`of`), for the text alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from carla_recap.sim.errors import SimError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.geometry import Location, Transform, Vector

MAX_COORDINATE: Final = 1e6  # m
MAX_ANGLE: Final = 1e6  # degrees
MAX_SPEED: Final = 1e4  # m/s
_MAX_ANGULAR_SPEED: Final = 1e5  # degrees/s
LARGEST: Final = 1e9  # the limit of all other numbers, in any unit
MAX_TICK: Final = 10.0  # s
MAX_TEXT: Final = 1000  # bytes of the value of an attribute


def expect_finite(what: str, *values: float, of: object = None) -> None:
    """Make sure that numbers are finite."""
    if not all(map(isfinite, values)):
        raise SimError(
            f"{_named(what, of)}: finite numbers were expected, found {', '.join(f'{value:g}' for value in values)}"
        )


def expect_between(what: str, value: int, least: int, most: int, *, of: object = None) -> None:
    """Make sure that a number is within bounds, both included."""
    if not least <= value <= most:
        raise SimError(f"{_named(what, of)}: expected {least} to {most}, found {value}")


def expect_count(what: str, value: int) -> None:
    """Make sure that a number is a count."""
    if not (value >= 0 and value % 1 == 0):
        raise SimError(f"{what}: expected 0 or a larger whole number, found {value:g}")


def expect_seconds(what: str, value: float, most: float = MAX_TICK) -> None:
    """Make sure that a duration in s is within bounds."""
    if not 0 < value <= most:
        raise SimError(f"{what} of {value:g} s: expected more than 0 s, and at most {most:g} s")


def expect_place(what: str, location: Location, *, of: object = None) -> None:
    """Make sure that the coordinates of a location are within bounds."""
    _expect_at_most(what, of, "m", MAX_COORDINATE, location.x, location.y, location.z)


def expect_transform(what: str, transform: Transform, *, of: object = None) -> None:
    """Make sure that the numbers of a transform are within bounds."""
    rotation = transform.rotation
    expect_place(what, transform.location, of=of)
    _expect_at_most(what, of, "degrees", MAX_ANGLE, rotation.pitch, rotation.yaw, rotation.roll)


def expect_velocity(what: str, velocity: Vector, *, of: object = None) -> None:
    """Make sure that a velocity in m/s is within bounds, in whichever axes."""
    _expect_at_most(what, of, "m/s", MAX_SPEED, velocity.x, velocity.y, velocity.z, velocity.length())


def expect_push(what: str, impulse: Vector, mass: float, *, of: object = None) -> None:
    """Make sure that the velocity to which an impulse in N s accelerates a mass in kg is within bounds."""
    _expect_at_most(what, of, "m/s", MAX_SPEED, impulse.x / mass, impulse.y / mass, impulse.z / mass)


def expect_turning(what: str, velocity: Vector, *, of: object = None) -> None:
    """Make sure that an angular velocity in degrees/s is within bounds."""
    _expect_at_most(what, of, "degrees/s", _MAX_ANGULAR_SPEED, velocity.x, velocity.y, velocity.z)


def expect_numbers(what: str, record: Any) -> None:
    """Make sure that the numbers of a dataclass are within bounds."""
    _expect_at_most(what, None, "in its numbers", LARGEST, *_numbers(record))


def expect_text(what: str, value: str, *, of: object = None) -> None:
    """Make sure that a recording can contain the value of an attribute."""
    try:
        if len(value.encode()) <= MAX_TEXT:
            return
    except UnicodeEncodeError:
        pass
    raise SimError(f"{_named(what, of)}: at most {MAX_TEXT} bytes of UTF-8 were expected")


def _named(what: str, of: object) -> str:
    return what if of is None else f"{what} of {of if isinstance(of, str) else repr(of)}"


def _expect_at_most(what: str, of: object, unit: str, most: float, *values: float) -> None:
    for value in values:
        if not -most <= value <= most:
            raise SimError(f"{_named(what, of)}: expected at most {most:.10g} {unit}, found {value:g}")


def _numbers(value: Any) -> Iterator[float]:
    """Yield all numbers in nested records and sequences."""
    if isinstance(value, float):  # as most are
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            yield from _numbers(getattr(value, field.name))
    elif isinstance(value, Sequence):
        for item in value:
            yield from _numbers(item)
    else:
        yield value
