"""Traffic signs on posts. They face -y: the traffic that they are for drives along y."""

from __future__ import annotations

from functools import partial
from math import cos, pi, sin
from typing import TYPE_CHECKING, Final

from carla_recap.scene.materials import Material
from tools.models.solid import Solid, model
from tools.models.street import ROOT

if TYPE_CHECKING:
    from collections.abc import Sequence

M: Final = Material

LIMITS: Final = (10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 110, 120, 130)
"""The speed limits that have signs; the unit is whatever the map's is."""

_CENTER: Final = 2.3  # m, the height
_DIGITS: Final = {
    "0": "abcdef",
    "1": "bc",
    "2": "abged",
    "3": "abgcd",
    "4": "fgbc",
    "5": "afgcd",
    "6": "afgedc",
    "7": "abc",
    "8": "abcdefg",
    "9": "gfabcd",
}
_LINES: Final = {
    "a": ((0, 2), (1, 2)),
    "b": ((1, 2), (1, 1)),
    "c": ((1, 1), (1, 0)),
    "d": ((0, 0), (1, 0)),
    "e": ((0, 1), (0, 0)),
    "f": ((0, 2), (0, 1)),
    "g": ((0, 1), (1, 1)),
    "i": ((0.5, 2), (0.5, 0)),
}
"""The ends of the strokes of which digits and letters consist, on a grid 1 wide and 2 high."""
_STOP: Final = ("afgcd", "ai", "abcdef", "abgfe")


def _plate(solid: Solid, outline: Sequence[tuple[float, float]], y: float, material: Material) -> None:
    """Add a convex plate in front of the post; its outline (x and height) runs counterclockwise as seen from the front."""
    solid.facet([(x, y, _CENTER + z) for x, z in outline], material)


def _circle(radius: float, sides: int = 16, turn: float = 0.0) -> list[tuple[float, float]]:
    return [(radius * cos(2 * pi * i / sides + turn), radius * sin(2 * pi * i / sides + turn)) for i in range(sides)]


def _sign(solid: Solid, outline: Sequence[tuple[float, float]], material: Material) -> None:
    """Add a post, and a plate on it that has a back."""
    solid.limb((0, 0, -ROOT), (0, 0, _CENTER + 0.3), (0.035, 0.035), M.POLE, sides=6)
    solid.loft([[(x, y, _CENTER + z) for x, z in outline] for y in (-0.035, -0.06)], M.SIGN_BACK)
    _plate(solid, outline, -0.064, material)


def _text(
    solid: Solid, letters: Sequence[str], width: float, gap: float, height: float, stroke: float, material: Material
) -> None:
    """Add letters or digits, each of which is given by its strokes."""
    left = -(len(letters) * width + (len(letters) - 1) * gap) / 2
    for index, strokes in enumerate(letters):
        x = left + index * (width + gap)
        for name in strokes:
            (x0, z0), (x1, z1) = _LINES[name]
            low = (x + min(x0, x1) * width - stroke / 2, (min(z0, z1) - 1) * height - stroke / 2)
            high = (x + max(x0, x1) * width + stroke / 2, (max(z0, z1) - 1) * height + stroke / 2)
            _plate(solid, ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])), -0.072, material)


def speed_limit(solid: Solid, number: str = "") -> None:
    """Add the sign of a speed limit: a red ring with the number in it."""
    _sign(solid, _circle(0.36), M.SIGN_RED)
    _plate(solid, _circle(0.275), -0.068, M.SIGN_WHITE)
    width, gap = (0.13, 0.10) if len(number) < 3 else (0.085, 0.075)
    _text(solid, [_DIGITS[digit] for digit in number], width, gap, 0.14, 0.045, M.SIGN_BLACK)


@model
def stop_sign(solid: Solid) -> None:
    """Add a stop sign."""
    _sign(solid, _circle(0.42, 8, pi / 8), M.SIGN_WHITE)
    _plate(solid, _circle(0.39, 8, pi / 8), -0.068, M.SIGN_RED)
    _text(solid, _STOP, 0.1, 0.055, 0.1, 0.032, M.SIGN_WHITE)


@model
def yield_sign(solid: Solid) -> None:
    """Add a yield sign."""
    triangle = [(-0.45, 0.3), (0.0, -0.48), (0.45, 0.3)]
    _sign(solid, triangle, M.SIGN_RED)
    _plate(solid, [(x * 0.66, (z - 0.03) * 0.66 + 0.03) for x, z in triangle], -0.068, M.SIGN_WHITE)


@model
def sign(solid: Solid) -> None:
    """Add a sign of another kind: a yellow diamond."""
    _sign(solid, _circle(0.42, 4), M.SIGN_YELLOW)


model(speed_limit, "speed limit")
for _number in LIMITS:
    model(partial(speed_limit, number=str(_number)), f"speed limit {_number}")
