"""Barriers that stop cars off the road, and the ground that lanes cover."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.roads.polylines import covering, simplify

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.util.arrays import Floats


SIDEWALK: Final = "sidewalk"
_NO_LANE: Final = "none"
_CELL: Final = 0.5  # m
_MOST_CELLS: Final = 3000  # along a side
_TO_LEFT_HANDED: Final = np.array((1.0, -1, 1))
_BEHIND_SIDEWALKS: Final = 0.75  # m
_BEHIND_ROADS: Final = 4.0  # m: where there is no sidewalk; leaves room for one at the corners of junctions
_CLEAR: Final = 3.5  # m: between the edge of a lane for cars and such a barrier
_POSTS: Final = 2.0  # m: between the points of a barrier before it is simplified
_TOLERANCE: Final = 0.2  # m
_LEVEL_GAP: Final = 3.0  # m: what differs by more in height is on another level
_SHORTEST: Final = 1.0  # m


class Barrier(NamedTuple):
    """A barrier."""

    line: Floats  # its points, (n, 3) in m, in CARLA's axes
    is_behind_sidewalk: bool  # whether it is behind a sidewalk; else it is beside a road without one


class Ground:
    """The ground that one or more lanes cover, as cells of a grid, with a margin in m on both sides."""

    def __init__(self, lanes: Iterable[LaneGeometry], margin: float = 0.0) -> None:
        borders = [_widened(left_handed(lane.left), left_handed(lane.right), margin) for lane in lanes]
        ends = np.concatenate([border[:, :2] for pair in borders for border in pair])
        extent = float(np.ptp(ends, axis=0).max())
        self._cell = max(_CELL, extent / _MOST_CELLS)
        if self._cell > _CELL:
            message = f"of a map of {extent / 1000:.1f} km, the ground is known to {self._cell:.1f} m and not {_CELL:g} m"
            warnings.warn(message, RecapWarning, stacklevel=2)
        self._origin = ends.min(axis=0) - 2 * self._cell
        shape = ((ends.max(axis=0) - self._origin) / self._cell).astype(np.int64) + 3
        self._lowest, self._highest = np.full(shape, np.inf), np.full(shape, -np.inf)
        for left, right in borders:
            self._cover(left, right)

    def covers(self, places: Floats) -> NDArray[np.bool_]:
        """Return which locations, (n, 2) or (n, 3), lie on the ground, to about a cell; with z, on the same level."""
        cells = np.floor((places[:, :2] - self._origin) / self._cell).astype(np.int64)
        inside = np.flatnonzero(((cells >= 0) & (cells < self._lowest.shape)).all(axis=1))
        lowest, highest = (level[cells[inside, 0], cells[inside, 1]] for level in (self._lowest, self._highest))
        z = places[inside, 2] if places.shape[1] > 2 else np.minimum(lowest, highest)
        covered = np.zeros(len(places), np.bool_)
        covered[inside] = (lowest - _LEVEL_GAP < z) & (z < highest + _LEVEL_GAP)
        return covered

    def crossed_by(self, start: Floats, stop: Floats) -> bool:
        """Return whether the straight path from one location to another leads over the ground."""
        steps = int(np.linalg.norm(stop[:2] - start[:2]) / self._cell) + 2
        return bool(self.covers(start[:2] + np.linspace(0, 1, steps)[:, None] * (stop[:2] - start[:2])).any())

    def _cover(self, left: Floats, right: Floats) -> None:
        width = float(np.linalg.norm((left - right)[:, :2], axis=1).max())
        points = covering(left, right, 2 * len(left), int(width / self._cell * 1.5) + 2)
        columns, rows = np.floor((points[..., :2] - self._origin) / self._cell).astype(np.int64).reshape(-1, 2).T
        cells, heights = columns * self._lowest.shape[1] + rows, points[..., 2].ravel()
        np.minimum.at(self._lowest.reshape(-1), cells, heights)
        np.maximum.at(self._highest.reshape(-1), cells, heights)


def left_handed(points: Floats) -> Floats:
    """Return points of OpenDRIVE's axes in CARLA's."""
    turned: Floats = points * _TO_LEFT_HANDED
    return turned


def _widened(left: Floats, right: Floats, margin: float) -> tuple[Floats, Floats]:
    aside = right - left
    aside *= margin / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-6)
    return left - aside, right + aside


def barriers(lanes: Sequence[LaneGeometry]) -> list[Barrier]:
    """Return the barriers of a town: along the outermost lanes, some way beyond, not across other lanes."""
    real = [lane for lane in lanes if lane.kind != _NO_LANE]
    if not real:
        return []
    ground, road = Ground(real), Ground([lane for lane in real if lane.is_driving], _CLEAR)
    return [
        Barrier(part, lane.kind == SIDEWALK)
        for lane in _outermost(real)
        for part in _fence(lane, (ground,) if lane.kind == SIDEWALK else (ground, road))
    ]


def _outermost(lanes: Iterable[LaneGeometry]) -> list[LaneGeometry]:
    """Return the last lanes on both sides of each section of a road."""
    outer: dict[tuple[int, int, bool], LaneGeometry] = {}
    for lane in lanes:
        side = lane.road, lane.section, lane.id > 0
        if side not in outer or abs(lane.id) > abs(outer[side].id):
            outer[side] = lane
    return list(outer.values())


def _fence(lane: LaneGeometry, grounds: Iterable[Ground]) -> Iterator[Floats]:
    rightwards = lane.reverse == (lane.id > 0)  # in right-hand traffic, outwards is to the right
    margin = _BEHIND_SIDEWALKS if lane.kind == SIDEWALK else _BEHIND_ROADS
    line = _widened(left_handed(lane.left), left_handed(lane.right), margin)[rightwards]
    line = line[np.unique(np.linspace(0, len(line) - 1, int(len(line) * _spacing(line) / _POSTS) + 2).astype(np.int64))]
    free = ~np.any([ground.covers(line) for ground in grounds], axis=0)
    for part in np.split(np.arange(len(line)), np.flatnonzero(np.diff(free)) + 1):
        if free[part[0]] and np.linalg.norm(line[part[-1]] - line[part[0]]) > _SHORTEST:
            yield simplify(line[part], _TOLERANCE)


def _spacing(line: Floats) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).mean())
