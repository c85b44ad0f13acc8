"""Types of the values that options of several commands have."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any

import click


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


class _ActorId(click.ParamType[Any]):
    """The id of an actor, or one of some words."""

    def __init__(self, name: str, words: tuple[str, ...], expected: str) -> None:
        self.name = name
        self._words = words
        self._expected = expected

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in self._words or isinstance(value, int):
            return value
        if not re.fullmatch("[0-9]{1,20}", value):
            self.fail(f"{value!r} is neither {self._expected}.", param, ctx)
        return int(value)


class _Kinds(click.ParamType[Any]):
    """Kinds of incidents, with commas between them, or all."""

    name = "kinds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from carla_recap.errors import RecapError
        from carla_recap.queries.kinds import kinds_named

        if not isinstance(value, str):
            return value
        try:
            return kinds_named(value.split(","))
        except RecapError as error:
            self.fail(f"{error}, and all.", param, ctx)


class _Date(click.ParamType[Any]):
    """A date and time, as of ISO 8601 or as `info` prints them; of this time zone unless it says another."""

    name = "date"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from datetime import datetime

        for parse in (datetime.fromisoformat, lambda text: datetime.strptime(text, "%m/%d/%y %H:%M:%S")):
            with suppress(ValueError, OverflowError):  # which a date is that is of the year 0 or 10000 in this time zone
                return parse(value).astimezone()
        return self.fail(f"{value!r} is no date; one such as 2024-05-01 or 2024-05-01T12:30:00Z was expected.", param, ctx)


class _Size(click.ParamType[Any]):
    """A width and a height in pixels."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        match = re.fullmatch("([0-9]{1,5})[xX]([0-9]{1,5})", value)
        if match is None:
            self.fail(f"{value!r} is no size; WIDTHxHEIGHT was expected, such as 1280x720.", param, ctx)
        return int(match[1]), int(match[2])


class _Split(click.ParamType[Any]):
    """Names of splits with their shares."""

    name = "split"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from carla_recap.errors import RecapError
        from carla_recap.fleet.datasets import splits_of

        if not isinstance(value, str):
            return value
        pairs = [part.partition("=") for part in value.split(",")]
        try:
            shares = {name.strip(): float(share) for name, _, share in pairs}
        except ValueError:
            self.fail(f"{value!r} are no shares; some such as train=0.8,val=0.2 were expected.", param, ctx)
        try:
            splits_of((), shares)
        except RecapError as error:
            self.fail(f"{error}.", param, ctx)
        return shares


NUMBER = _Number(0)
POSITIVE = _Number(0, exclusive=True)
TIME = _Number()
PERCENT = _Number(0, 100)
FOLLOW = _ActorId("actor", ("hero",), "an actor id nor hero")
MEASURED = _ActorId("actor", ("hero", "all"), "an actor id nor hero or all")
VIEW = _ActorId("view", ("chase", "top", "driver"), "chase, top or driver nor the id of a recorded camera")
KINDS = _Kinds()
DATE = _Date()
SIZE = _Size()
SPLIT = _Split()
