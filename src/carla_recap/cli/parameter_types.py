"""Types of the values that options of several commands have."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable
    from datetime import datetime


class _Number(click.ParamType[Any]):
    """A number."""

    name = "number"

    def __init__(self, least: float = -math.inf, most: float = math.inf, *, exclusive: bool = False) -> None:
        self._least = least
        self._most = most
        self._exclusive = exclusive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not self._least <= number <= self._most or (self._exclusive and number == self._least):
            self.fail(f"{value!r} is not a number{self._range()}.", param, ctx)
        return number

    def _range(self) -> str:
        if self._least == -math.inf:
            return ""
        if self._exclusive:
            return f" of more than {self._least:g}"
        return f" of {self._least:g} or more" if self._most == math.inf else f" of {self._least:g} to {self._most:g}"


class Parsed(click.ParamType[Any]):
    """What a function makes of a text; its `ValueError` or `RecapError` says what is wrong with it."""

    def __init__(self, name: str, parse: Callable[[str], Any]) -> None:
        self.name = name
        self._parse = parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        if not isinstance(value, str):
            return value
        try:
            return self._parse(value)
        except (RecapError, ValueError) as error:
            self.fail(f"{error}.", param, ctx)


def _actor_id(words: tuple[str, ...], expected: str, text: str) -> int | str:
    """Return the id of an actor, or one of some words."""
    if text in words:
        return text
    if not re.fullmatch("[0-9]{1,20}", text):
        raise ValueError(f"{text!r} is neither {expected}")
    return int(text)


def _kinds(text: str) -> frozenset[str]:
    """Return kinds of incidents, which have commas between them."""
    from carla_recap.queries.kinds import kinds_named

    try:
        return kinds_named(text.split(","))
    except RecapError as error:
        raise ValueError(f"{error}, and all") from None


def _date(text: str) -> datetime:
    """Return a date and time, as of ISO 8601 or as `info` prints them; of this time zone unless it says another."""
    from datetime import datetime

    for parse in (datetime.fromisoformat, lambda text: datetime.strptime(text, "%m/%d/%y %H:%M:%S")):
        with suppress(ValueError, OverflowError):  # which a date is that is of the year 0 or 10000 in this time zone
            return parse(text).astimezone()
    raise ValueError(f"{text!r} is no date; one such as 2024-05-01 or 2024-05-01T12:30:00Z was expected")


def _size(text: str) -> tuple[int, int]:
    """Return a width and a height in pixels."""
    match = re.fullmatch("([0-9]{1,5})[xX]([0-9]{1,5})", text)
    if match is None:
        raise ValueError(f"{text!r} is no size; WIDTHxHEIGHT was expected, such as 1280x720")
    return int(match[1]), int(match[2])


def _split(text: str) -> dict[str, float]:
    """Return the shares of splits by name."""
    from carla_recap.fleet.datasets import splits_of

    pairs = [part.partition("=") for part in text.split(",")]
    try:
        shares = {name.strip(): float(share) for name, _, share in pairs}
    except ValueError:
        raise ValueError(f"{text!r} are no shares; some such as train=0.8,val=0.2 were expected") from None
    splits_of((), shares)
    return shares


NUMBER = _Number(0)
POSITIVE = _Number(0, exclusive=True)
TIME = _Number()
PERCENT = _Number(0, 100)
FOLLOW = Parsed("actor", partial(_actor_id, ("hero",), "an actor id nor hero"))
MEASURED = Parsed("actor", partial(_actor_id, ("hero", "all"), "an actor id nor hero or all"))
VIEW = Parsed("view", partial(_actor_id, ("chase", "top", "driver"), "chase, top or driver nor the id of a recorded camera"))
KINDS = Parsed("kinds", _kinds)
DATE = Parsed("date", _date)
SIZE = Parsed("size", _size)
SPLIT = Parsed("split", _split)
