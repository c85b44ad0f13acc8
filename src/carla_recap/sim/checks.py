"""What is asked of numbers that come from outside: a physics engine does not survive all of them."""

from __future__ import annotations

from math import isfinite

from carla_recap.sim.errors import SimError


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
