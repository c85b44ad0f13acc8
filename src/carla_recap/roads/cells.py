"""The cells of grids: connected areas of them, such as the gaps between the lanes of a junction, and points by cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from carla_recap.util.arrays import Booleans, Floats, Integers


LARGEST_GAP: Final = 100.0
"""The largest area between the lanes of a junction that is road, too, in m²; the island of a roundabout is larger."""

NO_AREA: Final = -1
"""The number of a cell in no area."""


class Areas(NamedTuple):
    """Areas of cells that are connected by their sides.

    Attributes:
        numbers: The number of the area of each cell, or `NO_AREA`, (columns, rows).
        sizes: The number of cells of each area, (areas,).
        enclosed: Whether an area does not touch the edge of the grid, (areas,).
    """

    numbers: Integers
    sizes: Integers
    enclosed: Booleans

    def cells(self, wanted: Booleans) -> Booleans:
        """Return the cells of some areas, (columns, rows), by whether each area is wanted, (areas,)."""
        return np.append(wanted, False)[self.numbers]


def find_areas(cells: Booleans) -> Areas:
    """Return the connected areas of cells, (columns, rows)."""
    edges = np.diff(cells.astype(np.int8), axis=1, prepend=0, append=0)  # a run of cells begins at 1 and ends at -1
    column, first = np.nonzero(edges > 0)
    _, last = np.nonzero(edges < 0)
    width = cells.shape[1] + 1
    begin = np.searchsorted(column * width + last, (column + 1) * width + first, "right")
    count = np.maximum(np.searchsorted(column * width + first, (column + 1) * width + last, "left") - begin, 0)
    one = np.repeat(np.arange(len(first)), count)  # runs, and those beside them in the next column
    other = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
    _, area = np.unique(_joined(len(first), one, other), return_inverse=True)
    total = int(area.max(initial=-1)) + 1
    numbers = np.full(cells.shape, NO_AREA)
    numbers[cells] = np.repeat(area, last - first)
    at_edge = (column == 0) | (column == cells.shape[0] - 1) | (first == 0) | (last == cells.shape[1])
    sizes = np.bincount(area, last - first, total).astype(np.int64)
    return Areas(numbers, sizes, np.bincount(area, at_edge, total) == 0)


def _joined(count: int, one: Integers, other: Integers) -> Integers:
    """Return a number of each of some things, the same for those that pairs of them connect."""
    numbers = np.arange(count)
    while len(one):
        least = np.minimum(numbers[one], numbers[other])
        np.minimum.at(numbers, numbers[one], least)
        np.minimum.at(numbers, numbers[other], least)
        while (following := numbers[numbers]).tobytes() != numbers.tobytes():
            numbers = following
        apart = numbers[one] != numbers[other]
        one, other = one[apart], other[apart]
    return numbers


class PointGrid:
    """Points in the cells of a grid, sorted by cell.

    Args:
        points: (n, 2), in m.
        cell: The size of a cell in m.

    Attributes:
        fullest: The number of points in the cell with most.
    """

    def __init__(self, points: Floats, cell: float) -> None:
        self._cell = cell
        self._origin = points.min(axis=0) - 2 * cell
        cells = np.floor((points - self._origin) / cell).astype(np.int64)
        self._shape = cells.max(axis=0) + 3
        keys = cells[:, 0] * self._shape[1] + cells[:, 1]
        self._order = np.argsort(keys, kind="stable")
        self._keys = keys[self._order]
        self.fullest = int(np.unique(self._keys, return_counts=True)[1].max())

    def around(self, places: Floats) -> tuple[Integers, Integers]:
        """Return pairs of places and points in the same cell or in one of the eight around it, as indices."""
        cells = np.floor((places - self._origin) / self._cell).astype(np.int64)
        inside = np.flatnonzero(((cells > 0) & (cells < self._shape - 1)).all(axis=1))
        columns = cells[inside, 0, None] + np.array((-1, 0, 1))
        keys = columns * self._shape[1] + cells[inside, 1, None]
        begin = np.searchsorted(self._keys, keys - 1, "left").ravel()
        counts = np.searchsorted(self._keys, keys + 1, "right").ravel() - begin
        total = np.cumsum(counts) - counts
        number = np.arange(counts.sum()) + np.repeat(begin - total, counts)
        return np.repeat(np.repeat(inside, 3), counts), self._order[number]
