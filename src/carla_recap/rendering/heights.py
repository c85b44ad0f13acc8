"""The heights of surfaces: which triangles are above and below points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_CELL: Final = 4.0  # m
_MOST_CELLS: Final = 4_000_000
_MOST_AT_ONCE: Final = 20_000  # points
_MOST_PAIRS: Final = 500_000  # of a point and a triangle, at once
_MOST_IN_CELL: Final = 300  # triangles in a cell of 4 m; CARLA's towns have up to 210
_EDGE: Final = 1e-6  # a share of a triangle


class TriangleGrid:
    """Triangles, by the cells of a grid over which they are.

    Args:
        vertices: The points, (n, 3).
        triangles: The indices of the corners, (m, 3).
        keys: A number of each triangle, such as that of its road, (m,).
    """

    def __init__(self, vertices: Floats, triangles: Integers, keys: Integers | None = None) -> None:
        self._corners = np.asarray(vertices, np.float64)[triangles]
        self._keys = np.zeros(len(triangles), np.int64) if keys is None else keys
        flat = self._corners[..., :2]
        if not len(flat):
            self._origin, self._cell, self._shape = np.zeros(2), _CELL, np.ones(2, np.int64)
            self._starts, self._members = np.zeros(2, np.int64), np.zeros(0, np.int64)
            return
        lows, highs = flat.min(axis=1), flat.max(axis=1)
        self._origin = lows.min(axis=0)
        extent = highs.max(axis=0) - self._origin
        self._cell = max(_CELL, float(np.sqrt(max(extent.prod(), 0.0) / _MOST_CELLS)), float(extent.max()) / _MOST_CELLS)
        self._shape = (extent / self._cell).astype(np.int64) + 1
        first = ((lows - self._origin) / self._cell).astype(np.int64)
        sizes = ((highs - self._origin) / self._cell).astype(np.int64) - first + 1
        counts = sizes.prod(axis=1)
        members = np.repeat(np.arange(len(flat)), counts)
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        x = first[members, 0] + within // sizes[members, 1]
        y = first[members, 1] + within % sizes[members, 1]
        cells = x * self._shape[1] + y
        order = np.argsort(cells, kind="stable")
        starts = np.searchsorted(cells[order], np.arange(self._shape.prod() + 1))
        sizes_of_cells = np.diff(starts)
        most = int(_MOST_IN_CELL * (self._cell / _CELL) ** 2)
        if sizes_of_cells.max() > most:  # more lie one above the other than a town has: the first ones are kept
            kept = np.arange(len(order)) - np.repeat(starts[:-1], sizes_of_cells) < most
            order = order[kept]
            starts = np.concatenate(([0], np.cumsum(np.minimum(sizes_of_cells, most))))
        self._members, self._starts = members[order], starts

    def hits(self, points: Floats) -> tuple[Integers, Floats, Integers]:
        """Return the triangles above and below points: the index of the point, the height, and the key of each.

        Args:
            points: Rows of x, y, (n, 2) or (n, 3).
        """
        parts = [self._hits(points[start : start + _MOST_AT_ONCE], start) for start in range(0, len(points), _MOST_AT_ONCE)]
        if not parts:
            return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64)
        index, heights, keys = (np.concatenate(column) for column in zip(*parts, strict=True))
        return index, heights, keys

    def _hits(self, points: Floats, start: int) -> tuple[Integers, Floats, Integers]:
        points = np.asarray(points, np.float64)[:, :2]
        with np.errstate(invalid="ignore"):
            cells = np.floor((points - self._origin) / self._cell)
            inside = np.flatnonzero(((cells >= 0) & (cells < self._shape)).all(axis=1))
        near = cells[inside].astype(np.int64)
        numbers = near[:, 0] * self._shape[1] + near[:, 1]
        firsts = self._starts[numbers]
        counts = self._starts[numbers + 1] - firsts
        batches = np.cumsum(counts) // _MOST_PAIRS
        if len(batches) and batches[-1]:
            cuts = np.flatnonzero(np.diff(batches)) + 1
            columns = [np.split(column, cuts) for column in (inside, firsts, counts)]
            parts = [self._pairs(points, some, first, count, start) for some, first, count in zip(*columns, strict=True)]
            found, heights, keys = (np.concatenate(column) for column in zip(*parts, strict=True))
            return found, heights, keys
        return self._pairs(points, inside, firsts, counts, start)

    def _pairs(
        self, points: Floats, inside: Integers, firsts: Integers, counts: Integers, start: int
    ) -> tuple[Integers, Floats, Integers]:
        index = np.repeat(inside, counts)
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        members = self._members[np.repeat(firsts, counts) + within]
        a, b, c = np.moveaxis(self._corners[members], 1, 0)
        ab, ac, ap = b[:, :2] - a[:, :2], c[:, :2] - a[:, :2], points[index] - a[:, :2]
        area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / area
            v = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / area
            hit = (u >= -_EDGE) & (v >= -_EDGE) & (u + v <= 1 + _EDGE)
        heights = a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2])
        return index[hit] + start, heights[hit], self._keys[members[hit]]

    def highest(self, points: Floats, above: float = 0.5) -> Floats:
        """Return the height of the highest triangle at each point, NaN where there is none.

        Args:
            points: Rows of x, y, (n, 2), or of x, y, z, (n, 3): what is higher than z does not count.
            above: How far a triangle may be above z, in m.
        """
        index, heights, _ = self.hits(points)
        if points.shape[1] > 2:
            below = heights <= points[index, 2] + above
            index, heights = index[below], heights[below]
        found = np.full(len(points), -np.inf)
        np.maximum.at(found, index, heights)
        return np.where(np.isfinite(found), found, np.nan)
