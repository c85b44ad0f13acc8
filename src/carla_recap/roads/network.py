"""The roads of a town as arrays: where lanes lead, how fast one may drive on them, and where one has to stop.

Units are m, m/s and radians; axes are right-handed: x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.roads.cells import BoxGrid, least

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Booleans, Floats, Integers


DRIVING, BOTH_WAYS, PARKING, SHOULDER, GAP = range(5)
"""The kinds of lanes: for cars, for cars in both directions, to park on, paved otherwise; and a gap between lanes of a
junction."""

LANE_KINDS: Final = {
    **dict.fromkeys(("driving", "entry", "exit", "onramp", "offramp", "connectingramp", "mwyentry", "mwyexit"), DRIVING),
    **dict.fromkeys(("roadworks", "hov", "bus", "taxi"), DRIVING),
    "bidirectional": BOTH_WAYS,
    "parking": PARKING,
    **dict.fromkeys(("shoulder", "border", "stop", "restricted", "biking", "tram"), SHOULDER),
    **dict.fromkeys(("special1", "special2", "special3"), SHOULDER),
}
"""The kind of a paved lane by its type in OpenDRIVE."""

UNPAVED: Final = ("none", "sidewalk", "walking", "median", "curb", "rail", "shared", "sliplane")
"""The other types of lanes in OpenDRIVE."""

LIGHT, STOP, YIELD = range(3)
"""The kinds of signals that stop lines belong to."""

NONE: Final = -1
"""The index where there is no lane, junction or signal."""

LANE: Final = np.dtype([("road", "i4"), ("section", "i4"), ("id", "i4"), ("kind", "u1"), ("junction", "i4")])
"""A lane of a section: the index of its road, that of the section, its number, its kind, and the index of its junction."""

PIECE: Final = np.dtype(
    [("lane", "i4"), ("limit", "f8")]
    + [(f"{name}{end}", "f8") for end in "01" for name in ("x", "y", "z", "left_x", "left_y", "half")]
)
"""A part of a lane between two lines across it, from the first to the second in driving direction: its lane, the speed
limit, and the middle of each line, the direction to the left, and half of the width."""
SHAPE: Final = [name for name in PIECE.names or () if name not in ("lane", "limit")]
"""The fields of a piece that are its shape."""

SIGNAL: Final = np.dtype([("kind", "u1"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8")])
"""A traffic light or sign: its kind, position, and the direction of the traffic that it is for."""

STOP_LINE: Final = np.dtype(
    [("signal", "i4"), ("heading", "f8")] + [(f"{axis}{end}", "f8") for end in "01" for axis in "xyz"]
)
"""A line across a lane at which a signal applies: the index of the signal, the driving direction, the left end, and the
right end."""

REACH: Final = 20.0
"""How far from the roads positions are related to them, in m."""

_NEAR: Final = 0.5  # m within which pieces are looked for first
_REACHES: Final = {_NEAR: 2.0, 2.0: 4.0, REACH: 10.0}  # m within which they are looked for, and the sizes of cells for that
_LEVELS: Final = 3.0  # m between roads above each other
_INSIDE: Final = 1e-3  # m
_TINY: Final = 1e-9  # m
_AGAINST: Final = 1.5  # m that a lane in another direction counts as farther away


@dataclass(frozen=True, eq=False)
class LanePositions:
    """Points in relation to lanes; arrays of (n,)."""

    lane: Integers  # the lane for cars that contains the point, else the nearest one within `REACH`; `NONE` without one
    offset: Floats  # how far the point is to the left of the middle of the lane, as seen in driving direction, in m
    beside: Floats  # how far the point is outside the lane, in m; 0 within it
    heading: Floats  # the driving direction of the lane, in radians; NaN without one
    limit: Floats  # the speed limit in m/s; NaN without one
    in_junction: Booleans  # whether the lane, or another one that contains the point, is in a junction
    outside: Floats  # how far the point is outside all paved lanes and junctions, in m; 0 on them, infinite beyond `REACH`

    def taken(self, index: Integers) -> LanePositions:
        """Return the points at some indices."""
        return LanePositions(**{name: values[index] for name, values in vars(self).items()})

    @property
    def on_road(self) -> Booleans:
        """Whether each point is on a paved lane or in a junction."""
        return self.outside <= 0


@dataclass(frozen=True, eq=False)
class RoadNetwork:
    """The paved lanes, signals and stop lines of a town.

    Attributes:
        name: The name of the map.
        lanes: The lanes, of type `LANE`.
        pieces: The parts of the lanes, of type `PIECE`.
        signals: Traffic lights, stop and yield signs, of type `SIGNAL`.
        stop_lines: The stop lines, of type `STOP_LINE`.
        road_ids: The OpenDRIVE id of each road.
        junction_ids: The OpenDRIVE id of each junction.
        signal_ids: The OpenDRIVE id of each signal.
    """

    name: str
    lanes: NDArray[np.void]
    pieces: NDArray[np.void]
    signals: NDArray[np.void]
    stop_lines: NDArray[np.void]
    road_ids: tuple[str, ...] = field(repr=False)
    junction_ids: tuple[str, ...] = field(repr=False)
    signal_ids: tuple[str, ...] = field(repr=False)

    def lanes_at(self, points: Floats, headings: Floats | None = None) -> LanePositions:
        """Return where points are in relation to the lanes.

        Args:
            points: Rows of x, y or x, y, z, in m. With z, lanes at different heights are distinguished, as on bridges.
            headings: Directions in radians: of the lanes that overlap in junctions, one in this direction is preferred.
        """
        points = np.asarray(points, np.float64)
        near = self._index.nearest(points, None if headings is None else np.asarray(headings, np.float64))
        piece, pieces = near["piece"], self.pieces
        lane = np.append(pieces["lane"].astype(np.int64), NONE)[piece]
        heading = np.arctan2(pieces["y1"] - pieces["y0"], pieces["x1"] - pieces["x0"])
        return LanePositions(
            lane=lane,
            offset=near["offset"],
            beside=near["beside"],
            heading=np.append(heading, np.nan)[piece],
            limit=np.append(pieces["limit"], np.nan)[piece],
            in_junction=near["in_junction"] | (np.append(self.lanes["junction"], NONE)[lane] != NONE),
            outside=near["outside"],
        )

    def on_road(self, points: Floats) -> Booleans:
        """Return whether points, (n, 2) or (n, 3), are on paved lanes or in junctions."""
        return np.asarray(self._index.nearest(np.asarray(points, np.float64), None, _NEAR)["outside"] <= 0)

    def only(self, lanes: Booleans) -> RoadNetwork:
        """Return the network with the pieces of some lanes alone, from which it measures `LanePositions.outside`.

        Args:
            lanes: Whether each lane is kept, (lanes,).
        """
        return replace(self, pieces=self.pieces[lanes[self.pieces["lane"]]])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_index"}

    @cached_property
    def _index(self) -> _Pieces:
        return _Pieces(self)


_NEAREST: Final = np.dtype(
    [("cost", "f8"), ("piece", "i8"), ("offset", "f8"), ("beside", "f8"), ("outside", "f8"), ("in_junction", "?")]
)


class _Pieces:
    """The pieces of lanes, and which of them is nearest to a point."""

    def __init__(self, roads: RoadNetwork) -> None:
        pieces, lanes = roads.pieces, roads.lanes[roads.pieces["lane"]]
        self._is_driving, self._in_junction = np.isin(lanes["kind"], (DRIVING, BOTH_WAYS)), lanes["junction"] != NONE
        self._columns = {name: np.ascontiguousarray(pieces[name]) for name in SHAPE}
        self._bounds = _bounds(pieces)
        self._headings = np.arctan2(pieces["y1"] - pieces["y0"], pieces["x1"] - pieces["x0"])
        self._grids: dict[float, BoxGrid] = {}

    def nearest(self, points: Floats, headings: Floats | None, farthest: float = REACH) -> NDArray[np.void]:
        """Return the nearest pieces for cars within a distance; see `RoadNetwork.lanes_at`."""
        near = np.full(len(points), np.array((np.inf, NONE, np.nan, np.inf, np.inf, False), _NEAREST))
        left = np.arange(len(points))
        with np.errstate(all="ignore"):
            for reach, cell in _REACHES.items():
                if len(left) and reach <= farthest:
                    if reach not in self._grids:
                        self._grids[reach] = BoxGrid(*self._bounds, cell, reach)
                    for query, piece in self._grids[reach].pairs(points[left]):
                        self._compare(near, left[query], piece, points, headings, reach)
                    left = left[~(near["cost"][left] <= reach) | ~(near["outside"][left] <= reach)]
        near["outside"][near["outside"] > farthest] = np.inf
        return near

    def _compare(
        self,
        near: NDArray[np.void],
        query: Integers,
        piece: Integers,
        points: Floats,
        headings: Floats | None,
        reach: float,
    ) -> None:
        """Set what is near to points: of the pairs of these, ascending, and all pieces within a reach."""
        lateral, away = _beside({name: values[piece] for name, values in self._columns.items()}, points[query])
        starts = np.flatnonzero(np.diff(query, prepend=-1))
        if not len(starts):
            return
        near["outside"][query[starts]] = np.minimum.reduceat(away, starts)
        near["in_junction"][query[starts]] = np.logical_or.reduceat(self._in_junction[piece] & (away <= 0), starts)
        cost = np.where(self._is_driving[piece] & (away <= reach), away + 1e-3 * np.abs(lateral), np.inf)
        if headings is not None:
            cost += np.nan_to_num(1 - np.cos(self._headings[piece] - headings[query])) * (_AGAINST / 2)
        best = least(query, cost)
        best = best[np.isfinite(cost[best])]
        for name, values in (("cost", cost), ("piece", piece), ("offset", lateral), ("beside", away)):
            near[name][query[best]] = values[best]


def _beside(pieces: Mapping[str, Floats], points: Floats) -> tuple[Floats, Floats]:
    """Return how far points, (n, 2) or (n, 3), are to the left of the middle of a piece each, and outside it."""
    x, y = points[:, 0] - pieces["x0"], points[:, 1] - pieces["y0"]
    way_x, way_y = pieces["x1"] - pieces["x0"], pieces["y1"] - pieces["y0"]
    after = x * pieces["left_y0"] - y * pieces["left_x0"]  # the line across the start
    before = (y - way_y) * pieces["left_x1"] - (x - way_x) * pieces["left_y1"]  # that across the end
    beyond = np.minimum(after, before)
    share = np.where(beyond >= 0, after / np.maximum(after + before, _TINY), after > before)
    lateral = ((y - share * way_y) * way_x - (x - share * way_x) * way_y) / np.maximum(np.hypot(way_x, way_y), _TINY)
    away = np.maximum(np.abs(lateral) - (pieces["half0"] + share * (pieces["half1"] - pieces["half0"])), 0.0)
    away = np.where(beyond < 0, np.hypot(beyond, away), away)
    away[away <= _INSIDE] = 0.0
    if points.shape[1] > 2:
        level = pieces["z0"] + share * (pieces["z1"] - pieces["z0"])
        away[np.abs(points[:, 2] - level) > _LEVELS] = np.inf
    return lateral, away


def _bounds(pieces: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Return the least and the largest x and y of each piece."""
    corners = [
        np.stack([pieces[f"{axis}{end}"] + side * pieces[f"half{end}"] * pieces[f"left_{axis}{end}"] for axis in "xy"], 1)
        for end in "01"
        for side in (1, -1)
    ]
    return np.min(corners, axis=0), np.max(corners, axis=0)
