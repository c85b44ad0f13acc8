"""The lanes for cars, and the index that finds them: m and radians, in CARLA's axes, for many locations at once."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from carla_recap.roads.cells import BoxGrid, least
from carla_recap.roads.lanes import NO_JUNCTION
from carla_recap.roads.polylines import stations

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.util.arrays import Floats, Integers

    Turn = Literal["straight", "left", "right"]

NO_LANE: Final = -1
"""The index where there is no lane."""
_SPACING: Final = 1.0  # m between points
DEFAULT_LIMIT: Final = 30 / 3.6  # m/s: CARLA's, where a map says nothing
_BEND: Final = np.radians(35)  # what bends less goes straight on
_TO_LEFT_HANDED: Final = np.array((1.0, -1, 1, -1, 1, 1))
_SHORTEST: Final = 1e-3  # m: so that one may divide by lengths
_CELL: Final = 4.0  # m: no nearest lane is farther than that from a vehicle on a road
_AGAINST: Final = 32.0  # m²: what it costs to drive against a lane's direction
_STOREY: Final = 4.0  # a metre above or below a lane counts as two beside it
_STEPS: Final = 8  # at most, from a hint to the nearest point of a lane
_TERRAIN: Final = 2.0  # m: the side of a cell of the table of heights
_MOST_CELLS: Final = 500  # along a side of that table
_LEVEL_GAP: Final = 3.5  # m: roads that differ by more in height are on different levels
_LEVEL_REACH: Final = 10.0  # m: how far beside the middle of a lane its level is known where levels overlap
_UNDER: Final = 1.0  # m: a vehicle this far below the surface of a road still stands on it


@dataclass(frozen=True, eq=False, slots=True)
class Lane:
    """A lane for cars along a section of a road, as driven.

    Attributes:
        reverse: Whether the direction of travel is against that of the road.
        points: The points of its middle in the direction of travel, evenly spaced, about 1 m apart, (n, 3).
        s: The distances of the points along the lane, (n,).
        heading: The directions of travel at the points, (n,); continuous, so that they may leave ±π.
        width: The width halfway, in m.
        limits: The speed limits at the points in m/s, (n,).
        successors: The lanes that begin where it ends.
        left: At each point, the lane of the same direction on the left, if the markings there allow to change to it, or
            `NO_LANE`, (n,).
        junction: The id of the junction that it lies in; None outside of junctions.
    """

    index: int
    road_id: int
    section: int
    lane_id: int
    reverse: bool
    points: Floats
    s: Floats
    heading: Floats
    width: float
    limits: Floats
    successors: tuple[int, ...]
    predecessors: tuple[int, ...]
    left: Integers
    right: Integers
    junction: int | None
    turn: Turn

    @property
    def keeps_left(self) -> bool:
        """Whether traffic keeps left on its road."""
        return self.reverse == (self.lane_id < 0)

    @property
    def length(self) -> float:
        """The length in m."""
        return float(self.s[-1])


def make_lanes(courses: Sequence[LaneGeometry]) -> list[Lane]:
    """Return lanes for cars, at the indices of their courses; ValueError: there is none, or a coordinate is not finite."""
    if not courses:
        raise ValueError("no lane for cars is in it")
    index = {(course.road, course.section, course.id): number for number, course in enumerate(courses)}
    after = [sorted({index[name] for name in course.successors if name in index}) for course in courses]
    before = defaultdict(list)
    for number, following in enumerate(after):
        for other in following:
            before[other].append(number)
    lanes = [_lane(number, course, after[number], before[number], index) for number, course in enumerate(courses)]
    _complete_limits(lanes)
    return lanes


def _lane(
    number: int, course: LaneGeometry, after: list[int], before: list[int], index: Mapping[tuple[int, int, int], int]
) -> Lane:
    rows = _rows(course)
    length = max(float(np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1).sum()), _SHORTEST)
    bend = rows[-1, 3] - rows[0, 3]
    is_straight = course.junction == NO_JUNCTION or abs(bend) < _BEND
    to_right = 1 if course.reverse else -1  # numbers ascend to the left of the road's own direction
    beside = [index.get((course.road, course.section, course.id + step), NO_LANE) for step in (-to_right, to_right)]
    allowed = np.array([course.allowed(station).changes for station in rows[:, 5].tolist()])
    left, right = np.where(allowed, beside, NO_LANE).T
    return Lane(
        index=number,
        road_id=course.road,
        section=course.section,
        lane_id=course.id,
        reverse=course.reverse,
        points=rows[:, :3].copy(),
        s=np.linspace(0, length, len(rows)),
        heading=rows[:, 3].copy(),
        width=float(rows[len(rows) // 2, 4]),
        limits=course.limits[np.searchsorted(course.stations, rows[:, 5], "right") - 1],
        successors=tuple(after),
        predecessors=tuple(before),
        left=left,
        right=right,
        junction=None if course.junction == NO_JUNCTION else course.junction,
        turn="straight" if is_straight else "right" if bend > 0 else "left",
    )


def _rows(course: LaneGeometry) -> Floats:
    """Return evenly spaced rows of x, y, z, heading, width and station in the direction of travel, in CARLA's axes."""
    width = np.linalg.norm(course.left - course.right, axis=1)
    rows: Floats = np.column_stack((course.centre, np.unwrap(course.headings), width, course.stations)) * _TO_LEFT_HANDED
    if course.reverse:
        rows = rows[::-1]
    at = stations(rows[:, :3])
    if not np.isfinite(rows).all():
        raise ValueError("a lane has places that are no numbers")
    even = np.linspace(0, at[-1], max(int(np.ceil(at[-1] / _SPACING)), 1) + 1)
    spaced: Floats = np.stack([np.interp(even, at, column) for column in rows.T], axis=1)
    return spaced


def _complete_limits(lanes: Sequence[Lane]) -> None:
    """Set the speed limits that a map does not say: the one before on the same lane, or on one that leads to it.

    Without one, the limit is the default.
    """
    known = []
    for lane in lanes:
        latest = np.maximum.accumulate(np.where(np.isfinite(lane.limits), np.arange(len(lane.limits)), 0))
        lane.limits[:] = lane.limits[latest]
        if np.isfinite(lane.limits[-1]):
            known.append(lane)
    for lane in known:  # grows
        for other in (lanes[index] for index in lane.successors):
            unknown = np.isnan(other.limits)
            if unknown[-1]:
                known.append(other)
            other.limits[unknown] = lane.limits[-1]
    for lane in lanes:
        lane.limits[np.isnan(lane.limits)] = DEFAULT_LIMIT


class LaneIndex:
    """Finds the lanes at locations, and the locations of lanes.

    Attributes:
        points: The points of all lanes, one after another, (n, 3), with directions of travel, speed limits in m/s and
            lanes of each, (n,).
        first: The first point of each lane, (lanes,), with the number of its points, their spacing, and its length.
        has_levels: Whether some lanes are above others.
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.points = np.concatenate([lane.points for lane in lanes])
        self.heading = np.concatenate([lane.heading for lane in lanes])
        self.limits = np.concatenate([lane.limits for lane in lanes])
        self.count = np.array([len(lane.points) for lane in lanes])
        self.first = np.cumsum(self.count) - self.count
        self.lane_of = np.repeat(np.arange(len(lanes)), self.count)
        self.length = np.array([lane.length for lane in lanes])
        self.spacing = self.length / (self.count - 1)
        self._flat = np.ascontiguousarray(self.points[:, :2])
        self._ahead = np.stack((np.cos(self.heading), np.sin(self.heading)), axis=1)
        self._before = np.repeat(self.spacing, self.count) / 2
        self._after = self._before.copy()
        self._before[self.first] = 0
        self._after[self.first + self.count - 1] = 0
        self._slope = np.concatenate([np.gradient(lane.points[:, 2], lane.s) for lane in lanes])
        self._grid = BoxGrid(self._flat, self._flat, _CELL, _CELL)
        self._terrain = _Terrain(self._flat)
        self._levels = _Levels(self.points, self._nearest)
        self.has_levels = not self._levels.is_empty
        heights = self.points[:, 2]
        self._level = float(heights[0]) if np.ptp(heights) == 0 else None

    def at(self, lane: ArrayLike, s: ArrayLike) -> tuple[Floats, Floats]:
        """Return locations, (k, 3), and directions of travel, (k,), at distances along lanes; beyond the ends, of those."""
        point, share = self.steps(np.asarray(lane), np.asarray(s, np.float64))
        place = self.points[point] + share[:, None] * (self.points[point + 1] - self.points[point])
        return place, self.heading[point] + share * (self.heading[point + 1] - self.heading[point])

    def limit(self, lane: Integers, s: Floats) -> Floats:
        """Return the speed limits at some distances along lanes, in m/s."""
        limit: Floats = self.limits[self.steps(lane, s)[0]]
        return limit

    def steps(self, lane: Integers, s: Floats) -> tuple[Integers, Floats]:
        """Return the points before some distances along lanes, and the shares of the way to the next ones."""
        last = self.count[lane] - 1
        steps = np.minimum(np.maximum(s / self.spacing[lane], 0), last)
        whole = np.minimum(steps.astype(np.int64), last - 1)
        return self.first[lane] + whole, steps - whole

    def project(self, lane: ArrayLike, x: ArrayLike, y: ArrayLike, s_hint: ArrayLike) -> tuple[Floats, Floats]:
        """Return the distances of locations along lanes, and their lateral offsets, positive to the right, (k,) each.

        A lane goes on straight before its beginning and after its end, where distances are below 0 and above its length. The
        hints are distances to within some metres; the nearer, the faster.
        """
        lane = np.asarray(lane)
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        first, spacing, last = self.first[lane], self.spacing[lane], self.count[lane] - 2
        segment = np.clip(np.floor(np.asarray(s_hint) / spacing), 0, last).astype(np.int64)
        for _ in range(_STEPS):
            share, right = self._onto(first + segment, x, y)
            following = np.clip(segment + np.floor(share), 0, last).astype(np.int64)
            if np.array_equal(following, segment):
                break
            segment = following
        share, right = self._onto(first + segment, x, y)
        share = np.clip(share, np.where(segment == 0, -np.inf, 0), np.where(segment == last, np.inf, 1))
        return (segment + share) * spacing, right

    def nearest_lane(
        self, x: ArrayLike, y: ArrayLike, *, z: ArrayLike | None = None, heading: ArrayLike | None = None
    ) -> tuple[Integers, Floats]:
        """Return the indices of the lanes nearest to some locations, and the distances along them, (k,) each.

        Their z distinguish the lanes of a bridge from those below it. Lanes in other directions than the headings count as
        farther away.
        """
        places = np.stack((np.asarray(x, np.float64), np.asarray(y, np.float64)), axis=-1)
        best = self._terrain.nearest(places)
        for query, point in self._grid.pairs(places):
            away = places[query] - self._flat[point]
            along = (away * self._ahead[point]).sum(axis=1)
            beyond = np.maximum(along - self._after[point], -along - self._before[point])
            cost = (away**2).sum(axis=1) - along**2 + np.maximum(beyond, 0) ** 2
            if z is not None:
                cost += _STOREY * (self.points[point, 2] - np.asarray(z, np.float64)[query]) ** 2
            if heading is not None:
                cost += _AGAINST / 2 * (1 - np.cos(self.heading[point] - np.asarray(heading, np.float64)[query]))
            winners = least(query, cost)
            best[query[winners]] = point[winners]
        lane = self.lane_of[best]
        s, _ = self.project(lane, places[:, 0], places[:, 1], (best - self.first[lane]) * self.spacing[lane])
        return lane, np.clip(s, 0, self.length[lane])

    def height(self, x: ArrayLike, y: ArrayLike, z: ArrayLike | None = None) -> Floats:
        """Return the height of the road near some locations, (k,).

        Of several roads above each other, the highest one counts that is not above z, that of the actor, or else the lowest;
        without it, any of them may count.
        """
        if self._level is not None:
            return np.full(np.shape(x), self._level)
        places = np.array((x, y), np.float64).T
        height = self._height_by(self._nearest(places), places)
        if z is None or not self.has_levels:
            return height
        some, levels = self._levels.near(places)
        if len(some):
            below = np.asarray(z, np.float64)[some] + _UNDER
            heights = self._height_by(levels, places[some, None])
            heights[levels < 0] = np.inf
            best = np.where(heights <= below[:, None], heights, -np.inf).max(axis=1)
            height[some] = np.where(best == -np.inf, heights.min(axis=1), best)
        return height

    def _nearest(self, places: Floats) -> Integers:
        """Return a point near each location, (k, 2): on a large map, the nearest one, if it is within `_CELL`."""
        best = self._terrain.nearest(places)
        if self._terrain.is_coarse:
            for query, point in self._grid.pairs(places):
                winners = least(query, ((places[query] - self._flat[point]) ** 2).sum(axis=1))
                best[query[winners]] = point[winners]
        return best

    def _height_by(self, point: Integers, places: Floats) -> Floats:
        """Return the heights at some locations of the roads that points near them are on."""
        along = ((places - self._flat[point]) * self._ahead[point]).sum(axis=-1)
        along = np.minimum(np.maximum(along, -_CELL), _CELL)
        height: Floats = self.points[point, 2] + self._slope[point] * along
        return height

    def _onto(self, point: Integers, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Project locations onto the lines from points to the next ones: shares of these, and offsets to the right."""
        start, stop = self._flat[point], self._flat[point + 1]
        along, across = (stop - start).T
        x, y = x - start[:, 0], y - start[:, 1]
        length = np.maximum(np.hypot(along, across), np.finfo(float).tiny)
        return (x * along + y * across) / length**2, (along * y - across * x) / length


class _Terrain:
    """The nearest of some points for each cell of a grid, found by jump flooding.

    At first, only the cells with points know one. Then all cells look at the eight others that are some number of cells
    away, and take over the point of one that is nearer to their own middle. That number is halved from half of the grid
    down to 1, so that points reach all cells in a few rounds. Some cells get a point that is only nearly the nearest one.
    """

    def __init__(self, points: Floats) -> None:
        extent = np.ptp(points, axis=0)
        self._cell = max(_TERRAIN, float(extent.max()) / _MOST_CELLS)
        self.is_coarse = self._cell > _TERRAIN
        self._origin = points.min(axis=0) - 10 * self._cell
        shape = (extent / self._cell).astype(np.int64) + 21
        self._nearest = np.full(shape, -1)
        self._last = shape - 1
        cells = np.floor((points - self._origin) / self._cell).astype(np.int64)
        self._nearest[cells[:, 0], cells[:, 1]] = np.arange(len(points))
        self._flood(points)

    def nearest(self, places: Floats) -> Integers:
        """Return the index of a point near each location, (k, 2); beyond the grid, of one near its edge."""
        cells = _cells(places, self._origin, self._cell, self._last)
        nearest: Integers = self._nearest.ravel()[cells]
        return nearest

    def _flood(self, points: Floats) -> None:
        """Find the nearest point of each cell."""
        rows, columns = np.indices(self._nearest.shape)
        last_row, last_column = rows.max(), columns.max()
        middles = self._origin + (np.stack((rows, columns), axis=-1) + 0.5) * self._cell
        distance = self._distance(points, self._nearest, middles)
        jump = 1 << int(max(last_row, last_column)).bit_length()
        while jump := jump // 2:
            for down, right in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
                theirs = self._nearest[
                    np.clip(rows + down * jump, 0, last_row), np.clip(columns + right * jump, 0, last_column)
                ]
                known = self._distance(points, theirs, middles)
                nearer = known < distance
                self._nearest[nearer], distance[nearer] = theirs[nearer], known[nearer]

    @staticmethod
    def _distance(points: Floats, numbers: Integers, middles: Floats) -> Floats:
        distance: Floats = np.where(numbers < 0, np.inf, ((points[numbers] - middles) ** 2).sum(axis=-1))
        return distance


def _cells(places: Floats, origin: Floats, side: float, last: Integers) -> Integers:
    """Return the numbers of the cells of locations, (k, 2), in a grid up to the `last` one; beyond it, of its edge."""
    cells = np.fmin(np.fmax((places - origin) / side, 0), last).astype(np.int64)  # nan becomes 0
    numbers: Integers = cells[..., 0] * (last[1] + 1) + cells[..., 1]
    return numbers


class _Levels:
    """The levels of roads in the cells of a grid in which several are above each other, if there are any."""

    def __init__(self, points: Floats, nearest: Callable[[Floats], Integers]) -> None:
        flat = points[:, :2]
        self._origin = flat.min(axis=0) - 2 * _LEVEL_REACH
        self._last = ((np.ptp(flat, axis=0) + 4 * _LEVEL_REACH) / _TERRAIN).astype(np.int64)
        stacked = np.unique(np.floor(flat[_stacked(points)] / _TERRAIN), axis=0) * _TERRAIN
        cells = np.unique(self._cells_of(stacked[:, None] + _around(_LEVEL_REACH, _TERRAIN)))
        middles = self._origin + (np.stack(np.divmod(cells, self._last[1] + 1), axis=-1) + 0.5) * _TERRAIN
        levels = self._find(points, middles, nearest(middles))
        several = levels[:, 1] >= 0
        self.is_empty = not several.any()
        self._cells, self._points = cells[several], levels[several]

    def _find(self, points: Floats, middles: Floats, nearest: Integers) -> Integers:
        """Return the nearest point of each level of some cells, (cells, levels); -1 is none."""
        grid = BoxGrid(points[:, :2], points[:, :2], _LEVEL_REACH, _LEVEL_REACH)
        levels, latest = [nearest, np.full(len(middles), -1)], nearest.copy()
        for query, point in grid.pairs(middles):
            away = ((middles[query] - points[point, :2]) ** 2).sum(axis=1)
            left = away < _LEVEL_REACH**2
            for number in count(1):
                left &= np.abs(points[point, 2] - points[latest[query], 2]) > _LEVEL_GAP
                if not left.any():
                    break
                if number == len(levels):
                    levels.append(np.full(len(middles), -1))
                rows = np.flatnonzero(left)
                best = rows[least(query[rows], away[rows])]
                levels[number][query[best]] = latest[query[best]] = point[best]
        return np.stack(levels, axis=1)

    def _cells_of(self, places: Floats) -> Integers:
        return _cells(places, self._origin, _TERRAIN, self._last)

    def near(self, places: Floats) -> tuple[Integers, Integers]:
        """Return which of some locations have several levels, and points on these, (m, levels); -1 is none."""
        cells = self._cells_of(places)
        row = np.minimum(np.searchsorted(self._cells, cells), len(self._cells) - 1)
        some = np.flatnonzero(self._cells[row] == cells)
        return some, self._points[row[some]]


def _stacked(points: Floats) -> Integers:
    """Return the numbers of points near which others are on another level."""
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / _LEVEL_REACH).astype(np.int64) + 1
    lowest, highest = np.full(cells.max(axis=0) + 2, np.inf), np.full(cells.max(axis=0) + 2, -np.inf)
    np.minimum.at(lowest, (cells[:, 0], cells[:, 1]), points[:, 2])
    np.maximum.at(highest, (cells[:, 0], cells[:, 1]), points[:, 2])
    beside = [(cells[:, 0] + x, cells[:, 1] + y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    gap = np.max([highest[cell] for cell in beside], axis=0) - np.min([lowest[cell] for cell in beside], axis=0)
    return np.flatnonzero(gap > _LEVEL_GAP)


def _around(reach: float, step: float) -> Floats:
    """Return offsets that cover a square, (n, 2)."""
    steps = np.arange(-reach, reach + step, step)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
