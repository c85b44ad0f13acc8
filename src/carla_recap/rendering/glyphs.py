"""Arrows, digits and letters as convex polygons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_THICKNESS: Final = 0.2  # of the height of a letter
_GAP: Final = 0.35  # of the width of a letter, between two
# The strokes of a letter, from corner to corner of a grid of 2 columns and 3 rows.
_STROKES: Final = {
    "-": ((0, 1), (1, 1)),
    "_": ((0, 0), (1, 0)),
    "^": ((0, 2), (1, 2)),
    "<": ((0, 1), (0, 2)),
    ">": ((1, 1), (1, 2)),
    "[": ((0, 0), (0, 1)),
    "]": ((1, 0), (1, 1)),
    "|": ((0.5, 0), (0.5, 2)),
}
_LETTERS: Final = {
    "0": "^<>[]_",
    "1": ">]",
    "2": "^>-[_",
    "3": "^>-]_",
    "4": "<>-]",
    "5": "^<-]_",
    "6": "^<-[]_",
    "7": "^>]",
    "8": "^<>-[]_",
    "9": "^<>-]_",
    "S": "^<-]_",
    "T": "^|",
    "O": "^<>[]_",
    "P": "^<>-[",
}
_ARROWS: Final = {"1": "S", "2L": "SL", "2R": "SR", "3L": "SL", "3R": "SR", "4L": "L", "4R": "R", "5": "LR", "6": "SLR"}


def glyphs(text: str, width: float, height: float) -> list[Floats]:
    """Return digits and letters as polygons, (n, 2): upwards and to the left, counterclockwise, around their middle.

    Args:
        text: The digits, and of the letters, those of STOP; others are left out.
        width: The width of the whole, in m.
        height: The height, in m.
    """
    letters = [_LETTERS[letter] for letter in text if letter in _LETTERS]
    each = width / max(len(letters) + _GAP * (len(letters) - 1), 1)
    half = min(_THICKNESS * height, 0.36 * each) / 2
    shapes = []
    for index, strokes in enumerate(letters):
        left = width / 2 - index * (1 + _GAP) * each
        for stroke in strokes:
            (x1, y1), (x2, y2) = _STROKES[stroke]
            low_up, high_up = (-height / 2 + half + y * (height / 2 - half) for y in (y1, y2))
            a, b = (left - half - x * (each - 2 * half) for x in (x1, x2))
            shapes.append(_box(low_up - half, high_up + half, min(a, b) - half, max(a, b) + half))
    return shapes


def arrow(name: str) -> list[Floats]:
    """Return an arrow on a road as polygons, (n, 2): forward and to the left, counterclockwise.

    Args:
        name: The name of its kind in maps, such as `Stencil_ArrowType4R`.
    """
    shapes = [_box(-1.6, 0.1, -0.08, 0.08)]
    for way in _ARROWS.get(name.rpartition("Type")[2], "S"):
        if way == "S":
            shapes += [_box(0.1, 0.8, -0.08, 0.08), np.array(((0.8, -0.3), (1.7, 0.0), (0.8, 0.3)))]
        else:
            side = 1 if way == "L" else -1
            bend = np.array(((-0.1, 0.08), (0.1, -0.08), (0.55, 0.35), (0.35, 0.5)))
            head = np.array(((0.1, 0.42), (0.75, 0.28), (0.75, 1.05)))
            shapes += [(part * (1, side))[::side] for part in (bend, head)]
    return [shape if _area(shape) > 0 else shape[::-1] for shape in shapes]


def _box(back: float, front: float, right: float, left: float) -> Floats:
    return np.array(((back, right), (front, right), (front, left), (back, left)))


def _area(shape: Floats) -> float:
    x, y = shape.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
