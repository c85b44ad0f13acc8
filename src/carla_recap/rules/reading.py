"""Reads a file of rules by tables of keys, with the types of their values, and collects all faults."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final

from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from carla_recap.rules.places import Place
    from carla_recap.tables.trajectories import Axes

LARGEST_COUNT: Final = 1 << 63
"""The largest number of things."""

SHOWN: Final = 60
"""The characters of a wrong value in an error."""


class Unexpected(Exception):
    """Values are wrong: what was expected, or of keys that do not go together, what is wrong; empty if it is known already.

    The key is that which is wrong; empty if it is not one alone.
    """

    def __init__(self, fault: str = "", key: str = "") -> None:
        super().__init__(fault)
        self.key = key


@dataclass(frozen=True)
class Reading:
    """Reads values of a file of rules, and collects the faults."""

    prefix: str  # the file, and what is read in it, for faults
    faults: list[str] = field(default_factory=list)
    folder: str = ""  # that paths are relative to
    axes: Axes = "right-handed"  # of places
    places: Mapping[str, Place | None] = field(default_factory=dict)  # that have a name; None where one is wrong

    @property
    def sign(self) -> float:
        """The factor by which y in the file becomes right-handed."""
        return 1.0 if self.axes == "right-handed" else -1.0

    def of(self, prefix: str) -> Reading:
        """Return a reader of a part, whose prefix begins its faults."""
        return replace(self, prefix=prefix)

    def refuse(self, value: Any, expected: str) -> None:
        """Add the fault of a value."""
        self.faults.append(f"{self.prefix}: expected {expected}, found {shown(value)}")

    def value(self, type: ValueType, value: Any, name: str = "") -> Any:
        """Return a value as its type reads it; None, and a fault, if it is wrong, or missing (None)."""
        inside = self.of(f"{self.prefix}.{name}") if name else self
        try:
            found = None if value is None else type.read(value, inside)
            expected = type.expected if found is None else ""
        except Unexpected as error:
            found, expected = None, str(error)
        if expected:
            inside.refuse(value, expected)
        return found

    def table(self, parts: Sequence[Key | KeyGroup], table: Mapping[str, Any], *, plain: str = "", others: str = "") -> Any:
        """Return the values of a table by the fields that they are for; None, and faults, if any is wrong.

        `plain` is the key whose value was given in place of a table, and `others` the field that gets the keys that are in
        no part; without one, these are faults.
        """
        count = len(self.faults)
        keys = keys_of(parts)
        names = [key.name for key in keys]
        found = {
            key.name: self.value(key.type, table.get(key.name), "" if key.name == plain else key.name)
            if key.name in table or key.required
            else key.default
            for key in keys
        }
        more = {name: value for name, value in table.items() if name not in found}
        if not others:
            self.faults.extend(f"{self.prefix}: unknown key {shown(name)}; {hint(name, names, 'keys')}" for name in more)
        if len(self.faults) > count or any(found[name] is None for name in table if name in found):
            return None
        values = {others: more} if others else {}
        for part in parts:
            try:
                values[part.field] = found[part.name] if isinstance(part, Key) else part.read(self, found)
            except Unexpected as error:
                self.faults.append(f"{self.prefix}{'.' if error.key else ''}{error.key}: {error}")
        return None if len(self.faults) > count else values


@dataclass(frozen=True)
class ValueType:
    """A type of values."""

    name: str  # in docs/ci.md
    expected: str  # in errors, with all that is needed to write such a value
    read: Callable[[Any, Reading], Any]  # converts a value of a file; None: it is not what is expected


@dataclass(frozen=True)
class Key:
    """A key of a condition or a place."""

    name: str  # in the file
    type: ValueType
    text: str  # the meaning, as in docs/ci.md
    field: str = ""  # that gets the value; by default that of the same name
    default: Any = None  # the value without it
    required: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "field", self.field or self.name)


@dataclass(frozen=True)
class KeyGroup:
    """Keys that make one value together, such as the bounds of a number."""

    field: str  # that gets the value
    keys: tuple[Key, ...]
    make: Callable[..., Any]  # returns the value, from those of the keys by field
    title: str = ""  # the name of the group in the tables of docs/ci.md; empty: the keys are listed

    def read(self, reading: Reading, found: Mapping[str, Any]) -> Any:
        """Return the value of the group, from those of all keys by name."""
        return self.make(reading, **{key.field: found[key.name] for key in self.keys})


def keys_of(parts: Iterable[Key | KeyGroup]) -> list[Key]:
    """Return all keys, those of groups included."""
    return [key for part in parts for key in ((part,) if isinstance(part, Key) else part.keys)]


def hint(name: str, known: Sequence[str], what: str) -> str:
    """Return what may be meant by an unknown name, and all names that there are."""
    near = get_close_matches(str(name)[:SHOWN], known, 1)
    every = f"{what} are {', '.join(known)}" if len(known) > 1 else f"{what.removesuffix('s')} is {known[0]}"
    return f"did you mean {near[0]}? The {every}" if near else f"the {every}"


def shown(value: Any) -> str:
    """Return a value of a file for an error."""
    if value is None:
        return "nothing"
    if type(value) is int and abs(value) > LARGEST_COUNT:
        return "a number of many digits"
    if isinstance(value, dict):
        return "a table"
    text = reprlib.repr(value) if isinstance(value, list) else repr(value[:SHOWN] if isinstance(value, str) else value)
    return visible(text if len(text) <= 2 * SHOWN else f"{text[:SHOWN]}…")
