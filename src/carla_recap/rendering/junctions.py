"""The gaps between the lanes of junctions, filled."""

from __future__ import annotations

from collections import defaultdict
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.building import UP
from carla_recap.roads.cells import LARGEST_GAP, NO_AREA, find_areas
from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.building import MeshBuilder
    from carla_recap.rendering.heights import TriangleGrid
    from carla_recap.rendering.surfaces import SampledSection
    from carla_recap.roads.cells import Areas

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

FILLED: Final = -0.012
"""The height of what fills gaps, relative to the lanes, in m."""

_CELL: Final = 0.5  # m
_MARGIN: Final = 3  # cells
_MOST_CELLS: Final = 360_000  # of a junction
_MOST_CELLS_OF_ALL: Final = 6_000_000  # of all junctions, about
_ASPHALT: Final = 0.6  # the share of pavement around a gap that is filled
_LONGEST: Final = 8  # cells of a quadrangle
_FLAT: Final = 0.005  # m
_SMOOTHINGS: Final = 40


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
    most = min(_MOST_CELLS, _MOST_CELLS_OF_ALL / max(len(junctions), 1))
    for lines in junctions.values():
        points = np.concatenate(lines)
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        cell = max(_CELL, float((high - low).max()) / np.sqrt(most))
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
    wanted = _grown(_grown(_gaps(empty, on_road, LARGEST_GAP / cell**2)))  # as far as below the lanes
    wanted |= ~_grown(~_grown(on_road))  # narrow gaps, too
    if float(np.ptp(heights[on_road])) < _FLAT:
        z, longest = np.full(on_road.shape, heights[on_road].min()), max(columns, rows)
    else:
        z, longest = _spread(np.where(on_road, heights, np.nan)), _LONGEST
    full = _squares(wanted) & ~_squares(elsewhere)
    boxes = [
        [(x[i, k], y[i, k], z[i, k] + FILLED) for i, k in ((first, low), (last, low), (last, high), (first, high))]
        for first, last, low, high in _boxes(full, longest)
    ]
    if boxes:
        builder.add_quads(np.array(boxes), UP, Material.JUNCTION)


def _gaps(empty: Flags, on_road: Flags, most: float) -> Flags:
    """Return the cells of empty areas that are enclosed, not too large, and mostly beside pavement."""
    areas = find_areas(empty)
    wanted = areas.enclosed & (areas.sizes <= most) & (_shares_of_rims(areas, on_road) >= _ASPHALT)
    return areas.cells(wanted)


def _shares_of_rims(areas: Areas, on_road: Flags) -> Floats:
    """Return which share of the cells beside each area is on the road."""
    padded = np.pad(areas.numbers, 1, constant_values=NO_AREA)
    columns, rows = on_road.shape
    cells = np.arange(on_road.size).reshape(on_road.shape)
    beside = []
    for dx, dy in product((0, 1, 2), repeat=2):
        area = padded[dx : dx + columns, dy : dy + rows]
        other = (area != NO_AREA) & (area != areas.numbers)
        beside.append(area[other] * on_road.size + cells[other])
    area, cell = np.divmod(np.unique(np.concatenate(beside)), on_road.size)
    counts = np.bincount(area, minlength=len(areas.sizes))
    shares: Floats = np.bincount(area, on_road.ravel()[cell], len(areas.sizes)) / np.maximum(counts, 1)
    return shares


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
