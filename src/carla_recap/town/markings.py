"""What is painted on the roads: lines, crossings, stop lines, arrows; and the shapes of arrows, digits and letters."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.roads.stop_lines import drawn_stop_lines
from carla_recap.scene.materials import Material
from carla_recap.town.building import UP, interpolated
from carla_recap.town.road_surfaces import PAVED

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.opendrive import Marking, Road, RoadObject
    from carla_recap.town.building import MeshBuilder, TriangleGrid
    from carla_recap.town.road_surfaces import SampledSection
    from carla_recap.util.arrays import Booleans, Floats


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
_DASH: Final = 3.0  # m
_PERIOD: Final = 9.0  # m from dash to dash
_LIFT: Final = 0.010  # m above the road
_CROSSING_LIFT: Final = 0.014
_STOP_LIFT: Final = 0.018
_FROM_EDGE: Final = 0.12  # m from a line to a kerb or to the edge of the asphalt
_NARROW: Final = 0.25  # m; the outer border of a narrower lane is not marked
_INSPECTED: Final = 4.0  # m between points that may be on lanes of other roads
_MOST_FINE: Final = 80_000  # such points of all lines together
_FINE: Final = 0.5  # m between the points of a line, of which a part may be on other lanes
_BESIDE: Final = 0.25  # m
_SAME_LINE: Final = 0.5  # m between lines of two roads, of which one is drawn
_SHORTEST: Final = 1.6  # m of a part of a line in a junction
_TOUCH: Final = 1e-6  # m
_BAR: Final = 0.5  # m; of a crossing
_BARS: Final = 1.1  # m from bar to bar
_MOST_BARS: Final = 200
_STOP_DEPTH: Final = 0.4  # m
_BEFORE_JUNCTION: Final = 0.3  # m from a stop line to a junction
_SHORTEST_STOP: Final = 1.0  # m; shorter stop lines that the map does not paint are not drawn
_SPAN: Final = 2.0  # m between the points of long shapes, which follow the road
_PAVED: Final = (*PAVED, Material.JUNCTION)
_YELLOW: Final = ("yellow", "orange")


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
    """Return an arrow on a road as polygons, (n, 2): forward and to the left, counterclockwise."""
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


class _Line(NamedTuple):
    """Parts of a line on a road, each a quadrangle."""

    corners: Floats
    material: Material
    section: SampledSection


def add_lines(builder: MeshBuilder, sections: Sequence[SampledSection], driving: TriangleGrid) -> None:
    """Add the lines along the borders of lanes, without those across lanes of other roads."""
    crowded = _are_crowded(sections, driving)
    fine = np.cumsum(
        [len(each.lanes) * np.ptp(each.stations) / _FINE * is_so for each, is_so in zip(sections, crowded, strict=True)]
    )
    crowded = [is_so and count <= _MOST_FINE for is_so, count in zip(crowded, fine, strict=True)]
    lines = [line for section, fine in zip(sections, crowded, strict=True) for line in _lines(section, fine=fine)]
    if not lines:
        return
    sizes = [len(line.corners) for line in lines]
    corners = np.concatenate([line.corners for line in lines])
    owners, materials, inside = (
        np.repeat(column, sizes)
        for column in (
            [line.section.number for line in lines],
            [line.material for line in lines],
            [line.section.road.in_junction for line in lines],
        )
    )
    sides = _on_others(corners, owners, driving)
    # Of lines side by side, that of a junction is left out, or else that on a lane of the other road.
    repeated = _repeated(corners, owners + inside * (owners.max() + 1), materials) & (inside | sides.any(axis=0))
    left_out = sides.all(axis=0) | repeated
    for line, part in zip(lines, np.split(~left_out, np.cumsum(sizes)[:-1]), strict=True):
        kept = part if part.all() else _long(line.corners, part)
        builder.add_quads(line.corners[kept], UP, line.material)


def _are_crowded(sections: Sequence[SampledSection], driving: TriangleGrid) -> list[bool]:
    """Return whether each section is in a junction, or shares ground with lanes of other roads, but at its ends."""
    borders = [_inner(section) for section in sections]
    points = np.concatenate(borders)
    owners = np.repeat(np.arange(len(sections)), [len(border) for border in borders])
    numbers = np.array([section.number for section in sections])
    crowded = np.array([section.road.in_junction for section in sections])
    crowded[owners[driving.covers(points, other_than=numbers[owners])]] = True
    return [bool(each) for each in crowded]


def _inner(section: SampledSection) -> Floats:
    """Return points of the borders of a section, not at its ends, (n, 3)."""
    start, end = section.stations[[0, -1]]
    margin = min(1.0, (end - start) / 4)
    stations = np.linspace(start + margin, end - margin, int((end - start) / _INSPECTED) + 2)
    return np.concatenate([interpolated(stations, section.stations, border) for border in section.borders])


def _repeated(corners: Floats, owners: NDArray[np.int64], materials: NDArray[np.uint8]) -> Booleans:
    """Return which quadrangles are beside one of the same material of a road with a lower number."""
    x, y, z = (np.rint(corners.mean(axis=1) / _SAME_LINE).astype(np.int64) & 0x3FFFFF).T
    cells = (x << 40) | (y << 18) | ((z & 0xFFF) << 6) | materials
    around = np.array([(i << 40) + (j << 18) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    every = np.concatenate((cells, (cells[:, None] + around).reshape(-1)))
    _, numbers = np.unique(every, return_inverse=True)
    lowest = np.full(numbers.max() + 1, np.iinfo(np.int64).max)
    np.minimum.at(lowest, numbers[: len(cells)], owners)
    repeated: Booleans = lowest[numbers[len(cells) :].reshape(-1, len(around))].min(axis=1) < owners
    return repeated


def _long(corners: Floats, kept: Booleans) -> Booleans:
    """Return which of the quadrangles kept are in a row that is not too short."""
    joined = kept[1:] & kept[:-1] & (np.abs(corners[1:, 0] - corners[:-1, 1]).max(axis=1) < _TOUCH)
    rows = np.cumsum(np.concatenate(([True], ~joined)))
    lengths = np.bincount(rows, np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    long: Booleans = kept & (lengths[rows] > _SHORTEST)
    return long


def _on_others(corners: Floats, owners: NDArray[np.int64], driving: TriangleGrid) -> Booleans:
    """Return whether lanes of other roads are on each side of quadrangles, (2, n)."""
    middles = corners.mean(axis=1)
    aside = (corners[:, 3] - corners[:, 0])[:, :2]
    aside *= _BESIDE / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-6)
    covered = np.zeros((2, len(corners)), np.bool_)
    for side, sign in enumerate((1, -1)):
        points = middles.copy()
        points[:, :2] += sign * aside
        covered[side] = driving.covers(points, other_than=owners)
    return covered


def _lines(section: SampledSection, *, fine: bool) -> Iterator[_Line]:
    inner = len(section.section.left)
    for border in range(len(section.lanes) + 1):
        lane = section.section.centre if border == inner else section.lanes[border if border < inner else border - 1]
        if lane is None:
            continue
        wide = np.ones(len(section.stations), np.bool_)
        if border != inner:
            wide = section.widths(border if border < inner else border - 1) > _NARROW
        for number, mark in enumerate(lane.markings):
            start = section.section.start + mark.start
            end = section.section.end
            if number + 1 < len(lane.markings):
                end = min(end, section.section.start + lane.markings[number + 1].start)
            if end - start > _BESIDE:
                yield from _painted(section, border, mark, start, end, wide, reverse=border < inner, fine=fine)


def _painted(
    section: SampledSection,
    border: int,
    mark: Marking,
    start: float,
    end: float,
    wide: Booleans,
    *,
    reverse: bool,
    fine: bool,
) -> Iterator[_Line]:
    """Yield the lines of a marking."""
    styles = [style for style in mark.kind.replace("botts dots", "broken").split() if style in ("solid", "broken")][:2]
    if not styles:
        return
    shift = _shift(section, border, mark.width / 2 if len(styles) == 1 else 1.5 * mark.width)
    if shift is None:
        return
    material = Material.YELLOW_LINE if mark.color in _YELLOW else Material.WHITE_LINE
    asides = (0.0,) if len(styles) == 1 else (mark.width, -mark.width)  # from the left
    for style, aside in zip(styles[::-1] if reverse else styles, asides, strict=True):
        spacing = _FINE if fine else None
        corners = _quads(section, border, style, start, end, wide, shift + aside, mark.width / 2, spacing)
        if len(corners):
            yield _Line(corners, material, section)


def _shift(section: SampledSection, border: int, half: float) -> float | None:
    """Return how far to the left a line is drawn so that it is on the asphalt; None if none is beside it."""
    paved = [_is_paved(section, lane) for lane in (border - 1, border)]
    if all(paved):
        return 0.0
    if not any(paved):
        return None
    return (half + _FROM_EDGE) * (1 if paved[0] else -1)


def _is_paved(section: SampledSection, lane: int) -> bool:
    """Return whether there is pavement where a lane is; beside a road of a junction there are other roads."""
    material = section.materials[lane] if 0 <= lane < len(section.lanes) else None
    return material in _PAVED or (material is None and section.road.in_junction)


def _quads(
    section: SampledSection,
    border: int,
    style: str,
    start: float,
    end: float,
    wide: Booleans,
    shift: float,
    half: float,
    spacing: float | None,
) -> Floats:
    """Return the quadrangles of a line, (n, 4, 3), which are no longer than the spacing."""
    known = section.stations
    stations = [np.array((start, end)), known]
    if spacing is not None:
        stations.append(np.arange(start, end, spacing))
    length = section.road.length
    period = length / max(round(length / _PERIOD), 1)
    if style == "broken":
        if length < _PERIOD / 2:
            return np.zeros((0, 4, 3))
        numbers = np.arange(np.floor(start / period), np.ceil(end / period) + 1)
        stations += [(numbers + 0.5) * period + side * _DASH / 2 for side in (-1, 1)]
    found = np.unique(np.concatenate(stations))
    found = found[(found >= max(start, known[0])) & (found <= min(end, known[-1]))]
    if len(found) < 2:
        return np.zeros((0, 4, 3))
    middles = (found[1:] + found[:-1]) / 2
    kept = np.interp(middles, known, wide.astype(np.float64)) > 0.5
    if style == "broken":
        kept &= np.abs(middles % period - period / 2) < _DASH / 2
    points, lefts = interpolated(found, known, section.borders[border]), interpolated(found, known, section.lefts)
    left, right = points + (shift + half) * lefts, points + (shift - half) * lefts
    corners: Floats = np.stack((right[:-1], right[1:], left[1:], left[:-1]), axis=1)[kept]
    corners[..., 2] += _LIFT
    return corners


class Painter:
    """Paints flat shapes on the ground."""

    def __init__(self, builder: MeshBuilder, ground: TriangleGrid) -> None:
        self._builder = builder
        self._ground = ground
        self._shapes: dict[tuple[Material, float], list[Floats]] = {}

    def paint(self, corners: Floats, material: Material, lift: float) -> None:
        """Paint a convex polygon, (n, 3), its corners counterclockwise; z is about that of the ground."""
        self._shapes.setdefault((material, lift), []).append(corners)

    def finish(self) -> None:
        """Add the shapes that are on the ground as a whole."""
        for (material, lift), shapes in self._shapes.items():
            sizes = [len(shape) for shape in shapes]
            corners = np.concatenate(shapes)
            corners[:, 2] = self._ground.highest(corners + np.array((0.0, 0.0, _SPAN / 2))) + lift
            for shape in np.split(corners, np.cumsum(sizes)[:-1]):
                if np.isfinite(shape).all():
                    self._builder.add_polygon(shape, UP, material)


def paint_objects(painter: Painter, road: Road) -> None:
    """Paint the crossings, arrows and words of a road."""
    for thing in road.objects:
        if thing.kind == "crosswalk":
            _paint_crossing(painter, road, thing)
        elif thing.name.startswith("Stencil_"):
            point, heading = road.at(thing.station, thing.offset)
            for shape in arrow(thing.name) if "Arrow" in thing.name else glyphs(thing.name[8:], 2.4, 2.2):
                painter.paint(_placed(shape, point, heading + thing.heading), Material.WHITE_LINE, _CROSSING_LIFT)


def _placed(shape: Floats, point: Floats, heading: float) -> Floats:
    """Return a shape, (n, 2), forward and to the left, at a point, (n, 3)."""
    cos, sin = np.cos(heading), np.sin(heading)
    turned = shape @ np.array(((cos, sin), (-sin, cos)))
    return np.column_stack((turned + point[:2], np.full(len(shape), point[2])))


def _paint_crossing(painter: Painter, road: Road, crossing: RoadObject) -> None:
    point, heading = road.at(crossing.station, crossing.offset)
    outline = road.outline(crossing)
    if len(outline) > 1 and np.allclose(outline[0], outline[-1], atol=0.01):
        outline = outline[:-1]
    if len(outline) < 3:
        half = np.array((crossing.length, crossing.width)) / 2
        outline = half * ((-1, -1), (1, -1), (1, 1), (-1, 1))
    sides = np.roll(outline, -1, axis=0) - outline
    lengths = np.linalg.norm(sides, axis=1)
    if not 0.5 < lengths.max() < _MOST_BARS * _BARS:
        return
    along = sides[lengths.argmax()] / lengths.max()  # the direction of pedestrians
    frame = np.array((along, (-along[1], along[0])))
    outline = outline @ frame.T
    if _area(outline) < 0:
        outline = outline[::-1]
    low, high = outline[:, 0].min(), outline[:, 0].max()
    count = max(int((high - low) / _BARS + 0.5), 1)
    for middle in low + (np.arange(count) + 0.5) * (high - low) / count:
        bar = _clipped(_clipped(outline, middle - _BAR / 2, 1), middle + _BAR / 2, -1)
        if len(bar) > 2:
            for part in _split(bar):
                painter.paint(_placed(part @ frame, point, heading + crossing.heading), Material.CROSSING, _CROSSING_LIFT)


def _clipped(polygon: Floats, limit: float, sign: int) -> Floats:
    """Return the part of a convex polygon with x above a limit, or below if the sign is negative."""
    corners = []
    for index, corner in enumerate(polygon):
        following = polygon[(index + 1) % len(polygon)]
        inside, next_inside = sign * (corner[0] - limit), sign * (following[0] - limit)
        if inside >= 0:
            corners.append(corner)
        if inside * next_inside < 0:
            corners.append(corner + inside / (inside - next_inside) * (following - corner))
    return np.array(corners).reshape(-1, 2)


def _split(bar: Floats) -> Iterator[Floats]:
    """Yield the parts of a bar along y, so that it follows the road."""
    flipped = bar[:, ::-1]
    low, high = bar[:, 1].min(), bar[:, 1].max()
    count = max(int((high - low) / _SPAN), 1)
    for index in range(count):
        limits = low + (high - low) * np.array((index, index + 1)) / count
        part = _clipped(_clipped(flipped, limits[0], 1), limits[1], -1)
        if len(part) > 2:
            yield part[:, ::-1]


def _paint_stop_line(painter: Painter, start: Floats, stop: Floats) -> None:
    length = float(np.linalg.norm(stop - start))
    if not 0.2 < length < 60.0:
        return
    along = (stop - start) / length
    aside = np.array((-along[1], along[0], 0.0)) * _STOP_DEPTH / 2
    start, stop = start + 0.1 * along, stop - 0.1 * along
    points = np.linspace(start, stop, max(int(length / _SPAN), 1) + 1)
    for first, last in pairwise(points):
        painter.paint(np.array((first - aside, last - aside, last + aside, first + aside)), Material.STOP_LINE, _STOP_LIFT)


def paint_stops(painter: Painter, roads: Sequence[Road]) -> None:
    """Paint the stop lines of the map, and one on each lane with a light or stop sign that has none."""
    painted, others = drawn_stop_lines(roads)
    for start, stop in painted:
        _paint_stop_line(painter, start, stop)
    for start, stop in others:
        across = stop - start
        length = float(np.linalg.norm(across))
        if length > _SHORTEST_STOP:
            back = np.array((across[1], -across[0], 0.0)) / length * (_BEFORE_JUNCTION + _STOP_DEPTH / 2)
            _paint_stop_line(painter, start + back, stop + back)
