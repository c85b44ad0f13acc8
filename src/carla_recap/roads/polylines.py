"""Lines and areas as arrays of points: simplified lines, joined lines, outlines of areas."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads.cells import LARGEST_GAP, find_areas

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Floats, Integers

    Corner = tuple[int, int]

TOLERANCE: Final = 0.03  # m
_DEEPEST: Final = 60  # parts in one another, which keep all points; the lines of CARLA's towns need about 10
_TINY: Final = np.finfo(float).tiny
_TOUCH: Final = 0.05  # m between ends that are joined
_CELL: Final = 0.25  # m
_MOST_CELLS: Final = 2000  # along a side
_AROUND: Final = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
_SMALLEST_AREA: Final = 4.0  # square metres


def simplify(line: Floats, tolerance: float = TOLERANCE) -> Floats:
    """Return a line, (n, 2) or (n, 3), with fewer points, others at most `tolerance` m away (Douglas-Peucker)."""
    keep = np.zeros(len(line), np.bool_)
    keep[[0, -1]] = True
    parts = [(0, len(line) - 1, 0)]
    while parts:
        first, last, depth = parts.pop()
        if depth == _DEEPEST:
            keep[first:last] = True
        elif last - first > 1:
            distances = distances_to(line[first + 1 : last], line[first], line[last])
            worst = int(distances.argmax())
            if distances[worst] > tolerance:
                middle = first + 1 + worst
                keep[middle] = True
                parts += (first, middle, depth + 1), (middle, last, depth + 1)
    return line[keep]


def stations(line: Floats) -> Floats:
    """Return the distance of each point of a line, (n, 2) or (n, 3), from the first one along the line in m, (n,)."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))


def distances_to(points: Floats, start: Floats, stop: Floats) -> Floats:
    """Return the distances of points from a straight line between two points, or from one each."""
    along = stop - start
    beyond = points - start
    share = np.einsum("...j,...j", beyond, along) / np.maximum(np.einsum("...j,...j", along, along), _TINY)
    beyond -= np.minimum(np.maximum(share, 0.0), 1.0)[:, None] * along  # which is faster than np.clip
    distances: Floats = np.sqrt(np.einsum("ij,ij->i", beyond, beyond))
    return distances


def covering(left: Floats, right: Floats, along: int, across: int) -> Floats:
    """Return points that cover what is between two lines, (across, along, axes), each line given by n points."""
    at, given = np.linspace(0, len(left) - 1, along), np.arange(len(left))
    left, right = (np.stack([np.interp(at, given, axis) for axis in side.T], axis=1) for side in (left, right))
    points: Floats = left + np.linspace(0, 1, across)[:, None, None] * (right - left)
    return points


def join(lines: Sequence[Floats]) -> list[Floats]:
    """Return lines joined where one begins at the end of exactly one other."""
    starts, stops = defaultdict(list), defaultdict(list)
    for number, line in enumerate(lines):
        starts[_grid_point(line[0])].append(number)
        stops[_grid_point(line[-1])].append(number)
    after = {
        before[0]: starts[point][0]
        for point, before in stops.items()
        if len(before) == 1 and len(starts.get(point, ())) == 1 and before != starts[point]
    }
    heads = set(range(len(lines))) - set(after.values())
    joined, used = [], set()
    for number in [*sorted(heads), *range(len(lines))]:  # after the heads, those in rings
        chain: list[Floats] = []
        following: int | None = number
        while following is not None and following not in used:
            used.add(following)
            chain.append(lines[following] if not chain else lines[following][1:])
            following = after.get(following)
        if chain:
            joined.append(np.concatenate(chain))
    return joined


def _grid_point(point: Floats) -> tuple[int, ...]:
    return tuple(np.rint(point / _TOUCH).astype(np.int64).tolist())


class Surface:
    """The area that points cover, (n, 2) in m, less than half a cell apart, as cells of a grid; small holes are filled."""

    def __init__(self, points: Floats) -> None:
        extent = float(np.ptp(points, axis=0).max())
        self._cell = max(_CELL, extent / _MOST_CELLS)
        self._origin = points.min(axis=0) - 2 * self._cell
        cells = self._cells(points)
        covered = np.zeros(cells.max(axis=0) + 3, np.bool_)  # with an empty rim
        covered[cells[:, 0], cells[:, 1]] = True
        free = find_areas(~covered)
        parts = find_areas(covered | free.cells(free.enclosed & (free.sizes * self._cell**2 <= LARGEST_GAP)))
        filled = parts.cells(parts.sizes * self._cell**2 > _SMALLEST_AREA)
        self._outer = [loop for loop in _loops(_edges(filled)) if _area(loop) > 0]
        self._inner = filled.copy()
        for shift in _AROUND:
            self._inner &= np.roll(filled, shift, (0, 1))

    def covers(self, points: Floats) -> NDArray[np.bool_]:
        """Return which points, (n, 2), are within the surface and not at its edge."""
        cells = self._cells(points)
        known = self._knows(cells)
        covered = np.zeros(len(points), np.bool_)
        covered[known] = self._inner[cells[known, 0], cells[known, 1]]
        return covered

    def cover(self, points: Floats) -> None:
        """Add the cells of points, (n, 2), and their neighbours to the surface; its outlines stay."""
        cells = (self._cells(points)[:, None] + _AROUND).reshape(-1, 2)
        cells = cells[self._knows(cells)]
        self._inner[cells[:, 0], cells[:, 1]] = True

    def outlines(self) -> list[Floats]:
        """Return the outer edges: closed lines, (n, 2), counterclockwise, as exact as a cell."""
        outlines = []
        for loop in self._outer:
            middles = (loop[:-1] + loop[1:]) / 2  # of the sides of the cells, which smooths the steps
            closed = np.concatenate((middles, middles[:1])) * self._cell + self._origin
            outlines.append(simplify(closed, 0.8 * self._cell))
        return outlines

    def _cells(self, points: Floats) -> Integers:
        cells: Integers = np.floor((points - self._origin) / self._cell).astype(np.int64)
        return cells

    def _knows(self, cells: Integers) -> NDArray[np.bool_]:
        known: NDArray[np.bool_] = np.all((cells >= 0) & (cells < self._inner.shape), axis=1)
        return known


def _edges(filled: NDArray[np.bool_]) -> dict[Corner, list[Corner]]:
    """Return the sides of filled cells next to empty ones, from corner to corner, with the filled cell on the left."""
    edges = defaultdict(list)
    for (dx, dy), (x1, y1), (x2, y2) in (
        ((0, -1), (0, 0), (1, 0)),
        ((1, 0), (1, 0), (1, 1)),
        ((0, 1), (1, 1), (0, 1)),
        ((-1, 0), (0, 1), (0, 0)),
    ):
        bare = filled & ~np.roll(filled, (-dx, -dy), (0, 1))
        for x, y in np.argwhere(bare).tolist():
            edges[x + x1, y + y1].append((x + x2, y + y2))
    return edges


def _loops(edges: dict[Corner, list[Corner]]) -> Iterator[Integers]:
    """Yield the closed lines of edges; the edges are consumed."""
    while edges:
        corner = next(iter(edges))
        loop = [corner]
        while corner in edges:
            following = edges[corner].pop()
            if not edges[corner]:
                del edges[corner]
            corner = following
            loop.append(corner)
        yield np.array(loop)


def _area(loop: Integers) -> float:
    """Return the area within a closed line; negative for a clockwise one, around a hole."""
    x, y = loop.T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
