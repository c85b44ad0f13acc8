"""Values of rules: which actors, quantities with units, and bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final

from carla_recap.model.lives import HERO, ROAD_USERS
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from carla_recap.model.lives import ActorLife

ANY: Final = "any"
OBJECT: Final = "object"
"""The other side of a collision with a static object, such as a building."""
ROLE: Final = "role:"

UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    "m/s": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704},
    "m/s²": {"m/s²": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665},
    "m/s³": {"m/s³": 1.0, "m/s^3": 1.0, "m/s3": 1.0},
}
"""The units in which quantities can be written, with their sizes in the unit of the values."""

_ROUNDING: Final = 1e-6  # of a value, or of its unit
_LARGE: Final = 1e6  # from which on a value is shown with an exponent
_MANY: Final = {HERO: "the hero", "vehicle": "vehicles", "walker": "walkers", OBJECT: "static objects"}


@dataclass(frozen=True, slots=True)
class Selector:
    """Some of the actors of a recording."""

    text: str = ANY  # `hero`, `vehicle`, `walker`, `any`, `object`, `role:NAME`, or a blueprint such as `vehicle.tesla.*`

    def matches(self, actor: ActorLife | None) -> bool:
        """Return whether an actor is one of them; None stands for an actor whose spawn is not recorded."""
        if self.text == ANY or actor is None:
            return self.text == ANY
        if self.text == HERO:
            return actor.is_hero
        if self.text.startswith(ROLE):
            return actor.role_name == self.text.removeprefix(ROLE)
        return fnmatchcase(actor.type_id, self.text) if "." in self.text else actor.kind == self.text

    def matches_user(self, actor: ActorLife | None) -> bool:
        """Return whether an actor is one of them, where any means vehicles and walkers."""
        if self.text == ANY:
            return actor is not None and actor.kind in ROAD_USERS
        return self.matches(actor)

    @property
    def behind(self) -> str:
        """The actors as a suffix of a noun, such as ` of the hero`; empty for any."""
        return "" if self.text == ANY else f" of {self}"

    def __str__(self) -> str:
        if self.text.startswith(ROLE):
            return f"the actor of the role {self.text.removeprefix(ROLE)}"
        return _MANY.get(self.text, self.text)


ANY_ACTOR: Final = Selector()


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of a rule, and how it is written there."""

    value: float  # in the unit of what it bounds
    unit: str = ""  # in which it is written, such as `g`; empty for a number of things
    size: float = 1.0  # that unit in the unit of the value, such as 9.80665
    text: str = ""  # the quantity as a text, such as `0.8 g`; empty: a number

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, int) else f"{self.value:.15g}"  # as it is written
        return self.text or f"{value} {self.unit}".rstrip()

    @property
    def rounding(self) -> float:
        """By how much an equal value may differ that was recorded with 32 bits, or added up; 0 for numbers of things."""
        return _ROUNDING * max(1.0, abs(self.value)) if self.unit else 0.0

    def shown(self, value: float) -> str:
        """Return another value in the unit in which this one is written, with at least the digits of its own unit."""
        scaled = value / self.size
        digits = 2 if self.size <= 1 else 3
        return f"{scaled:.{digits}f} {self.unit}" if abs(scaled) < _LARGE else f"{number(scaled)} {self.unit}"


@dataclass(frozen=True, slots=True)
class Bounds:
    """The least and the greatest valid number; None for no limit."""

    least: Quantity | None = None
    most: Quantity | None = None

    @property
    def written(self) -> Quantity:
        """The bound whose unit values are shown in: one that is written with its unit, if any is."""
        given = [each for each in (self.most, self.least) if each is not None]
        return next((each for each in given if each.text), given[0])

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the greatest valid number, with room for rounding; infinite without a limit."""
        least, most = self.least, self.most
        return (
            -math.inf if least is None else least.value - least.rounding,
            math.inf if most is None else most.value + most.rounding,
        )

    def contain(self, value: float) -> bool:
        """Return whether a number is valid; NaN is not."""
        least, most = self.limits
        return least <= value <= most

    def __str__(self) -> str:
        least, most = self.least, self.most
        if least is None or most is None:
            return f"at most {most}" if least is None else f"at least {least}"
        if least.value == most.value:
            return f"exactly {least}"
        if not self.written.text:
            least = replace(least, unit="")  # the unit follows once
        return f"at least {least} and at most {most}"


def tolerated(time: Quantity | None) -> str:
    """Return the tolerated time as a suffix of a condition; empty for None."""
    return "" if time is None else f", except for up to {time} at a time"


def listed(words: Iterable[str]) -> str:
    """Return words as a list with `or`."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last
