"""The cells of grids: connected areas of them, such as the gaps between the lanes of a junction, and things by cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.util.arrays import Booleans, Floats, Integers


LARGEST_GAP: Final = 100.0
"""The largest area between the lanes of a junction that is road, too, in m²; the island of a roundabout is larger."""

NO_AREA: Final = -1
"""The number of a cell in no area."""

_MOST_ENTRIES: Final = 4_000_000  # of things in cells, beyond one entry for each thing
_MOST_PAIRS: Final = 1 << 16  # of places and things that are compared together, about


class Areas(NamedTuple):
    """Areas of cells that are connected by their sides."""

    numbers: Integers  # the number of the area of each cell, or `NO_AREA`, (columns, rows)
    sizes: Integers  # the number of cells of each area, (areas,)
    enclosed: Booleans  # whether an area does not touch the edge of the grid, (areas,)

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


class BoxGrid:
    """Things by the cells of a grid, each in all cells within a margin of its box from `low` to `high`, (n, 2); all in m.

    `pairs` finds all things within the margin of a place. Cells are larger than wanted where there would be too many.
    """

    def __init__(self, low: Floats, high: Floats, cell: float, margin: float) -> None:
        self._origin = low.min(axis=0, initial=0.0) - margin
        while True:
            first = np.floor((low - margin - self._origin) / cell).astype(np.int64)
            counts = np.floor((high + margin - self._origin) / cell).astype(np.int64) - first + 1
            if counts.prod(axis=1).sum() <= _MOST_ENTRIES + len(low):  # which they have at the latest in a single cell
                break
            cell *= 2
        self._cell, self._shape = cell, (first + counts).max(axis=0, initial=1)
        thing, number = _ranges(counts.prod(axis=1))
        column, row = first[thing].T + np.divmod(number, counts[thing, 1])
        cells = column * self._shape[1] + row
        order = np.argsort(cells, kind="stable")
        self._things = thing[order]
        filled, starts, amounts = np.unique(cells[order], return_index=True, return_counts=True)
        self._cells = np.append(filled, np.iinfo(np.int64).max)  # the last one has no things
        self._starts, self._amounts = np.append(starts, 0), np.append(amounts, 0)

    def pairs(self, places: Floats) -> Iterator[tuple[Integers, Integers]]:
        """Yield pairs of places, (k, 2) or more columns, and things near them, as indices: some places after others."""
        cell = np.floor((places[:, :2] - self._origin) / self._cell)
        inside = ((cell >= 0) & (cell < self._shape)).all(axis=1)
        column, row = np.where(inside[:, None], cell, 0).astype(np.int64).T
        slots = np.searchsorted(self._cells, cells := column * self._shape[1] + row)
        slots[~inside | (self._cells[slots] != cells)] = len(self._cells) - 1
        starts, amounts = self._starts[slots], self._amounts[slots]
        blocks = np.flatnonzero(np.diff(np.cumsum(amounts) // _MOST_PAIRS)) + 1
        for part in np.split(np.arange(len(places)), blocks):
            query, number = _ranges(amounts[part])
            yield part[query], self._things[starts[part[query]] + number]


def _ranges(counts: Integers) -> tuple[Integers, Integers]:
    """Return for each of some counts the numbers from 0 up to it: the indices of the counts, and the numbers."""
    index = np.repeat(np.arange(len(counts)), counts)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)


def least(query: Integers, cost: Floats) -> Integers:
    """Return for each place, of those in ascending `query`, the row of the pair of least cost, the first of equals."""
    starts = np.flatnonzero(np.diff(query, prepend=-1))
    lowest = np.minimum.reduceat(cost, starts) if len(starts) else cost
    rows = np.flatnonzero(cost == np.repeat(lowest, np.diff(starts, append=len(query))))
    return rows[np.flatnonzero(np.diff(query[rows], prepend=-1))]
