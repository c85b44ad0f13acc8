"""The ground around the roads: a grid of heights just below the roads, and the slopes from the roads down to it."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.materials import Material
from carla_recap.town.building import TILE, UP, interpolated, smoothed
from carla_recap.town.road_surfaces import KERB_HEIGHT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.town.building import MeshBuilder, TriangleGrid
    from carla_recap.town.road_surfaces import SampledSection
    from carla_recap.util.arrays import Booleans, Floats


_CELLS: Final = 5  # along a side of a tile
_AROUND: Final = 300.0  # m of ground around the roads
_MOST_TILES: Final = 240  # along a side
_MANY_TILES: Final = 6_000  # from which on there is ground near roads alone
_BELOW: Final = 0.08  # m from the road down to the ground
_FLAT: Final = 0.02  # m
_VERGE: Final = ((0.0, -0.03), (0.8, -0.09), (3.2, -1.0))  # m outwards, and up from the road
_SPAN: Final = 1.3  # m above the ground, from where on a road is a bridge
_DECK: Final = 0.8  # m
_PARAPET: Final = 0.5  # m
_SMOOTHINGS: Final = 8
_SAMPLES: Final = 2.0  # m


class Terrain:
    """The ground around roads."""

    def __init__(self, sections: Sequence[SampledSection]) -> None:
        lines = np.concatenate([section.borders[[0, -1]].reshape(-1, 3) for section in sections])
        low, high = lines[:, :2].min(axis=0) - _AROUND, lines[:, :2].max(axis=0) + _AROUND
        self._tile = TILE * max(1.0, float(np.ceil((high - low).max() / TILE / _MOST_TILES)))
        self._cell = self._tile / _CELLS
        self._origin = np.floor(low / self._tile) * self._tile
        self._tiles = np.ceil((high - self._origin) / self._tile).astype(np.int64)
        lowest = np.full(self._tiles * _CELLS, np.inf)
        for section in sections:
            points = _spread(section)
            cells = np.floor((points[:, :2] - self._origin) / self._cell).astype(np.int64)
            np.minimum.at(lowest, (cells[:, 0], cells[:, 1]), points[:, 2])
        self._wanted = self._near(np.isfinite(lowest))
        self._heights = _filled(_at_corners(lowest) - _BELOW)

    def heights(self, points: Floats) -> Floats:
        """Return the heights at points, (n, 2) or (n, 3)."""
        x, y = np.moveaxis((points[:, :2] - self._origin) / self._cell, 1, 0)
        i = np.clip(np.floor(x).astype(np.int64), 0, self._heights.shape[0] - 2)
        j = np.clip(np.floor(y).astype(np.int64), 0, self._heights.shape[1] - 2)
        u, v = np.clip(x - i, 0.0, 1.0), np.clip(y - j, 0.0, 1.0)
        h = self._heights
        heights: Floats = (1 - u) * ((1 - v) * h[i, j] + v * h[i, j + 1]) + u * ((1 - v) * h[i + 1, j] + v * h[i + 1, j + 1])
        return heights

    def _near(self, roads: Booleans) -> Booleans:
        """Return which tiles have ground: all, or in a wide town those near the cells that have roads."""
        columns, rows = self._tiles.tolist()
        near: Booleans = np.logical_or.reduce(roads.reshape(columns, _CELLS, rows, _CELLS), axis=(1, 3))
        if columns * rows <= _MANY_TILES:
            return np.ones_like(near)
        margin = int(np.ceil(_AROUND / self._tile))
        for axis, length in enumerate((columns, rows)):
            padded = np.pad(near, [(margin, margin) if axis == side else (0, 0) for side in (0, 1)])
            near = np.logical_or.reduce([padded.take(range(k, k + length), axis) for k in range(2 * margin + 1)])
        return near

    def add_to(self, builder: MeshBuilder) -> None:
        """Add the ground; flat tiles are one quadrangle."""
        tiles = np.argwhere(self._wanted).tolist()
        flat = np.ones(self._wanted.shape, np.bool_)
        for i, j in tiles:
            flat[i, j] = self._deviation(self._part(i, j)) < _FLAT
        for i, j in tiles:
            self._add_tile(builder, i, j, flat)

    def _part(self, i: int, j: int) -> Floats:
        return self._heights[i * _CELLS : (i + 1) * _CELLS + 1, j * _CELLS : (j + 1) * _CELLS + 1]

    @staticmethod
    def _deviation(part: Floats) -> float:
        """Return how far a part is from the plane triangles of its corners."""
        u = np.linspace(0.0, 1.0, len(part))
        sides = part[0, 0] + u[:, None] * (part[-1, 0] - part[0, 0]) + u[None] * (part[0, -1] - part[0, 0])
        twist = abs(part[0, 0] + part[-1, -1] - part[-1, 0] - part[0, -1])
        return float(np.abs(part - sides).max() + twist)

    def _add_tile(self, builder: MeshBuilder, i: int, j: int, flat: Booleans) -> None:
        heights = self._part(i, j)[:: _CELLS if flat[i, j] else 1, :: _CELLS if flat[i, j] else 1].copy()
        n = len(heights)
        if n > 2:  # no gaps beside flat tiles, whose sides are straight
            u = np.linspace(0.0, 1.0, n)
            for di, dj, side in ((-1, 0, np.s_[0]), (1, 0, np.s_[-1]), (0, -1, np.s_[:, 0]), (0, 1, np.s_[:, -1])):
                if not (0 <= i + di < flat.shape[0] and 0 <= j + dj < flat.shape[1]) or flat[i + di, j + dj]:
                    heights[side] = heights[side][0] + u * (heights[side][-1] - heights[side][0])
        x, y = (self._origin + (np.array((i, j)) * self._tile)).tolist()
        steps = np.linspace(0.0, self._tile, n)
        grid = np.stack((*np.meshgrid(x + steps, y + steps, indexing="ij"), heights), axis=2)
        gradients = (
            np.gradient(heights, steps[1]) if n > 2 else [np.gradient(heights, steps[1], axis=axis) for axis in (0, 1)]
        )
        normals = np.stack((-gradients[0], -gradients[1], np.ones_like(heights)), axis=2)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        index = np.arange(n * n).reshape(n, n)
        a, b, c, d = (part.reshape(-1) for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        triangles = np.concatenate((np.stack((a, b, c), 1), np.stack((a, c, d), 1)))
        builder.add(grid.reshape(-1, 3), normals.reshape(-1, 3), triangles, Material.GRASS)


def _spread(section: SampledSection) -> Floats:
    """Return points that cover a section."""
    count = max(int((section.stations[-1] - section.stations[0]) / _SAMPLES), 1) + 1
    stations = np.linspace(section.stations[0], section.stations[-1], count)
    drawn = section.drawn
    if not drawn:
        return np.zeros((0, 3))
    sides = [interpolated(stations, section.stations, section.borders[border]) for border in (drawn[0], drawn[-1] + 1)]
    across = int(min(np.linalg.norm(sides[0] - sides[1], axis=1).max() / _SAMPLES, 200)) + 2
    shares = np.linspace(0.0, 1.0, across)[:, None, None]
    points: Floats = (sides[0] + shares * (sides[1] - sides[0])).reshape(-1, 3)
    return points


def _at_corners(cells: Floats) -> Floats:
    """Return the lowest height of the cells around each corner of the grid."""
    padded = np.pad(cells, 1, constant_values=np.inf)
    corners: Floats = np.minimum(np.minimum(padded[:-1, :-1], padded[1:, :-1]), np.minimum(padded[:-1, 1:], padded[1:, 1:]))
    return corners


def _filled(heights: Floats) -> Floats:
    """Return heights without gaps, which are infinite before: smooth in between, level far outside."""
    known = np.isfinite(heights)
    return smoothed(_pyramid(np.where(known, heights, 0.0), known.astype(np.float64)), known, _SMOOTHINGS)


def _pyramid(sums: Floats, weights: Floats) -> Floats:
    """Return weighted means; where a cell has no weight, those of the larger cell around it."""
    means = sums / np.maximum(weights, 1e-12)
    if min(sums.shape) <= 1 or (weights > 0).all():
        overall = sums.sum() / max(weights.sum(), 1e-12)
        return np.where(weights > 0, means, overall)
    even = tuple(-(-side // 2) * 2 for side in sums.shape)
    padding = [(0, side - old) for side, old in zip(even, sums.shape, strict=True)]
    coarse = [np.pad(part, padding).reshape(even[0] // 2, 2, even[1] // 2, 2).sum(axis=(1, 3)) for part in (sums, weights)]
    around = _pyramid(coarse[0] / np.maximum(coarse[1], 1.0), np.minimum(coarse[1], 1.0))
    larger = np.repeat(np.repeat(around, 2, axis=0), 2, axis=1)[: sums.shape[0], : sums.shape[1]]
    return np.where(weights > 0, means, larger)


def add_edges(builder: MeshBuilder, sections: Sequence[SampledSection], terrain: Terrain, surfaces: TriangleGrid) -> None:
    """Add what is at the outer edges of roads: slopes down to the ground, or the sides and undersides of bridges."""
    for section in sections:
        drawn = section.drawn
        if not drawn:
            continue
        spans = []
        for lane, border, outwards in (
            (drawn[0], drawn[0], section.lefts),
            (drawn[-1], drawn[-1] + 1, -section.lefts),
        ):
            edge = section.borders[border]
            up = np.maximum(section.raised(lane), 0.0)
            high = edge[:, 2] - terrain.heights(edge) > _SPAN
            span = high[1:] | high[:-1]
            spans.append(span)
            free = ~surfaces.covers(edge + 0.6 * outwards, 0.5)
            free = free[1:] | free[:-1]
            _add_verge(builder, edge, outwards, up, free & ~span, surfaces)
            _add_side(builder, edge, outwards, up, span & free)
        span = spans[0] | spans[1]
        down = np.array((0.0, 0.0, _DECK))
        builder.add_strip(
            section.borders[drawn[-1] + 1] - down, section.borders[drawn[0]] - down, -UP, Material.BRIDGE, span
        )


def _add_verge(
    builder: MeshBuilder, edge: Floats, outwards: Floats, up: Floats, wanted: Booleans, surfaces: TriangleGrid
) -> None:
    if not wanted.any():
        return
    lines: list[Floats] = []
    for number, (out, rise) in enumerate(_VERGE):
        line = edge + out * outwards
        line[:, 2] += rise + (up if number == 0 else 0.0)
        if number:
            index, heights, _ = surfaces.hits(line)
            above = np.zeros(len(line), np.bool_)  # a lower road, on which the slope would be
            above[index[(heights < line[index, 2] + 0.05) & (heights > line[index, 2] - 3.0)]] = True
            line[above, :2] = lines[-1][above, :2]
        lines.append(line)
    for inner, outer in pairwise(lines):
        slope = inner - outer
        across = np.linalg.norm(slope[:, :2], axis=1)
        normals = outwards * slope[:, 2:] + UP * np.maximum(across, 0.01)[:, None]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        left, right = (outer, inner) if _is_left(edge, outwards) else (inner, outer)
        builder.add_strip(left, right, normals, Material.GRASS, wanted)


def _add_side(builder: MeshBuilder, edge: Floats, outwards: Floats, up: Floats, wanted: Booleans) -> None:
    """Add the side of a bridge, with a parapet."""
    if not wanted.any():
        return
    top = edge + np.stack((0 * up, 0 * up, up + _PARAPET), axis=1)
    outer = top + 0.2 * outwards
    bottom = edge + 0.2 * outwards - (0.0, 0.0, _DECK)
    foot, under = (edge - (0.0, 0.0, depth) for depth in (KERB_HEIGHT, _DECK))
    for upper, lower, normals in ((top, foot, -outwards), (outer, top, UP), (bottom, outer, outwards), (under, bottom, -UP)):
        left, right = (upper, lower) if _is_left(edge, outwards) else (lower, upper)
        builder.add_strip(left, right, normals, Material.BRIDGE, wanted)


def _is_left(edge: Floats, outwards: Floats) -> bool:
    """Return whether an edge is on the left of a road."""
    return bool(np.cross(outwards[0], UP) @ (edge[-1] - edge[0]) > 0)
