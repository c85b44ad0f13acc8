"""The roads of a town as arrays: where lanes lead, how fast one may drive on them, and where one has to stop.

Units are m, m/s and radians; axes are right-handed: x forward, y left, z up.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapWarning

if TYPE_CHECKING:
    from collections.abc import Sequence

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

SIGNAL: Final = np.dtype([("kind", "u1"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8")])
"""A traffic light or sign: its kind, position, and the direction of the traffic that it is for."""

STOP_LINE: Final = np.dtype(
    [("signal", "i4"), ("heading", "f8")] + [(f"{axis}{end}", "f8") for end in "01" for axis in "xyz"]
)
"""A line across a lane at which a signal applies: the index of the signal, the driving direction, the left end, and the
right end."""

REACH: Final = 20.0
"""How far from the roads positions are related to them, in m."""

_CELL: Final = 2.0  # m
_MARGIN: Final = 0.5  # m around the cells of a piece within which it is found
_MOST_ENTRIES: Final = 4_000_000
_MOST_PIECES: Final = 2_048  # of a cell; those of 10 m in CARLA's towns have up to 500 within reach
_BLOCK: Final = 1 << 15  # points that are evaluated together
_LEVELS: Final = 3.0  # m between roads above each other
_INSIDE: Final = 1e-3  # m
_TINY: Final = 1e-9  # m
_AGAINST: Final = 1.5  # m that a lane in another direction counts as farther away


@dataclass(frozen=True, eq=False)
class LanePositions:
    """Points in relation to lanes; arrays of (n,).

    Attributes:
        lane: The lane for cars that contains the point, else the nearest one within `REACH`; `NONE` without one.
        offset: How far the point is to the left of the middle of the lane, as seen in driving direction, in m.
        beside: How far the point is outside the lane, in m; 0 within it.
        heading: The driving direction of the lane, in radians; NaN without one.
        limit: The speed limit in m/s; NaN without one.
        in_junction: Whether the lane, or another one that contains the point, is in a junction.
        outside: How far the point is outside all paved lanes and junctions, in m; 0 on them, infinite beyond `REACH`.
    """

    lane: Integers
    offset: Floats
    beside: Floats
    heading: Floats
    limit: Floats
    in_junction: Booleans
    outside: Floats

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
        if headings is not None:
            headings = np.asarray(headings, np.float64)
        found = self._near.find(points, headings)
        far = np.flatnonzero((found["cost"] > _MARGIN) | ~np.isfinite(found["outside"]))  # farther lanes may cost less
        if len(far):
            found[far] = self._far.find(points[far], None if headings is None else headings[far])
        junctions = np.append(self.lanes["junction"], NONE)[found["lane"]]
        return LanePositions(
            lane=found["lane"],
            offset=found["offset"],
            beside=found["beside"],
            heading=found["heading"],
            limit=found["limit"],
            in_junction=found["in_junction"] | (junctions != NONE),
            outside=found["outside"],
        )

    def on_road(self, points: Floats) -> Booleans:
        """Return whether points, (n, 2) or (n, 3), are on paved lanes or in junctions."""
        return np.asarray(self._near.find(np.asarray(points, np.float64), None)["outside"] <= 0)

    def only(self, lanes: Booleans) -> RoadNetwork:
        """Return the network with the pieces of some lanes alone, from which it measures `LanePositions.outside`.

        Args:
            lanes: Whether each lane is kept, (lanes,).
        """
        return replace(self, pieces=self.pieces[lanes[self.pieces["lane"]]])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_near", "_far")}

    @cached_property
    def _near(self) -> _PieceGrid:
        return _PieceGrid(self, _CELL, _MARGIN)

    @cached_property
    def _far(self) -> _PieceGrid:
        return _PieceGrid(self, REACH / 2, REACH)


_FOUND: Final = np.dtype(
    [
        ("cost", "f8"),
        ("lane", "i8"),
        ("offset", "f8"),
        ("beside", "f8"),
        ("heading", "f8"),
        ("limit", "f8"),
        ("in_junction", "?"),
        ("outside", "f8"),
    ]
)


_NEAR: Final = np.dtype(
    [("cost", "f8"), ("piece", "i8"), ("offset", "f8"), ("beside", "f8"), ("outside", "f8"), ("in_junction", "?")]
)


class _PieceGrid:
    """The pieces of lanes by the squares of a grid, each in all squares near it.

    Args:
        roads: The roads.
        cell: The size of a square in m; larger if there were too many.
        margin: How far outside a square its pieces may be, in m.
    """

    def __init__(self, roads: RoadNetwork, cell: float, margin: float) -> None:
        pieces = roads.pieces
        self._margin = margin
        kinds = roads.lanes["kind"][pieces["lane"]]
        self._is_driving = np.isin(kinds, (DRIVING, BOTH_WAYS))
        self._in_junction = roads.lanes["junction"][pieces["lane"]] != NONE
        self._lane, self._limit = pieces["lane"].astype(np.int64), pieces["limit"]
        self._shapes = _Shapes(pieces)
        low, high = _bounds(pieces)
        self._origin = low.min(axis=0, initial=0.0) - margin
        while True:
            first = np.floor((low - margin - self._origin) / cell).astype(np.int64)
            counts = np.floor((high + margin - self._origin) / cell).astype(np.int64) - first + 1
            if counts.prod(axis=1).sum() <= _MOST_ENTRIES:
                break
            cell *= 2
        self._cell = cell
        self._rows = int((first + counts)[:, 1].max(initial=1))
        self._columns = int((first + counts)[:, 0].max(initial=1))
        self._fill(first, counts)

    def _fill(self, first: Integers, counts: Integers) -> None:
        """Sort the pieces by cells."""
        sizes = counts.prod(axis=1)
        piece = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
        number = np.arange(len(piece), dtype=np.int32) - np.repeat((np.cumsum(sizes) - sizes).astype(np.int32), sizes)
        rows = counts[:, 1].astype(np.int32)[piece]
        cells = (first[:, 0][piece] + number // rows) * self._rows
        cells += first[:, 1][piece] + number % rows
        order = np.argsort(2 * cells + ~self._is_driving[piece], kind="stable")
        self._pieces = piece[order]
        filled, starts, amounts = np.unique(cells[order], return_index=True, return_counts=True)
        self._cells = np.append(filled, np.iinfo(np.int64).max)  # the last one has no pieces
        if amounts.max(initial=0) > _MOST_PIECES:
            message = f"of {amounts.max():,} parts of lanes within {self._cell:g} m, {_MOST_PIECES:,} are looked at"
            warnings.warn(message, RecapWarning, stacklevel=2)
            amounts = np.minimum(amounts, _MOST_PIECES)
        self._starts, self._amounts = np.append(starts, 0), np.append(amounts, 0)

    def find(self, points: Floats, headings: Floats | None) -> NDArray[np.void]:
        """Return the lanes at points; see `RoadNetwork.lanes_at`."""
        found = np.zeros(len(points), _FOUND)
        found["lane"] = NONE
        found["offset"] = found["heading"] = found["limit"] = np.nan
        found["cost"] = found["beside"] = found["outside"] = np.inf
        with np.errstate(all="ignore"):
            for start in range(0, len(points), _BLOCK):
                part = slice(start, start + _BLOCK)
                self._find(points[part], None if headings is None else headings[part], found[part])
        return found

    def _find(self, points: Floats, headings: Floats | None, found: NDArray[np.void]) -> None:
        near = self._search(points, headings)
        known = np.flatnonzero((near["piece"] != NONE) & (near["beside"] <= self._margin))
        piece = near["piece"][known]
        found["cost"][known] = near["cost"][known]
        found["lane"][known], found["limit"][known] = self._lane[piece], self._limit[piece]
        found["heading"][known] = np.arctan2(self._shapes.ahead_y[piece], self._shapes.ahead_x[piece])
        found["offset"][known], found["beside"][known] = near["offset"][known], near["beside"][known]
        found["in_junction"] = near["in_junction"]
        found["outside"] = np.where(near["outside"] <= self._margin, near["outside"], np.inf)

    def _search(self, points: Floats, headings: Floats | None) -> NDArray[np.void]:
        """Return the nearest pieces of the cells of points."""
        slots = self._slots(points)
        starts, amounts = self._starts[slots], self._amounts[slots]
        shapes = self._shapes
        best = np.full(len(points), np.inf)
        piece = np.full(len(points), NONE)
        offset, beside, outside = np.full((3, len(points)), np.inf)
        in_junction = np.zeros(len(points), np.bool_)
        order = np.argsort(-amounts, kind="stable")  # so that those with most pieces are first
        columns = [np.ascontiguousarray(column) for column in points[order].T]
        first, ends = starts[order], np.searchsorted(-amounts[order], -np.arange(amounts.max(initial=0)))
        if headings is not None:
            cos, sin = np.cos(headings[order]), np.sin(headings[order])
        for number, end in enumerate(ends.tolist()):
            index = self._pieces[first[:end] + number]
            lateral, away = shapes.beside(index, [column[:end] for column in columns])
            np.fmin(outside[:end], away, out=outside[:end])
            in_junction[:end] |= self._in_junction[index] & (away <= 0)
            cost = away + 1e-3 * np.abs(lateral)
            if headings is not None:
                turned = cos[:end] * shapes.ahead_x[index] + sin[:end] * shapes.ahead_y[index]
                cost += np.where(np.isfinite(turned), (1 - turned) * (_AGAINST / 2), 0.0)
            better = np.flatnonzero(self._is_driving[index] & (cost < best[:end]))
            best[better], piece[better] = cost[better], index[better]
            offset[better], beside[better] = lateral[better], away[better]
        near = np.empty(len(points), _NEAR)
        near["cost"][order], near["piece"][order] = best, piece
        near["offset"][order], near["beside"][order] = offset, beside
        near["outside"][order], near["in_junction"][order] = outside, in_junction
        return near

    def _slots(self, points: Floats) -> Integers:
        """Return the index of the cell of each point among those that have pieces; the last one for none."""
        grid = np.floor((points[:, :2] - self._origin) / self._cell)
        within = ((grid >= 0) & (grid < (self._columns, self._rows))).all(axis=1)
        grid = np.where(within[:, None], grid, 0).astype(np.int64)
        cells = grid[:, 0] * self._rows + grid[:, 1]
        slots = np.searchsorted(self._cells, cells)
        return np.where(within & (self._cells[slots] == cells), slots, len(self._cells) - 1)


class _Shapes:
    """The pieces as columns, (pieces,) each: lines across the start and the end, and the way in between.

    Attributes:
        ahead_x, ahead_y: The direction from the middle of the start to that of the end.
    """

    def __init__(self, pieces: NDArray[np.void]) -> None:
        column = {name: np.ascontiguousarray(pieces[name]) for name in PIECE.names or ()}
        self._x0, self._y0, self._x1, self._y1 = (column[name] for name in ("x0", "y0", "x1", "y1"))
        # How far a point is behind the line across the start, and before that across the end: linear functions of x and y.
        self._after = column["left_y0"], -column["left_x0"]
        self._before = -column["left_y1"], column["left_x1"]
        self._way_x, self._way_y = self._x1 - self._x0, self._y1 - self._y0
        length = np.maximum(np.hypot(self._way_x, self._way_y), _TINY)
        self.ahead_x, self.ahead_y = self._way_x / length, self._way_y / length
        self._half, self._wider = column["half0"], column["half1"] - column["half0"]
        self._level, self._rise = column["z0"], column["z1"] - column["z0"]

    def beside(self, index: Integers, points: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return how far points are to the left of the middle of pieces, and how far outside these they are.

        Args:
            index: The piece for each point.
            points: x and y, or x, y and z.
        """
        x, y = points[0] - self._x0[index], points[1] - self._y0[index]
        way_x, way_y = self._way_x[index], self._way_y[index]
        after = x * self._after[0][index] + y * self._after[1][index]
        before = (x - way_x) * self._before[0][index] + (y - way_y) * self._before[1][index]
        beyond = np.minimum(after, before)
        share = np.where(beyond >= 0, after / np.maximum(after + before, _TINY), after > before)
        lateral = (y - share * way_y) * self.ahead_x[index] - (x - share * way_x) * self.ahead_y[index]
        away = np.abs(lateral) - (self._half[index] + share * self._wider[index])
        np.maximum(away, 0.0, out=away)
        away = np.where(beyond < 0, np.hypot(beyond, away), away)
        away[away <= _INSIDE] = 0.0
        if len(points) > 2:
            level = self._level[index] + share * self._rise[index]
            away[np.abs(points[2] - level) > _LEVELS] = np.inf
        return lateral, away


def _bounds(pieces: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Return the least and the largest x and y of each piece."""
    corners = np.stack(
        [
            np.stack(
                [pieces[f"{axis}{end}"] + side * pieces[f"half{end}"] * pieces[f"left_{axis}{end}"] for axis in "xy"], 1
            )
            for end in "01"
            for side in (1, -1)
        ]
    )
    return corners.min(axis=0), corners.max(axis=0)
