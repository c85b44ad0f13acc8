"""The surfaces of the roads: lanes, kerbs, the slopes beside them, and what fills the gaps in junctions."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads.cells import LARGEST_GAP, NO_AREA, find_areas
from carla_recap.roads.opendrive import borders_at, limit_lanes, sparse_sections
from carla_recap.scene.materials import Material
from carla_recap.town.building import UP, TriangleGrid, smoothed, strip

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from carla_recap.roads.cells import Areas
    from carla_recap.roads.opendrive import Road, RoadLane, RoadSection, SparseSection
    from carla_recap.town.building import MeshBuilder
    from carla_recap.util.arrays import Booleans, Floats


KERB_HEIGHT: Final = 0.12
"""The height of sidewalks above the road, in m."""

PAVED: Final = (Material.ROAD, Material.SHOULDER, Material.PARKING, Material.BIKE_LANE)
"""The materials of lanes that are paved and not raised, outside junctions."""

_DRIVING: Final = (
    *("driving", "bidirectional", "entry", "exit", "onramp", "offramp", "connectingramp", "mwyentry", "mwyexit"),
    *("roadworks", "hov", "bus", "taxi"),
)
_KINDS: Final = {
    **dict.fromkeys(_DRIVING, Material.ROAD),
    **dict.fromkeys(("shoulder", "border", "stop", "restricted", "special1", "special2", "special3"), Material.SHOULDER),
    "parking": Material.PARKING,
    "biking": Material.BIKE_LANE,
    "median": Material.MEDIAN,
    **dict.fromkeys(("sidewalk", "walking"), Material.SIDEWALK),
    "curb": Material.KERB,
    **dict.fromkeys(("tram", "rail"), Material.GROUND),
}
_RAISED: Final = (Material.SIDEWALK, Material.KERB, Material.MEDIAN)
_LAYERS: Final = {
    Material.GRASS: -0.024,
    Material.GROUND: -0.016,
    Material.SHOULDER: -0.008,
    Material.PARKING: -0.008,
    Material.BIKE_LANE: -0.004,
}
"""How far flat surfaces are above the lanes for cars, in m, so that one hides the other where they overlap."""

_DENSE: Final = 1.0  # m between the points at which the course of a road is examined
_MOST_POINTS: Final = 400_000  # at which roads are examined
_MOST_PARTS: Final = 80_000  # of lanes, about; of longer roads, each part is longer
_MOST_LANES: Final = 10_000
_CROWDED: Final = 10.0  # m: the side of a square
_MOST_NEIGHBOURS: Final = 100_000_000  # pairs of such parts in the same square; CARLA's towns have up to a million
_NARROW: Final = 0.02  # m


@dataclass(frozen=True, eq=False)
class SampledSection:
    """The borders of the lanes of a section as points."""

    road: Road
    number: int  # the number of the road
    section: RoadSection
    stations: Floats  # the distances along the road, ascending, (n,)
    lefts: Floats  # the directions to the left, (n, 3)
    normals: Floats  # the directions away from the surface, (n, 3)
    offsets: Floats  # how far to the left of the reference line each border is, (lanes + 1, n)
    borders: Floats  # the points of the borders, from the left, (lanes + 1, n, 3)
    lanes: tuple[RoadLane, ...]  # the lanes, from the left
    materials: tuple[Material | None, ...]  # their materials; None for those that are not drawn

    @property
    def drawn(self) -> list[int]:
        """The lanes that are drawn."""
        return [lane for lane, material in enumerate(self.materials) if material is not None]

    def is_driving(self, lane: int) -> bool:
        """Return whether a lane is for cars."""
        return _KINDS.get(self.lanes[lane].kind) is Material.ROAD

    def widths(self, lane: int) -> Floats:
        """Return the width of a lane at each station."""
        widths: Floats = self.offsets[lane] - self.offsets[lane + 1]
        return widths

    def raised(self, lane: int) -> Floats:
        """Return how far the surface of a lane is above the road at each station; 0 where there is no such lane."""
        if not 0 <= lane < len(self.lanes):
            return np.zeros(len(self.stations))
        return np.where(self.widths(lane) > _NARROW, height_of(self.materials[lane]), 0.0)


def height_of(material: Material | None) -> float:
    """Return how far a surface is above the lanes for cars, in m."""
    if material is None:
        return 0.0
    return KERB_HEIGHT if material in _RAISED else _LAYERS.get(material, 0.0)


def sample_roads(roads: Sequence[Road]) -> list[SampledSection]:
    """Return the borders of all lanes as points, close together where roads bend, and without those of invalid roads.

    Raises:
        ValueError: The roads are too many for a town, or too many lie above each other.
    """
    limit_lanes(roads, _MOST_LANES)
    sections = [_sampled(part) for part in sparse_sections(roads, _DENSE, _MOST_POINTS, _MOST_PARTS)]
    sections = [section for section in sections if np.isfinite(section.borders).all()]
    _limit_crowd(sections)
    return sections


def _limit_crowd(sections: Sequence[SampledSection]) -> None:
    """Examine how many lanes lie above each other, or cross."""
    if not sections:
        return
    parts = np.concatenate([section.borders[1:, :-1, :2].reshape(-1, 2) for section in sections])
    _, counts = np.unique(np.floor(parts / _CROWDED), axis=0, return_counts=True)
    if (counts.astype(np.float64) ** 2).sum() > _MOST_NEIGHBOURS:
        raise ValueError(f"{counts.max():,} parts of lanes lie within {_CROWDED:.0f} m, more than in any town")


def _sampled(part: SparseSection) -> SampledSection:
    number, road, section, stations = part
    borders, offsets, lefts, headings = borders_at(road, section, stations)
    slopes = np.nan_to_num(np.gradient(borders[0, :, 2], stations), posinf=0.0, neginf=0.0)
    normals = np.stack((-slopes * np.cos(headings), -slopes * np.sin(headings), np.ones(len(slopes))), axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    materials = tuple(_materials(road, section.lanes))
    return SampledSection(road, number, section, stations, lefts, normals, offsets, borders, section.lanes, materials)


def _materials(road: Road, lanes: Sequence[RoadLane]) -> Iterator[Material | None]:
    kinds = [_KINDS.get(lane.kind) for lane in lanes]
    known = [index for index, kind in enumerate(kinds) if kind is not None]
    for index, kind in enumerate(kinds):
        inner = bool(known) and known[0] < index < known[-1]
        if kind is None and inner:
            around = {kinds[max(i for i in known if i < index)], kinds[min(i for i in known if i > index)]}
            kind = Material.GRASS if around <= {Material.ROAD} or not around <= {*PAVED} else Material.SHOULDER
            kind = Material.SHOULDER if road.in_junction else kind
        yield Material.JUNCTION if road.in_junction and kind in (Material.ROAD, Material.SHOULDER) else kind


def surface_grid(sections: Sequence[SampledSection]) -> TriangleGrid:
    """Return the surfaces of all lanes; the key is 0, or of pavement that is not raised, 1 in a junction and 2 outside."""
    return _grid(
        sections,
        lambda section, lane: (2 - section.road.in_junction) * (_KINDS.get(section.lanes[lane].kind) in PAVED),
    )


def driving_grid(sections: Sequence[SampledSection]) -> TriangleGrid:
    """Return the surfaces of lanes for cars; the key is the number of the road."""
    return _grid(sections, lambda section, lane: section.number if section.is_driving(lane) else None)


def _grid(sections: Sequence[SampledSection], key_of: Callable[[SampledSection, int], int | None]) -> TriangleGrid:
    vertices, triangles, keys, count = [], [], [], 0
    for section in sections:
        n = len(section.stations)
        for lane, material in enumerate(section.materials):
            key = key_of(section, lane)
            if material is None or key is None:
                continue
            corners = np.concatenate((section.borders[lane], section.borders[lane + 1]))
            corners[:, 2] += height_of(material)
            vertices.append(corners)
            triangles.append(strip(n, _wide(section, lane)) + count)
            keys.append(np.full(len(triangles[-1]), int(key)))
            count += 2 * n
    if not vertices:
        return TriangleGrid(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    return TriangleGrid(np.concatenate(vertices), np.concatenate(triangles), np.concatenate(keys))


def add_lanes(builder: MeshBuilder, sections: Sequence[SampledSection], driving: TriangleGrid) -> None:
    """Add the surfaces of lanes, and the kerbs beside raised ones."""
    for section in sections:
        for lane in section.drawn:
            material = section.materials[lane]
            assert material is not None
            height = height_of(material)
            wanted = _wide(section, lane)
            if height > 0 and section.road.in_junction:
                wanted &= ~_on_lanes(section, lane, driving)
            left, right = (section.borders[border] + (0.0, 0.0, height) for border in (lane, lane + 1))
            builder.add_strip(left, right, section.normals, material, wanted)
            if height > 0:
                _add_kerbs(builder, section, lane, wanted)


def _wide(section: SampledSection, lane: int) -> Booleans:
    wide = section.widths(lane) > _NARROW
    parts: Booleans = wide[1:] | wide[:-1]
    return parts


def _on_lanes(section: SampledSection, lane: int, driving: TriangleGrid) -> Booleans:
    """Return which parts of a lane are on lanes for cars of other roads."""
    middles = (section.borders[lane] + section.borders[lane + 1]) / 2
    middles = (middles[1:] + middles[:-1]) / 2
    return driving.covers(middles, other_than=section.number)


def _add_kerbs(builder: MeshBuilder, section: SampledSection, lane: int, wanted: Booleans) -> None:
    """Add the vertical faces of a raised lane on both sides and at its ends."""
    for border, beside, outwards in ((lane, lane - 1, section.lefts), (lane + 1, lane + 1, -section.lefts)):
        free = section.raised(beside) < KERB_HEIGHT / 2
        parts = wanted & (free[1:] | free[:-1])
        top = section.borders[border] + (0.0, 0.0, KERB_HEIGHT)
        bottom = section.borders[border] - (0.0, 0.0, KERB_HEIGHT)
        low, high = (top, bottom) if outwards is section.lefts else (bottom, top)
        builder.add_strip(high, low, outwards, Material.KERB, parts)
    edges = np.diff(np.concatenate(([False], wanted, [False])).astype(np.int8))
    for at, sign in [
        *((index, -1.0) for index in np.flatnonzero(edges > 0)),
        *((i, 1.0) for i in np.flatnonzero(edges < 0)),
    ]:
        left, right = section.borders[lane, at], section.borders[lane + 1, at]
        up = np.array((0.0, 0.0, KERB_HEIGHT))
        corners = np.array((left - up, right - up, right + up, left + up))[:: int(-sign)]
        builder.add_quads(corners[None], sign * np.cross(section.lefts[at], (0.0, 0.0, 1.0)), Material.KERB)


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
    """Fill the gaps between the lanes of each junction."""
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


def _gaps(empty: Booleans, on_road: Booleans, most: float) -> Booleans:
    """Return the cells of empty areas that are enclosed, not too large, and mostly beside pavement."""
    areas = find_areas(empty)
    wanted = areas.enclosed & (areas.sizes <= most) & (_shares_of_rims(areas, on_road) >= _ASPHALT)
    return areas.cells(wanted)


def _shares_of_rims(areas: Areas, on_road: Booleans) -> Floats:
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


def _squares(corners: Booleans) -> Booleans:
    """Return the squares of a grid of which all corners are set."""
    return corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:]


def _grown(cells: Booleans) -> Booleans:
    padded = np.pad(cells, 1)
    grown: Booleans = cells.copy()
    for i, j in product(range(3), repeat=2):
        grown |= padded[i : i + cells.shape[0], j : j + cells.shape[1]]
    return grown


def _spread(heights: Floats) -> Floats:
    """Return heights with those of the surroundings where there is none."""
    known = np.isfinite(heights)
    return smoothed(np.where(known, heights, np.nanmean(heights)), known, _SMOOTHINGS)


def _boxes(cells: Booleans, longest: int) -> Iterator[tuple[int, int, int, int]]:
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
