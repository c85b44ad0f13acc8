"""The gaps between the lanes of junctions, filled."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.building import UP
from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.building import MeshBuilder
    from carla_recap.rendering.heights import TriangleGrid
    from carla_recap.rendering.surfaces import SampledSection

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

FILLED: Final = -0.012
"""The height of what fills gaps, relative to the lanes, in m."""

_CELL: Final = 0.5  # m
_MARGIN: Final = 3  # cells
_MOST_CELLS: Final = 600  # along a side
_LARGEST_GAP: Final = 150.0  # square metres; the island of a roundabout is larger
_ASPHALT: Final = 0.6  # the share of pavement around a gap that is filled
_LONGEST: Final = 8  # cells of a quadrangle
_FLAT: Final = 0.005  # m
_SMOOTHINGS: Final = 40
_SIDES: Final = ((1, 0), (-1, 0), (0, 1), (0, -1))


def fill_junctions(builder: MeshBuilder, sections: Sequence[SampledSection], surfaces: TriangleGrid) -> None:
    """Fill the gaps between the lanes of each junction.

    Args:
        builder: Collects the triangles.
        sections: The sections of all roads.
        surfaces: All surfaces of roads; with the keys of `surface_grid`.
    """
    junctions = defaultdict(list)
    for section in sections:
        if section.road.in_junction:
            junctions[section.road.junction].append(section.borders[[0, -1]].reshape(-1, 3))
    for lines in junctions.values():
        points = np.concatenate(lines)
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        cell = max(_CELL, float((high - low).max()) / _MOST_CELLS)
        _fill(builder, low - _MARGIN * cell, high + _MARGIN * cell, cell, surfaces)


def _fill(builder: MeshBuilder, low: Floats, high: Floats, cell: float, surfaces: TriangleGrid) -> None:
    columns, rows = (np.ceil((high - low) / cell).astype(np.int64) + 1).tolist()
    x, y = np.meshgrid(low[0] + np.arange(columns) * cell, low[1] + np.arange(rows) * cell, indexing="ij")
    points = np.stack((x, y), axis=2).reshape(-1, 2)
    index, heights_there, keys = surfaces.hits(points)
    on = keys > 0
    highest = np.full(len(points), -np.inf)
    np.maximum.at(highest, index[on], heights_there[on])
    covered, outside = np.zeros((2, len(points)), np.bool_)
    covered[index] = True
    outside[index[keys == 2]] = True
    outside[index[keys == 1]] = False
    heights, empty, elsewhere = (column.reshape(columns, rows) for column in (highest, ~covered, outside))
    on_road = np.isfinite(heights)
    if not on_road.any():
        return
    wanted = np.logical_or.reduce(list(_gaps(empty, on_road, _LARGEST_GAP / cell**2)), initial=False)
    wanted = _grown(_grown(np.broadcast_to(wanted, on_road.shape)))  # as far as below the lanes
    wanted |= ~_grown(~_grown(on_road))  # narrow gaps, too
    if float(np.ptp(heights[on_road])) < _FLAT:
        z, longest = np.full(on_road.shape, heights[on_road].min()), _MOST_CELLS
    else:
        z, longest = _spread(np.where(on_road, heights, np.nan)), _LONGEST
    full = _squares(wanted) & ~_squares(elsewhere)
    boxes = [
        [(x[i, k], y[i, k], z[i, k] + FILLED) for i, k in ((first, low), (last, low), (last, high), (first, high))]
        for first, last, low, high in _boxes(full, longest)
    ]
    if boxes:
        builder.add_quads(np.array(boxes), UP, Material.JUNCTION)


def _gaps(empty: Flags, on_road: Flags, most: float) -> Iterator[Flags]:
    """Yield the connected empty parts that are enclosed, not too large, and mostly beside pavement."""
    left = empty.copy()
    for start in np.argwhere(empty).tolist():
        if not left[tuple(start)]:
            continue
        part = np.zeros_like(empty)
        stack = [(start[0], start[1])]
        left[tuple(start)] = False
        part[tuple(start)] = True
        count, is_open = 0, False
        while stack:
            i, j = stack.pop()
            count += 1
            if not (0 < i < empty.shape[0] - 1 and 0 < j < empty.shape[1] - 1):
                is_open = True
                continue
            for di, dj in _SIDES:
                if left[i + di, j + dj]:
                    left[i + di, j + dj] = False
                    part[i + di, j + dj] = True
                    stack.append((i + di, j + dj))
        if not is_open and count <= most:
            rim = _grown(part) & ~part
            if on_road[rim].mean() >= _ASPHALT:
                yield part


def _squares(corners: Flags) -> Flags:
    """Return the squares of a grid of which all corners are set."""
    return corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:]


def _grown(cells: Flags) -> Flags:
    padded = np.pad(cells, 1)
    grown: Flags = cells.copy()
    for i in range(3):
        for j in range(3):
            grown |= padded[i : i + cells.shape[0], j : j + cells.shape[1]]
    return grown


def _spread(heights: Floats) -> Floats:
    """Return heights with those of the surroundings where there is none."""
    known = np.isfinite(heights)
    filled = np.where(known, heights, np.nanmean(heights))
    for _ in range(_SMOOTHINGS):
        padded = np.pad(filled, 1, mode="edge")
        mean = (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 4
        filled = np.where(known, heights, mean)
    return filled


def _boxes(cells: Flags, longest: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield boxes that cover cells: the first cell and the one after the last along both axes."""
    growing: dict[tuple[int, int], int] = {}  # where the boxes of the row before begin
    for j in range(cells.shape[1] + 1):
        row = np.concatenate(([0], cells[:, j].astype(np.int8), [0])) if j < cells.shape[1] else np.zeros(1, np.int8)
        edges = np.flatnonzero(np.diff(row))
        runs = {
            (start, min(start + longest, last))
            for first, last in edges.reshape(-1, 2).tolist()
            for start in range(first, last, longest)
        }
        for run, begin in list(growing.items()):
            if run not in runs or j - begin >= longest:
                yield *run, begin, j
                del growing[run]
        for run in sorted(runs):
            growing.setdefault(run, j)
