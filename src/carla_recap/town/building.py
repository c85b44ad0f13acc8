"""Collecting triangles of many surfaces, cutting them in tiles, and finding the heights of surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.mesh import Mesh

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from carla_recap.scene.materials import Material
    from carla_recap.util.arrays import Booleans, Floats, Integers


_CELL: Final = 4.0  # m
_MOST_CELLS: Final = 4_000_000
_MOST_AT_ONCE: Final = 20_000  # points
_MOST_PAIRS: Final = 500_000  # of a point and a triangle, at once
_MOST_IN_CELL: Final = 300  # triangles in a cell of 4 m; CARLA's towns have up to 210
_EDGE: Final = 1e-6  # a share of a triangle
TILE: Final = 50.0
"""The side of a tile, in m."""

UP: Final = np.array((0.0, 0.0, 1.0))
_LEAST_AREA: Final = 1e-4  # square metres; smaller triangles are left out
_MOST_TILES: Final = 1 << 20


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
        """Return the triangles above and below points: the index of the point, the height, and the key of each."""
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

    def covers(self, points: Floats, within: float = 1.0, other_than: Integers | int = -1) -> Booleans:
        """Return which points, (n, 3), are at about the height of a triangle, whose key is not theirs."""
        index, heights, keys = self.hits(points)
        own = np.broadcast_to(other_than, len(points))[index]
        covered = np.zeros(len(points), np.bool_)
        covered[index[(keys != own) & (np.abs(heights - points[index, 2]) < within)]] = True
        return covered

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


def strip(points: int, wanted: Booleans) -> Integers:
    """Return the triangles between two lines of points, the left and then the right one, of the wanted parts of them."""
    first = np.flatnonzero(wanted)
    lower = np.stack((first + points, first + points + 1, first + 1), axis=1)
    return np.concatenate((lower, np.stack((first + points, first + 1, first), axis=1)))


def interpolated(stations: Floats, known: Floats, points: Floats) -> Floats:
    """Return the points of a line at stations, (n, axes), given those at known ones."""
    return np.stack([np.interp(stations, known, axis) for axis in points.T], axis=1)


def circle(count: int, turn: float = 0.0) -> Floats:
    """Return a closed ring of points around the vertical axis, (count + 1, 3)."""
    angles = turn + np.arange(count + 1) * 2 * np.pi / count
    return np.stack((np.cos(angles), np.sin(angles), np.zeros(count + 1)), axis=1)


def smoothed(heights: Floats, known: Booleans, times: int) -> Floats:
    """Return a grid of heights of which those that are not known are means of those around, again and again."""
    filled = heights
    for _ in range(times):
        padded = np.pad(filled, 1, mode="edge")
        mean = (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 4
        filled = np.where(known, heights, mean)
    return filled


class MeshBuilder:
    """Collects triangles."""

    def __init__(self) -> None:
        self._vertices: list[Floats] = []
        self._normals: list[Floats] = []
        self._materials: list[NDArray[np.uint8]] = []
        self._triangles: list[Integers] = []
        self._count = 0

    def add(self, vertices: Floats, normals: Floats, triangles: Integers, material: Material) -> None:
        """Add triangles of one material; those without an area, or that are not finite, are left out later."""
        if not len(triangles):
            return
        self._vertices.append(vertices)
        self._normals.append(np.broadcast_to(normals, vertices.shape))
        self._materials.append(np.full(len(vertices), material, np.uint8))
        self._triangles.append(triangles + self._count)
        self._count += len(vertices)

    def add_strip(self, left: Floats, right: Floats, normals: Floats, material: Material, wanted: NDArray[np.bool_]) -> None:
        """Add the surface between two lines of points, as seen in their direction; seen from above if left is left.

        Normals are those at the points, (n, 3), or one, (3,); only the wanted parts between two successive points are added,
        (n - 1,).
        """
        both = np.broadcast_to(normals, left.shape)
        self.add(np.concatenate((left, right)), np.concatenate((both, both)), strip(len(left), wanted), material)

    def add_quads(self, corners: Floats, normals: Floats, material: Material) -> None:
        """Add quadrangles.

        Corners are counterclockwise as seen from outside, (n, 4, 3); normals (n, 3) or (3,).
        """
        n = len(corners)
        first = 4 * np.arange(n)[:, None]
        triangles = np.concatenate((first + np.array((0, 1, 2)), first + np.array((0, 2, 3))))
        of_corners = np.broadcast_to(np.asarray(normals).reshape(-1, 1, 3), (n, 4, 3)).reshape(-1, 3)
        self.add(corners.reshape(-1, 3), of_corners, triangles, material)

    def add_polygon(self, corners: Floats, normal: Floats, material: Material) -> None:
        """Add a convex polygon, its corners counterclockwise as seen from outside, (n, 3)."""
        index = np.arange(1, len(corners) - 1)
        self.add(corners, normal, np.stack((np.zeros_like(index), index, index + 1), axis=1), material)

    def arrays(self) -> tuple[Floats, Floats, NDArray[np.uint8], Integers]:
        """Return vertices, normals, materials and triangles that have an area."""
        if not self._triangles:
            return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros((0, 3), np.int64)
        vertices, triangles = np.concatenate(self._vertices), np.concatenate(self._triangles)
        a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
        x, y, z = (b - a).T
        u, v, w = (c - a).T
        squares = (y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2
        triangles = triangles[squares > (2 * _LEAST_AREA) ** 2]
        return vertices, np.concatenate(self._normals), np.concatenate(self._materials), triangles

    def grid(self, materials: Collection[Material]) -> TriangleGrid:
        """Return the triangles of some materials so far, as surfaces."""
        vertices, _, of_vertices, triangles = self.arrays()
        return TriangleGrid(vertices, triangles[np.isin(of_vertices[triangles[:, 0]], list(materials))])

    def tiles(self) -> list[Mesh]:
        """Return the triangles by the tile in which their middle is; those of high numbers of materials first.

        Markings and lanes come before the grass below them, so that a renderer need not shade the grass there.
        """
        vertices, normals, materials, triangles = self.arrays()
        if not len(triangles):
            return []
        middles = vertices[triangles, :2].mean(axis=1)
        low = middles.min(axis=0)
        extent = float(np.ptp(middles, axis=0).max())
        cells = np.floor((middles - low) / max(TILE, extent / np.sqrt(_MOST_TILES))).astype(np.int64)
        tiles = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        order = np.lexsort((-materials[triangles[:, 0]].astype(np.int64), tiles))
        starts = np.flatnonzero(np.diff(tiles[order], prepend=-1))
        parts = []
        for part in np.split(triangles[order], starts[1:]):
            used, renumbered = np.unique(part, return_inverse=True)
            parts.append(
                Mesh(
                    vertices[used].astype(np.float32),
                    normals[used].astype(np.float32),
                    materials[used],
                    renumbered.reshape(-1, 3).astype(np.uint32),
                )
            )
        return parts
