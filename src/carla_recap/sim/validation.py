"""What is asked of numbers from outside: recordings cannot hold all of them, and physics engines do not survive them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from carla_recap.sim.errors import SimError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.geometry import Location, Transform, Vector

PLACE: Final = 1e6  # m
TURN: Final = 1e6  # degrees
SPEED: Final = 1e4  # m/s
TURNING: Final = 1e5  # degrees/s
LARGEST: Final = 1e9  # of all other numbers, whatever the unit
LONGEST_TICK: Final = 10.0  # s
LONGEST_TEXT: Final = 1000  # bytes of the value of an attribute


def expect_finite(what: str, *values: float) -> None:
    """Make sure that numbers are numbers.

    Args:
        what: What they are, for the message.
        *values: The numbers.

    Raises:
        SimError: One of them is infinite, or no number.
    """
    if not all(map(isfinite, values)):
        raise SimError(f"{what}: finite numbers were expected, found {', '.join(f'{value:g}' for value in values)}")


def expect_between(what: str, value: int, least: int, most: int) -> None:
    """Make sure that a number is within bounds, both included.

    Raises:
        SimError: It is not.
    """
    if not least <= value <= most:
        raise SimError(f"{what}: {least} to {most} was expected, found {value}")


def expect_count(what: str, value: int) -> None:
    """Make sure that there can be so many.

    Raises:
        SimError: It is negative, or no whole number.
    """
    if not (value >= 0 and value % 1 == 0):
        raise SimError(f"{what}: 0 or a larger whole number was expected, found {value:g}")


def expect_seconds(what: str, value: float, most: float = LONGEST_TICK) -> None:
    """Make sure that something can last so long.

    Raises:
        SimError: It is not above 0 s, or too long.
    """
    if not 0 < value <= most:
        raise SimError(f"{what} of {value:g} s: expected more than 0 s, and at most {most:g} s")


def expect_place(what: str, place: Location) -> None:
    """Make sure that a place can be one.

    Raises:
        SimError: It is too far away.
    """
    _expect_at_most(what, "m", PLACE, place.x, place.y, place.z)


def expect_transform(what: str, transform: Transform) -> None:
    """Make sure that something can be there, and turned like that.

    Raises:
        SimError: It is too far away, or turned too far.
    """
    turn = transform.rotation
    expect_place(what, transform.location)
    _expect_at_most(what, "degrees", TURN, turn.pitch, turn.yaw, turn.roll)


def expect_velocity(what: str, velocity: Vector) -> None:
    """Make sure that something can move so fast.

    Raises:
        SimError: It is too fast.
    """
    _expect_at_most(what, "m/s", SPEED, velocity.x, velocity.y, velocity.z)


def expect_push(what: str, impulse: Vector, mass: float) -> None:
    """Make sure that an impulse, in N s, changes the velocity of a mass no more than a velocity can be.

    Raises:
        SimError: It does.
    """
    _expect_at_most(what, "m/s of change", SPEED, impulse.x / mass, impulse.y / mass, impulse.z / mass)


def expect_turning(what: str, velocity: Vector) -> None:
    """Make sure that something can turn so fast.

    Raises:
        SimError: It is too fast.
    """
    _expect_at_most(what, "degrees/s", TURNING, velocity.x, velocity.y, velocity.z)


def expect_numbers(what: str, record: Any) -> None:
    """Make sure that a recording can hold the numbers of a dataclass.

    Raises:
        SimError: One is too large.
    """
    _expect_at_most(what, "in its numbers", LARGEST, *_numbers(record))


def expect_text(what: str, value: str) -> None:
    """Make sure that a recording can hold the value of an attribute.

    Raises:
        SimError: It is too long, or no Unicode.
    """
    try:
        if len(value.encode()) <= LONGEST_TEXT:
            return
    except UnicodeEncodeError:
        pass
    raise SimError(f"{what}: at most {LONGEST_TEXT} bytes of UTF-8 were expected")


def _expect_at_most(what: str, unit: str, most: float, *values: float) -> None:
    for value in values:
        if not -most <= value <= most:
            raise SimError(f"{what}: at most {most:.10g} {unit} was expected, found {value:g}")


def _numbers(value: Any) -> Iterator[float]:
    """All numbers in nested records and sequences."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _numbers(getattr(value, field.name))
    elif isinstance(value, Sequence):
        for item in value:
            yield from _numbers(item)
    else:
        yield value
