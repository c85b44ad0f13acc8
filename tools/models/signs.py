"""Traffic signs on posts. They face -y: the traffic that they are for drives along y."""

from __future__ import annotations

from functools import partial
from math import cos, pi, sin
from typing import TYPE_CHECKING, Final

from carla_recap.scene.materials import Material
from tools.models.solid import Make, Solid
from tools.models.street import ROOT

if TYPE_CHECKING:
    from collections.abc import Sequence

M: Final = Material

LIMITS: Final = (10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 110, 120, 130)
"""The speed limits that have signs; the unit is whatever the map's is."""

_CENTER: Final = 2.3  # m, the height
_STROKE: Final = 0.045  # m
_SEGMENTS: Final = {
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
}
"""The ends of the seven strokes of which digits consist, on a grid 1 wide and 2 high."""


def _post(solid: Solid) -> None:
    solid.limb((0, 0, -ROOT), (0, 0, _CENTER + 0.3), (0.035, 0.035), M.POLE, sides=6)


def _plate(solid: Solid, outline: Sequence[tuple[float, float]], y: float, material: Material) -> None:
    """Add a convex plate in front of the post; its outline (x and height) runs counterclockwise as seen from the front."""
    solid.facet([(x, y, _CENTER + z) for x, z in outline], material)


def _back(solid: Solid, outline: Sequence[tuple[float, float]]) -> None:
    solid.loft([[(x, y, _CENTER + z) for x, z in outline] for y in (-0.035, -0.06)], M.SIGN_BACK)


def _circle(radius: float, sides: int = 16, turn: float = 0.0) -> list[tuple[float, float]]:
    return [(radius * cos(2 * pi * i / sides + turn), radius * sin(2 * pi * i / sides + turn)) for i in range(sides)]


def speed_limit(number: int | None) -> Solid:
    """Return the sign of a speed limit: a red ring with the number in it; None: without one."""
    solid = Solid()
    _post(solid)
    _back(solid, _circle(0.36))
    _plate(solid, _circle(0.36), -0.064, M.SIGN_RED)
    _plate(solid, _circle(0.275), -0.068, M.SIGN_WHITE)
    digits = "" if number is None else str(number)
    width, gap = (0.13, 0.10) if len(digits) < 3 else (0.085, 0.075)
    left = -(len(digits) * width + (len(digits) - 1) * gap) / 2
    for index, digit in enumerate(digits):
        x = left + index * (width + gap)
        for segment in _SEGMENTS[digit]:
            (x0, z0), (x1, z1) = _LINES[segment]
            low = (x + min(x0, x1) * width - _STROKE / 2, (min(z0, z1) - 1) * 0.14 - _STROKE / 2)
            high = (x + max(x0, x1) * width + _STROKE / 2, (max(z0, z1) - 1) * 0.14 + _STROKE / 2)
            _plate(solid, ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])), -0.072, M.SIGN_BLACK)
    return solid


def stop_sign() -> Solid:
    """Return a stop sign."""
    solid = Solid()
    _post(solid)
    octagon = _circle(0.42, 8, pi / 8)
    _back(solid, octagon)
    _plate(solid, octagon, -0.064, M.SIGN_WHITE)
    _plate(solid, _circle(0.39, 8, pi / 8), -0.068, M.SIGN_RED)
    letters = (
        ("S", ("a", "f", "g", "c", "d")),
        ("T", ("a", "i")),
        ("O", ("a", "b", "c", "d", "e", "f")),
        ("P", ("a", "b", "g", "f", "e")),
    )
    lines = {**_LINES, "i": ((0.5, 2), (0.5, 0))}
    width, gap, height, stroke = 0.1, 0.055, 0.1, 0.032
    for index, (_, strokes) in enumerate(letters):
        x = -(4 * width + 3 * gap) / 2 + index * (width + gap)
        for name in strokes:
            (x0, z0), (x1, z1) = lines[name]
            low = (x + min(x0, x1) * width - stroke / 2, (min(z0, z1) - 1) * height - stroke / 2)
            high = (x + max(x0, x1) * width + stroke / 2, (max(z0, z1) - 1) * height + stroke / 2)
            _plate(solid, ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])), -0.072, M.SIGN_WHITE)
    return solid


def yield_sign() -> Solid:
    """Return a yield sign."""
    solid = Solid()
    _post(solid)
    triangle = [(-0.45, 0.3), (0.0, -0.48), (0.45, 0.3)]
    _back(solid, triangle)
    _plate(solid, triangle, -0.064, M.SIGN_RED)
    _plate(solid, [(x * 0.66, (z - 0.03) * 0.66 + 0.03) for x, z in triangle], -0.068, M.SIGN_WHITE)
    return solid


def other_sign() -> Solid:
    """Return a sign of another kind: a yellow diamond."""
    solid = Solid()
    _post(solid)
    _back(solid, _circle(0.42, 4))
    _plate(solid, _circle(0.42, 4), -0.064, M.SIGN_YELLOW)
    return solid


SIGNS: Final[dict[str, Make]] = {
    "speed limit": partial(speed_limit, None),
    "stop sign": stop_sign,
    "yield sign": yield_sign,
    "sign": other_sign,
    **{f"speed limit {number}": partial(speed_limit, number) for number in LIMITS},
}
"""The functions that make the signs, by name."""
