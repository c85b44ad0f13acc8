"""Places on the lanes of a town, as CARLA's waypoints: the nearest one, and the one at a distance ahead."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads.cells import BoxGrid, least
from carla_recap.roads.files import content_digest, expecting, read_parts
from carla_recap.roads.lanes import DRIVING, NO_JUNCTION, TownRoads
from carla_recap.roads.opendrive import read_opendrive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.util.arrays import Floats, Integers


PARKING: Final = "parking"
NONE: Final = -1
"""The index where there is no lane."""
FARTHEST: Final = 64.0
"""The distance in m from all lanes beyond which a place belongs to none."""

_REACHES: Final = (4.0, 16.0, FARTHEST)  # m within which lanes are looked for, one after another
_LONGEST: Final = 1e5  # m, more than that of a road
_ROUNDING: Final = 10 * np.finfo(float).eps  # m by which CARLA's waypoints fall short of a distance


def load_lane_map(path: Path) -> LaneMap:
    """Return the lanes of an OpenDRIVE file; a `RecapError` if it is none, or cannot be read."""
    return _lane_map(path, content_digest(path))


@lru_cache(2)
def _lane_map(path: Path, digest: bytes) -> LaneMap:
    with np.errstate(all="ignore"), expecting(path):
        return LaneMap(TownRoads(read_opendrive(read_parts(path))))


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Places in the middle of lanes; arrays of (n,) and (n, 3)."""

    lane: Integers  # the index of the lane; `NONE` where there is none within `FARTHEST`
    station: Floats  # the distance along the road, in m
    position: Floats  # x, y and z in m
    heading: Floats  # the driving direction in radians
    ahead: Floats  # the driving direction as a vector of length 1, upwards where the lane climbs
    width: Floats  # the width of the lane in m

    def __len__(self) -> int:
        return len(self.lane)


class LaneMap:
    """The lanes of a town for cars and for parking, or of other kinds, and the places on them.

    `number` is the index of each lane by its road, section and id; `in_junction` whether each is in a junction, (lanes,).
    """

    def __init__(self, roads: TownRoads, kinds: Sequence[str] = (DRIVING, PARKING)) -> None:
        self.lanes: list[LaneGeometry] = [
            lane for lane in roads.lanes if lane.kind in kinds and np.isfinite(lane.centre).all()
        ]
        self.number = {(lane.road, lane.section, lane.id): index for index, lane in enumerate(self.lanes)}
        self.in_junction = np.array([lane.junction != NO_JUNCTION for lane in self.lanes], np.bool_)
        counts = np.array([len(lane.stations) for lane in self.lanes], np.int64)
        self._lane_of = np.repeat(np.arange(len(counts)), counts)
        self._last = np.cumsum(counts) - 1
        self._stations = _joined([lane.stations for lane in self.lanes])
        self._points = _joined([lane.centre for lane in self.lanes], 3)
        self._headings = _joined([lane.headings for lane in self.lanes])
        self._widths = _joined([np.linalg.norm(lane.left - lane.right, axis=1) for lane in self.lanes])
        self._reverse = np.array([lane.reverse for lane in self.lanes], np.bool_)
        self._keys = self._lane_of * _LONGEST + self._stations
        self._segments: dict[tuple[str, ...], _Segments | None] = {}

    @cached_property
    def successors(self) -> list[tuple[int, ...]]:
        """The indices of the lanes for driving or parking that follow each lane."""
        return [tuple(self.number[name] for name in lane.successors if name in self.number) for lane in self.lanes]

    @cached_property
    def starts(self) -> Floats:
        """The station at which each lane begins, in driving direction, (lanes,)."""
        return np.array([lane.stations[-1 if lane.reverse else 0] for lane in self.lanes])

    @cached_property
    def ends(self) -> Floats:
        """The station at which each lane ends, (lanes,)."""
        return np.array([lane.stations[0 if lane.reverse else -1] for lane in self.lanes])

    def at(self, lane: Integers, station: Floats) -> Waypoints:
        """Return the places at stations of lanes, (n,) each."""
        lane, station = np.asarray(lane, np.int64), np.asarray(station, np.float64)
        point = np.searchsorted(self._keys, lane * _LONGEST + station, "right") - 1
        first = self._last[lane] - np.bincount(self._lane_of, minlength=len(self.lanes))[lane] + 1
        return self._between(np.clip(point, first, self._last[lane] - 1), station)

    def nearest(self, points: Floats, *kinds: str) -> Waypoints:
        """Return the places nearest to points, (n, 3), in the middle of lanes of some kinds; without any, of those for cars.

        Of places that are equally near, as where lanes part, the one of the first lane counts.
        """
        segments, points = self._segments_of(kinds or (DRIVING,)), np.asarray(points, np.float64)
        if segments is None:
            number, vector = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
            return Waypoints(np.full(len(points), NONE), number, vector, number, vector, number)
        moved = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))[: len(points)]  # repeated points are found once
        found, share = (values[np.cumsum(moved) - 1] for values in segments.nearest(points[moved]))
        known = np.maximum(found, 0)
        start, stop = self._stations[known], self._stations[known + 1]
        places = self._between(known, start + share * (stop - start))
        places.lane[found == NONE] = NONE
        return places

    def around(self, point: Floats, distance: float) -> list[tuple[int, float]]:
        """Return the lanes for cars within a distance of a point, (3,), each with the station that is nearest to it."""
        segments = self._segments_of((DRIVING,))
        if segments is None:
            return []
        numbers, shares, apart = segments.around(np.asarray(point, np.float64), distance)
        stations = self._stations[numbers] + shares * (self._stations[numbers + 1] - self._stations[numbers])
        lanes = self._lane_of[numbers].tolist()
        found: dict[int, float] = {}
        for row in np.argsort(apart, kind="stable").tolist():
            found.setdefault(lanes[row], float(stations[row]))
        return sorted(found.items())

    def ahead(self, lane: int, station: float, distance: float) -> tuple[int, float] | None:
        """Return the lane and the station that are a distance along the road ahead; None where the road ends.

        Where lanes part, the first one counts.
        """
        for _ in range(len(self.lanes)):
            left = (station - self.ends[lane]) if self._reverse[lane] else (self.ends[lane] - station)
            if distance <= left:
                step = distance - _ROUNDING
                return lane, float(station - step if self._reverse[lane] else station + step)
            if not self.successors[lane]:
                return None
            lane = self.successors[lane][0]
            station, distance = float(self.starts[lane]), distance - float(left)
        return None

    def beside(self, lane: int, *, left: bool) -> int | None:
        """Return the lane for cars on the left or on the right, of the same road; None without one."""
        course = self.lanes[lane]
        step = 1 if left != course.reverse else -1  # the numbers ascend to the left of the road's direction
        other = self.number.get((course.road, course.section, course.id + step or 2 * step + course.id))
        return other if other is not None and self.lanes[other].is_driving else None

    def _segments_of(self, kinds: tuple[str, ...]) -> _Segments | None:
        if kinds not in self._segments:
            starts = np.array([lane.kind in kinds for lane in self.lanes], np.bool_)[self._lane_of]
            starts[self._last] = False
            self._segments[kinds] = _Segments(self._points, np.flatnonzero(starts)) if starts.any() else None
        return self._segments[kinds]

    def _between(self, point: Integers, station: Floats) -> Waypoints:
        """Return the places at stations between points and the next ones."""
        start, stop = self._stations[point], self._stations[point + 1]
        share = (station - start) / np.maximum(stop - start, _ROUNDING)
        lane = self._lane_of[point].copy()
        along = self._points[point + 1] - self._points[point]
        turn = np.remainder(self._headings[point + 1] - self._headings[point] + np.pi, 2 * np.pi) - np.pi
        heading = self._headings[point] + share * turn
        level = np.maximum(np.hypot(along[:, 0], along[:, 1]), _ROUNDING)
        climb = np.arctan2(np.where(self._reverse[lane], -along[:, 2], along[:, 2]), level)
        return Waypoints(
            lane,
            station,
            self._points[point] + share[:, None] * along,
            heading,
            np.stack((np.cos(heading) * np.cos(climb), np.sin(heading) * np.cos(climb), np.sin(climb)), axis=1),
            self._widths[point] + share * (self._widths[point + 1] - self._widths[point]),
        )


class _Segments:
    """Straight parts of lanes, from the points at `starts` to the next ones, and which of them is nearest to a place."""

    def __init__(self, points: Floats, starts: Integers) -> None:
        self._numbers = starts
        self._start = points[starts]
        self._way = points[starts + 1] - self._start
        self._square = np.maximum((self._way**2).sum(axis=1), np.finfo(float).tiny)
        ends = self._start[:, :2], points[starts + 1, :2]
        self._low, self._high = np.minimum(*ends), np.maximum(*ends)
        self._grids: dict[float, BoxGrid] = {}

    def nearest(self, places: Floats) -> tuple[Integers, Floats]:
        """Return where the nearest part begins, or `NONE`, and the share of the part that is before the nearest place."""
        found, shares = np.full(len(places), NONE), np.zeros(len(places))
        for reach in _REACHES:
            left = np.flatnonzero(found == NONE)
            if not len(left):
                break
            if reach not in self._grids:
                self._grids[reach] = BoxGrid(self._low, self._high, reach, reach)
            for query, part in self._grids[reach].pairs(places[left]):
                share, apart = self._beside(part, places[left[query]])
                best = least(query, apart)
                best = best[apart[best] <= reach]
                rows = left[query[best]]
                found[rows], shares[rows] = self._numbers[part[best]], share[best]
        return found, shares

    def around(self, place: Floats, distance: float) -> tuple[Integers, Floats, Floats]:
        """Return where each part within a distance begins, the share of it before the nearest place, and how far that is."""
        share, apart = self._beside(slice(None), place)
        found = np.flatnonzero(apart <= distance)
        return self._numbers[found], share[found], apart[found]

    def _beside(self, part: Integers | slice, places: Floats) -> tuple[Floats, Floats]:
        """Return the shares of parts that are before the places nearest to some places, and how far these are."""
        away, way = places - self._start[part], self._way[part]
        share = np.clip((away * way).sum(axis=1) / self._square[part], 0.0, 1.0)
        return share, np.sqrt(((away - share[:, None] * way) ** 2).sum(axis=1))


def _joined(parts: Sequence[Floats], columns: int = 0) -> Floats:
    empty = np.zeros((0, columns) if columns else 0)
    return np.concatenate([empty, *parts])
