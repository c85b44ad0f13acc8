"""The reader of OpenDRIVE files: roads as curves with lanes, markings, objects and signals; junctions; controllers.

Units are m and radians; axes are right-handed: x forward, y left, z up. As in CARLA, roads are level from side to side.
Invalid records are left out; a file that is too large is refused.
"""

from __future__ import annotations

import re
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.roads.elements import read_elements

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from xml.etree.ElementTree import Element

    from numpy.typing import ArrayLike, NDArray

    from carla_recap.util.arrays import Floats

    Coefficients = tuple[float, float, float, float]
    Rounding = Callable[[ArrayLike], Floats]

OUTSIDE: Final = "-1"
"""The junction of a road that is in none."""

BEFORE_END: Final = 1e-6
"""How far before the end of a section its last station is, in m."""

# The types of signals in CARLA's maps.
LIGHT: Final = "1000001"
STOP: Final = "206"
YIELD: Final = "205"
SPEED_LIMIT: Final = "274"

# CARLA's small towns have about 100 roads. Its large maps are 10 km by 10 km: a road of Town12 has the number 10,915.
_MOST_ROADS: Final = 16_000  # of a file
_MOST_SECTIONS: Final = 20_000  # of a file
_MOST_OF_SIDE: Final = 40  # lanes
_MOST_LANES: Final = 80_000  # of a file
_HIGHEST: Final = 1_000  # number of a lane
_MOST_RECORDS: Final = 20_000  # of one kind, of a road
_MOST_CORNERS: Final = 100
_LIMIT_OBJECT: Final = re.compile(r"[Ss]peed_(?:STATIC_)?(\d+(?:\.\d+)?)")
_MOST_IN_JUNCTION: Final = 500  # lanes; CARLA's junctions have up to 60
_MOST_CONNECTIONS: Final = 20_000  # of a junction
_LONGEST: Final = 40_000.0  # m of a road
_LONGEST_LANES: Final = 4_000_000.0  # m of all lanes; those of each of CARLA's small towns are about 20 km
_WIDEST: Final = 50.0  # m of a lane
_FARTHEST: Final = 1e6  # m from the origin
_FARTHEST_ASIDE: Final = 1_000.0  # m that a term of a width or of an offset of lanes may add
_STEEPEST: Final = 10.0  # m that a term of a height or of a curve may add for each m along it
_MOST_TURNS: Final = 100.0  # radians of a curve
_UNITS: Final = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}
_SLOWEST: Final = 0.5  # m/s: what is slower is no limit
_FASTEST: Final = 1e9  # m/s
_BUCKETS: Final = (1, 13, 29, 59, 127, 257, 541, 1109, 2357, 5087, 10273, 20753)
"""The sizes of the hash table in which CARLA's library has roads and connections."""
_LEFT_HAND: Final = "LHT"  # the rule of a road; as in CARLA, any other one is right-hand traffic
_AHEAD: Final = {"+": True, "-": False}
_ENDS: Final = ("predecessor", "successor")
_DENSE_TOLERANCE: Final = 0.02  # m
_STEPS: Final = (0.5, 12.0)  # m; the least and the largest between points
_SPIRAL_STEP: Final = 0.5  # m
_MOST_SPIRAL_STEPS: Final = 4_000


class Profile:
    """A piecewise cubic function of the distance along a road.

    Args:
        records: The start of each piece, and its coefficients a, b, c, d.
    """

    def __init__(self, records: Iterable[tuple[float, Coefficients]]) -> None:
        ordered = sorted(records, key=lambda record: record[0])[:_MOST_RECORDS]
        self.starts = np.array([start for start, _ in ordered])
        self._coefficients = np.array([coefficients for _, coefficients in ordered]).reshape(-1, 4)

    def __call__(self, stations: Floats) -> Floats:
        """Return the values at stations; 0 where there is no record."""
        a, b, c, d, along = self._pieces(stations)
        values: Floats = a + along * (b + along * (c + along * d))
        return values

    def slope(self, stations: Floats) -> Floats:
        """Return the derivatives at stations."""
        _, b, c, d, along = self._pieces(stations)
        slopes: Floats = b + along * (2 * c + along * 3 * d)
        return slopes

    def _pieces(self, stations: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return the coefficients at stations, and the distances from the starts of their pieces."""
        if not len(self.starts):
            return (*np.zeros((4, 1)), np.zeros(len(stations)))
        if len(self.starts) == 1:
            return (*self._coefficients[0], stations - self.starts[0])
        index = np.maximum(np.searchsorted(self.starts, stations, "right") - 1, 0)
        return (*self._coefficients[index].T, stations - self.starts[index])


class Marking(NamedTuple):
    """A marking along the outer border of a lane.

    Attributes:
        start: The distance from the start of the section at which it begins.
        kind: The OpenDRIVE type, such as `solid` or `broken`, lower-case.
        color: The OpenDRIVE colour, such as `standard` or `yellow`, lower-case.
        width: The width of a line.
        changes: Between which lanes it allows to change: `increase`, `decrease`, `both` or `none`.
    """

    start: float
    kind: str
    color: str
    width: float
    changes: str = "both"


@dataclass(frozen=True, eq=False)
class RoadLane:
    """A lane of a section.

    Attributes:
        id: Its number, ascending to the left of the road; 0 is the line between 1 and -1, without a width.
        kind: The OpenDRIVE type, such as `driving`, lower-case.
        width: The width by the distance from the start of the section.
        markings: The markings along its outer border, in their order.
        limits: Its speed limits in m/s, each with the distance from the start of the section from which on it applies.
        predecessor: The number of the lane before it, in the direction of the road; 0 for none.
        successor: That of the lane after it.
    """

    id: int
    kind: str
    width: Profile
    markings: tuple[Marking, ...]
    limits: tuple[tuple[float, float], ...]
    predecessor: int
    successor: int


@dataclass(frozen=True, eq=False)
class RoadSection:
    """A part of a road along which the lanes are the same.

    Attributes:
        number: Which section of the road it is, counted from 0.
        start: The distance along the road at which it begins.
        end: That at which it ends.
        left: The lanes to the left, from the inside.
        right: The lanes to the right, from the inside.
        centre: The lane without a width in between, or None.
    """

    number: int
    start: float
    end: float
    left: tuple[RoadLane, ...]
    right: tuple[RoadLane, ...]
    centre: RoadLane | None

    @property
    def lanes(self) -> tuple[RoadLane, ...]:
        """The lanes that have a width, from the left."""
        return (*self.left[::-1], *self.right)

    def borders(self, stations: Floats) -> Floats:
        """Return how far to the left of the central line each border is: (lanes + 1, n), from the left."""
        along = stations - self.start
        widths = np.zeros((len(self.lanes) + 2, len(along)))
        for row, lane in enumerate((*self.left, *self.right), 1):
            widths[row + (row > len(self.left))] = lane.width(along)
        np.minimum(np.maximum(widths, 0.0, out=widths), _WIDEST, out=widths)
        left = widths[: len(self.left) + 1].cumsum(axis=0)
        right = widths[len(self.left) + 1 :].cumsum(axis=0)
        offsets: Floats = np.concatenate((left[::-1], -right[1:]))
        return offsets


@dataclass(frozen=True, eq=False)
class RoadObject:
    """An object beside or on a road.

    Attributes:
        id: The id in the file.
        kind: The OpenDRIVE type, such as `crosswalk`, lower-case.
        name: The name, such as `StopLine`.
        station: The distance along the road.
        offset: The distance to the left of the reference line.
        height: The height above the road.
        heading: The direction relative to the road.
        width: The extent across its direction.
        length: The extent along its direction.
        outline: The corners along its direction and to the left of it, (n, 2); relative to its position.
        road_corners: The corners as distances along the road and to the left of it, (n, 2), of an outline that has these.
        ahead: Whether it applies in the direction of the road: True, False (against it), or None (in both directions).
    """

    id: str
    kind: str
    name: str
    station: float
    offset: float
    height: float
    heading: float
    width: float
    length: float
    outline: Floats
    road_corners: Floats
    ahead: bool | None

    @property
    def speed_limit(self) -> float | None:
        """The number on it in km/h, if it is a speed-limit sign, as in CARLA's towns."""
        named = _LIMIT_OBJECT.match(self.name)
        return float(named[1]) if named else None


@dataclass(frozen=True)
class RoadSignal:
    """A traffic light or sign, or a reference to one of another road.

    Attributes:
        id: The id in the file.
        kind: The OpenDRIVE type, such as 1000001 for a traffic light.
        value: The value, such as a speed.
        station: The distance along the road.
        offset: The distance to the left of the reference line.
        height: The height above the road.
        heading: The direction relative to that of the road, or against it.
        ahead: Whether it applies in the direction of the road: True, False (against it), or None (in both directions).
        lanes: The ranges of lanes for which it applies; none for all.
        unit: The unit of the value, such as km/h; empty without one.
        name: The name.
        is_reference: Whether it is a reference.
    """

    id: str
    kind: str
    value: float
    station: float
    offset: float
    height: float
    heading: float
    ahead: bool | None
    lanes: tuple[tuple[int, int], ...]
    unit: str = ""
    name: str = ""
    is_reference: bool = False


@dataclass(frozen=True, eq=False)
class _Piece:
    """A part of the reference line."""

    start: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    parameters: tuple[float, ...]

    def at(self, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
        """Return x, y and heading at distances from the start of the piece, with rounded terms."""
        return _SHAPES[self.kind](self, np.clip(along, 0.0, self.length), rounded)


def single(values: ArrayLike) -> Floats:
    """Return values in single precision, as CARLA's."""
    rounded: Floats = np.asarray(values, np.float32)
    return rounded


def double(values: ArrayLike) -> Floats:
    """Return values in double precision."""
    return np.asarray(values, np.float64)


def _line(piece: _Piece, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
    x = rounded(piece.x) + rounded(along * np.cos(piece.heading))
    y = rounded(piece.y) + rounded(along * np.sin(piece.heading))
    return x, y, np.full(len(along), piece.heading)


def _arc(piece: _Piece, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
    (curvature,) = piece.parameters
    if abs(curvature) < 1e-9:
        return _line(piece, along, rounded)
    radius, start, heading = 1 / curvature, piece.heading + np.pi / 2, piece.heading + along * curvature
    stop = heading + np.pi / 2
    x = rounded(piece.x) + rounded(radius * np.cos(start)) - rounded(radius * np.cos(stop))
    y = rounded(piece.y) + rounded(radius * np.sin(start)) - rounded(radius * np.sin(stop))
    return x, y, heading


def _by_local(piece: _Piece, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
    u, v, turn = _LOCAL[piece.kind](along, piece.length, *piece.parameters)
    cos, sin = np.cos(piece.heading), np.sin(piece.heading)
    x, y = rounded(piece.x) + rounded(u * cos - v * sin), rounded(piece.y) + rounded(u * sin + v * cos)
    return x, y, piece.heading + turn


def _spiral(along: Floats, length: float, first: float, last: float) -> tuple[Floats, Floats, Floats]:
    steps = int(min(max(length / _SPIRAL_STEP, 8), _MOST_SPIRAL_STEPS))
    grid = np.linspace(0.0, length, 2 * steps + 1)
    change = (last - first) / max(length, 1e-9)
    turns = grid * (first + grid * change / 2)
    sums = []
    for values in (np.cos(turns), np.sin(turns)):  # by Simpson's rule
        areas = (values[:-2:2] + 4 * values[1::2] + values[2::2]) * (length / steps / 6)
        sums.append(np.interp(along, grid[::2], np.concatenate(([0.0], np.cumsum(areas)))))
    return sums[0], sums[1], along * (first + along * change / 2)


def _poly3(along: Floats, length: float, a: float, b: float, c: float, d: float) -> tuple[Floats, Floats, Floats]:
    u = np.linspace(0.0, length, 513)
    v = a + u * (b + u * (c + u * d))
    far = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))))
    u = np.interp(along, far, u)
    return u, a + u * (b + u * (c + u * d)), np.arctan(b + u * (2 * c + u * 3 * d))


def _parametric(along: Floats, length: float, normalized: float, *factors: float) -> tuple[Floats, Floats, Floats]:
    p = along / max(length, 1e-9) if normalized else along
    (u0, u1, u2, u3), (v0, v1, v2, v3) = factors[:4], factors[4:]
    turn = np.arctan2(v1 + p * (2 * v2 + p * 3 * v3), u1 + p * (2 * u2 + p * 3 * u3))
    return u0 + p * (u1 + p * (u2 + p * u3)), v0 + p * (v1 + p * (v2 + p * v3)), turn


_LOCAL: Final[dict[str, Callable[..., tuple[Floats, Floats, Floats]]]] = {
    "spiral": _spiral,
    "poly3": _poly3,
    "paramPoly3": _parametric,
}
_SHAPES: Final[dict[str, Callable[[_Piece, Floats, Rounding], tuple[Floats, Floats, Floats]]]] = {
    "line": _line,
    "arc": _arc,
    **dict.fromkeys(_LOCAL, _by_local),
}


@dataclass(frozen=True, eq=False)
class Road:
    """A road.

    Attributes:
        id: The id in the file.
        junction: The id of its junction, or `OUTSIDE`.
        length: The length of its reference line.
        elevation: The height by the distance along the road.
        lane_offset: How far the central line is to the left of the reference line.
        sections: The sections, in their order.
        objects: The objects.
        signals: The signals, and references to signals.
        links: Whether a junction precedes the road, and whether one succeeds it.
        limits: The speed limits: the station from which on each applies, and the limit in m/s; NaN for none.
        predecessor: The id of the road or junction before it; None for none.
        successor: That of the one after it.
        keeps_left: Whether traffic keeps left on it: lanes to the left lead in its direction, those to the right against it.
    """

    id: str
    junction: str
    length: float
    elevation: Profile
    lane_offset: Profile
    sections: tuple[RoadSection, ...]
    objects: tuple[RoadObject, ...]
    signals: tuple[RoadSignal, ...]
    pieces: tuple[_Piece, ...]
    links: tuple[bool, bool]
    limits: tuple[tuple[float, float], ...]
    predecessor: int | None
    successor: int | None
    keeps_left: bool

    @cached_property
    def _starts(self) -> Floats:
        return np.array([piece.start for piece in self.pieces])

    @property
    def number(self) -> int:
        """The id as a number, as CARLA has it."""
        return _integer(self.id)

    @property
    def in_junction(self) -> bool:
        """Whether the road is part of a junction."""
        return self.junction != OUTSIDE

    def is_reverse(self, lane: int) -> bool:
        """Return whether the driving direction of a lane, by its number, is against that of the road."""
        return (lane < 0) if self.keeps_left else (lane > 0)

    def lanes_ahead(self, ahead: bool | None) -> tuple[tuple[int, int], ...]:
        """Return the range of the lanes in the direction of the road, against it, or in both directions."""
        if ahead is None:
            return ((-_HIGHEST, _HIGHEST),)
        return ((1, _HIGHEST),) if ahead == self.keeps_left else ((-_HIGHEST, -1),)

    def reference(self, stations: Floats, rounded: Rounding = double) -> tuple[Floats, Floats]:
        """Return the points of the reference line at stations, (n, 3), and its headings, (n,); with rounded coordinates."""
        points = np.empty((len(stations), 3))
        headings = np.empty(len(stations))
        if len(self.pieces) == 1:
            groups: list[tuple[int, slice | NDArray[np.int64]]] = [(0, slice(None))]
        else:
            index = np.maximum(np.searchsorted(self._starts, stations, "right") - 1, 0)
            order = np.argsort(index, kind="stable")
            cuts = np.flatnonzero(np.diff(index[order])) + 1
            groups = [(int(index[rows[0]]), rows) for rows in np.split(order, cuts) if len(rows)]
        for number, rows in groups:
            piece = self.pieces[number]
            points[rows, 0], points[rows, 1], headings[rows] = piece.at(stations[rows] - piece.start, rounded)
        points[:, 2] = rounded(self.elevation(stations))
        return points, headings

    def at(self, station: float, offset: float) -> tuple[Floats, float]:
        """Return the point at a distance to the left of the reference line, and the heading there."""
        points, headings = self.reference(np.array([min(max(station, 0.0), self.length)]))
        heading = float(headings[0])
        return points[0] + offset * np.array((-np.sin(heading), np.cos(heading), 0.0)), heading

    def outline(self, thing: RoadObject) -> Floats:
        """Return the corners of an object along its direction and to the left of it, (n, 2), relative to its position."""
        if len(thing.outline) or not len(thing.road_corners):
            return thing.outline
        middle, heading = self.at(thing.station, thing.offset)
        cos, sin = np.cos(heading + thing.heading), np.sin(heading + thing.heading)
        outline: Floats = (self.corners(thing) - middle)[:, :2] @ np.array(((cos, -sin), (sin, cos)))
        return outline

    def corners(self, thing: RoadObject) -> Floats:
        """Return the corners of an object by distances along the road and to the left of it, (n, 3)."""
        return np.array([self.at(*corner)[0] for corner in thing.road_corners.tolist()]).reshape(-1, 3)

    def breaks(self) -> list[float]:
        """Return the stations at which curvature, height or widths change abruptly."""
        found = [0.0, self.length, *(piece.start for piece in self.pieces)]
        found += [*self.elevation.starts.tolist(), *self.lane_offset.starts.tolist()]
        for section in self.sections:
            found += [section.start, section.end]
            for lane in (*section.left, *section.right):
                found += (section.start + lane.width.starts).tolist()
        return [station for station in found if 0.0 <= station <= self.length]


class Borders(NamedTuple):
    """The borders of the lanes of a section as points.

    Attributes:
        points: The points, from the left, (lanes + 1, n, 3).
        offsets: How far to the left of the reference line each border is, (lanes + 1, n).
        lefts: The directions to the left, (n, 3).
        headings: The directions of the road, (n,).
    """

    points: Floats
    offsets: Floats
    lefts: Floats
    headings: Floats


def borders_at(road: Road, section: RoadSection, stations: Floats) -> Borders:
    """Return the borders of the lanes of a section at stations."""
    points, headings = road.reference(stations)
    lefts = np.stack((-np.sin(headings), np.cos(headings), np.zeros(len(headings))), axis=1)
    offsets = section.borders(stations) + road.lane_offset(stations)
    return Borders(points + offsets[..., None] * lefts, offsets, lefts, headings)


class SparseSection(NamedTuple):
    """A section with stations, between which its lanes are nearly straight.

    Attributes:
        number: The number of the road among all.
        road: The road.
        section: The section.
        stations: The distances along the road, ascending, (n,).
    """

    number: int
    road: Road
    section: RoadSection
    stations: Floats


def sparse_sections(roads: Sequence[Road], spacing: float, most_examined: int, most: int) -> list[SparseSection]:
    """Return the sections of roads that have lanes, with stations.

    Args:
        roads: The roads.
        spacing: The distance in m between the points at which their course is examined.
        most_examined: The number of such points, above which they are farther apart.
        most: The number of lanes' parts between stations, above which the stations are farther apart.
    """
    spacing = max(spacing, sum(road.length for road in roads) / most_examined)
    found = [
        SparseSection(number, road, section, _sparse_stations(road, section, spacing))
        for number, road in enumerate(roads)
        for section in road.sections
        if section.lanes
    ]
    excess = sum((len(stations) - 1) * len(section.lanes) for _, _, section, stations in found) / most
    if excess > 1:
        found = [part._replace(stations=_thinned(part.stations, excess)) for part in found]
    return found


def _thinned(stations: Floats, excess: float) -> Floats:
    """Return as many times fewer stations."""
    last = len(stations) - 1
    return np.interp(np.linspace(0, last, max(int(last / excess), 1) + 1), np.arange(last + 1), stations)


def _sparse_stations(road: Road, section: RoadSection, spacing: float) -> Floats:
    """Return stations along a section, between which its outer borders and its middle are nearly straight."""
    start, end = section.start, section.end - BEFORE_END
    stations = np.linspace(start, end, max(int((end - start) / spacing), 3) + 1)
    lines = borders_at(road, section, stations).points[[0, len(section.left), -1]]
    step = stations[1] - stations[0]
    bends = np.linalg.norm(lines[:, 2:] - 2 * lines[:, 1:-1] + lines[:, :-2], axis=2).max(axis=0) / step**2
    bends = np.maximum(bends[:-1], bends[1:])  # of the parts between two stations
    bends = np.concatenate((bends[:1], bends, bends[-1:]))
    with np.errstate(divide="ignore"):
        steps = np.clip(np.sqrt(8 * _DENSE_TOLERANCE / bends), *_STEPS)
    numbers = np.concatenate(([0.0], np.cumsum(step / steps)))
    count = max(int(np.ceil(numbers[-1])), 1)
    return np.interp(np.linspace(0.0, numbers[-1], count + 1), numbers, stations)


def defined_signals(roads: Iterable[Road]) -> dict[str, tuple[Road, RoadSignal]]:
    """Return the signals by their ids, and the roads that they stand at; of several with an id, the last one as in CARLA."""
    return {signal.id: (road, signal) for road in roads for signal in road.signals if not signal.is_reference}


def in_carlas_order(numbers: Iterable[int]) -> list[int]:
    """Return ids, each once, in the order in which CARLA's library lists roads and connections: that of its hash tables."""
    sizes = iter(_BUCKETS)
    size, groups = next(sizes), dict[int, list[int]]()
    for count, number in enumerate(dict.fromkeys(numbers)):
        if count == size:
            size, ordered, groups = next(sizes), _listed(groups), {}
            for other in ordered:
                groups.setdefault(other % size, []).append(other)
        groups.setdefault(number % size, []).append(number)
    return _listed(groups)


def _listed(groups: Mapping[int, list[int]]) -> list[int]:
    """Return what is in the buckets of a hash table, the latest first."""
    return [number for group in reversed(list(groups.values())) for number in reversed(group)]


@dataclass
class OpenDrive:
    """The content of an OpenDRIVE file.

    Attributes:
        roads: The roads.
        connections: The ids of the roads through each junction, by its id, in CARLA's order.
        priorities: Which connecting roads of a junction have priority over which.
        controllers: The ids of the signals of each controller, in the order in which these follow each other.
    """

    roads: list[Road] = field(default_factory=list)
    connections: dict[int, list[int]] = field(default_factory=dict)
    priorities: dict[int, set[tuple[int, int]]] = field(default_factory=lambda: defaultdict(set))
    controllers: dict[str, list[str]] = field(default_factory=dict)


def read_opendrive(text: str | Iterable[str]) -> OpenDrive:
    """Return the content of an OpenDRIVE file.

    Args:
        text: The text of the file, or its parts.

    Raises:
        ValueError: It is no OpenDRIVE file, or it is too large.
    """
    found = OpenDrive()
    controllers: list[tuple[float, str, list[str]]] = []
    totals = _Totals()
    for element in read_elements(text):
        if element.tag == "road":
            with suppress(_InvalidError):
                road = _road(element)
                totals.add(road)
                found.roads.append(road)
        elif element.tag == "junction":
            id = _integer(element.get("id"))
            ways = found.connections.setdefault(id, [])
            by_id: dict[int, list[Element]] = {}
            for connection in element.findall("connection")[:_MOST_CONNECTIONS]:
                by_id.setdefault(_integer(connection.get("id")), []).append(connection)
            for connection in (each for number in in_carlas_order(by_id) for each in by_id[number]):
                ways.append(_integer(connection.get("connectingRoad")))
            for priority in element.findall("priority"):
                found.priorities[id].add((_integer(priority.get("high")), _integer(priority.get("low"))))
        else:
            signals = [control.get("signalId", "") for control in element.findall("control")]
            controllers.append((_number(element, "sequence", 0.0), element.get("id", ""), list(dict.fromkeys(signals))))
    for _, name, signals in sorted(controllers, key=lambda controller: controller[0]):
        found.controllers[name] = signals
    return found


class _Totals:
    """What the roads of a file have together."""

    def __init__(self) -> None:
        self._roads = self._sections = self._lanes = 0
        self._length = 0.0
        self._in_junction = defaultdict[str, int](int)

    def add(self, road: Road) -> None:
        """Count a road.

        Raises:
            ValueError: They have more than any town.
        """
        lanes = sum(len(section.lanes) for section in road.sections)
        self._roads += 1
        self._sections += len(road.sections)
        self._lanes += lanes
        self._length += lanes_length((road,))
        for name, value, most in (
            ("roads", self._roads, _MOST_ROADS),
            ("sections of lanes", self._sections, _MOST_SECTIONS),
            ("lanes", self._lanes, _MOST_LANES),
        ):
            if value > most:
                raise ValueError(f"at most {most:,} {name}, and it has more")
        if self._length > _LONGEST_LANES:
            raise ValueError(
                f"at most {_LONGEST_LANES / 1000:,.0f} km of lanes, and its first {self._roads:,} roads have "
                f"{self._length / 1000:,.0f} km"
            )
        if road.in_junction:
            self._in_junction[road.junction] += lanes
            if self._in_junction[road.junction] > _MOST_IN_JUNCTION:
                raise ValueError(
                    f"at most {_MOST_IN_JUNCTION} lanes in a junction, and {road.junction[:40]!r} has at least "
                    f"{self._in_junction[road.junction]}"
                )


def limit_lanes(roads: Iterable[Road], most: int) -> None:
    """Examine how many lanes roads have.

    Raises:
        ValueError: They have more than that.
    """
    count = sum(len(section.lanes) for road in roads for section in road.sections)
    if count > most:
        raise ValueError(f"at most {most:,} lanes to draw them or to drive on, and it has {count:,}")


def lanes_length(roads: Iterable[Road]) -> float:
    """Return the length of all lanes of roads, in m."""
    return sum((section.end - section.start) * len(section.lanes) for road in roads for section in road.sections)


class _InvalidError(Exception):
    """A road has no course that can be driven, and is left out."""


def _road(element: Element) -> Road:
    length = _number(element, "length", -1.0)
    if length > _LONGEST:
        raise ValueError(f"roads of at most {_LONGEST / 1000:.0f} km, and one is {length / 1000:,.0f} km long")
    pieces = tuple(sorted(filter(None, map(_piece, element.findall("planView/geometry"))), key=lambda piece: piece.start))
    sections = _sections(element.findall("lanes/laneSection")[: _MOST_SECTIONS + 1], length)
    if not length > 0.01 or not pieces or not sections:
        raise _InvalidError
    return Road(
        element.get("id", ""),
        element.get("junction", OUTSIDE),
        length,
        _profile(element.findall("elevationProfile/elevation"), "s", length, _FARTHEST, _STEEPEST),
        _profile(element.findall("lanes/laneOffset"), "s", length, _FARTHEST_ASIDE),
        sections,
        tuple(_object(found) for found in element.findall("objects/object")[:_MOST_RECORDS]),
        tuple(_signal(found) for found in element.findall("signals/*")[:_MOST_RECORDS]),
        pieces[:_MOST_RECORDS],
        tuple(any(link.get("elementType") == "junction" for link in element.findall(f"link/{end}")) for end in _ENDS),  # type: ignore[arg-type]
        tuple(_limits(element.findall("type")[:_MOST_RECORDS], "s", "speed")),
        _beyond(element, "predecessor"),
        _beyond(element, "successor"),
        element.get("rule") == _LEFT_HAND,
    )


def _beyond(element: Element, end: str) -> int | None:
    link = element.find(f"link/{end}")
    return None if link is None else _integer(link.get("elementId"))


def _piece(element: Element) -> _Piece | None:
    values = [_number(element, name, np.nan) for name in ("s", "x", "y", "hdg", "length")]
    shape = next(iter(element), None)
    if shape is None or not all(map(isfinite, values)) or max(map(abs, values)) > _FARTHEST or values[-1] < 0:
        return None
    names = {
        "line": (),
        "arc": ("curvature",),
        "spiral": ("curvStart", "curvEnd"),
        "poly3": ("a", "b", "c", "d"),
        "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
    }.get(shape.tag)
    if names is None:
        return None
    parameters = tuple(_number(shape, name, 0.0) for name in names)
    start, x, y, heading, length = values
    if not _is_drivable(shape.tag, parameters, length, of_share=shape.get("pRange") != "arcLength"):
        return None
    if shape.tag == "paramPoly3":
        parameters = (float(shape.get("pRange") != "arcLength"), *parameters)
    return _Piece(start, x, y, heading, length, shape.tag, parameters)


def _is_drivable(shape: str, parameters: Sequence[float], length: float, *, of_share: bool) -> bool:
    """Return whether a curve turns and bends no more than a road."""
    if shape in ("arc", "spiral"):
        return max(map(abs, parameters)) * length <= _MOST_TURNS
    reach = 1.0 if shape == "paramPoly3" and of_share else length
    return all(abs(value) * reach ** (n % 4) <= _STEEPEST * length + _STEEPEST for n, value in enumerate(parameters))


def _sections(elements: Sequence[Element], length: float) -> tuple[RoadSection, ...]:
    starts = [min(max(_number(element, "s", 0.0), 0.0), length) for element in elements]
    order = sorted(range(len(elements)), key=starts.__getitem__)
    sections = []
    for index, number in enumerate(order):
        end = starts[order[index + 1]] if index + 1 < len(order) else length
        if end - starts[number] < 1e-3:
            continue
        element = elements[number]
        left = sorted(_lanes(element, "left", end - starts[number]), key=lambda lane: lane.id)
        right = sorted(_lanes(element, "right", end - starts[number]), key=lambda lane: -lane.id)
        centre = next(iter(_lanes(element, "center", end - starts[number])), None)
        sections.append(RoadSection(index, starts[number], end, tuple(left), tuple(right), centre))
    return tuple(sections)


def _lanes(element: Element, side: str, length: float) -> list[RoadLane]:
    lanes = []
    for found in element.findall(f"{side}/lane")[:_MOST_OF_SIDE]:
        marks = [
            Marking(
                max(_number(mark, "sOffset", 0.0), 0.0),
                mark.get("type", "none").lower(),
                mark.get("color", "standard").lower(),
                min(max(_number(mark, "width", 0.25 if mark.get("weight") == "bold" else 0.12), 0.05), 0.6),
                mark.get("laneChange", "both").lower(),
            )
            for mark in found.findall("roadMark")[:_MOST_RECORDS]
        ]
        lanes.append(
            RoadLane(
                int(_number(found, "id", 0.0)),
                found.get("type", "none").lower(),
                _profile(found.findall("width"), "sOffset", length, _FARTHEST_ASIDE),
                tuple(_changes(sorted(marks, key=lambda mark: mark.start))),
                tuple(_limits(found.findall("speed")[:_MOST_RECORDS], "sOffset", ".")),
                *(_integer(None if (link := found.find(f"link/{end}")) is None else link.get("id")) for end in _ENDS),
            )
        )
    return lanes


def _changes(markings: Iterable[Marking]) -> Iterator[Marking]:
    """Yield the markings that differ from the one before."""
    last = None
    for mark in markings:
        if last is None or mark[1:] != last[1:]:
            yield mark
        last = mark


def _object(element: Element) -> RoadObject:
    outlines = [*element.findall("outline"), *element.findall("outlines/outline")]
    corners, on_road = (
        outlines[0].findall(tag)[:_MOST_CORNERS] if outlines else [] for tag in ("cornerLocal", "cornerRoad")
    )
    return RoadObject(
        id=element.get("id", ""),
        kind=element.get("type", "").lower(),
        name=element.get("name", ""),
        station=_number(element, "s", 0.0),
        offset=_number(element, "t", 0.0),
        height=_number(element, "zOffset", 0.0),
        heading=_number(element, "hdg", 0.0),
        width=_number(element, "width", 0.0),
        length=_number(element, "length", 0.0),
        outline=np.array([(_number(c, "u", 0.0), _number(c, "v", 0.0)) for c in corners], np.float64).reshape(-1, 2),
        road_corners=np.array([(_number(c, "s", 0.0), _number(c, "t", 0.0)) for c in on_road], np.float64).reshape(-1, 2),
        ahead=_AHEAD.get(element.get("orientation", "")),
    )


def _signal(element: Element) -> RoadSignal:
    ranges = [
        sorted((_integer(validity.get("fromLane")), _integer(validity.get("toLane"))))
        for validity in element.findall("validity")[:_MOST_CORNERS]
    ]
    return RoadSignal(
        id=element.get("id", ""),
        kind=element.get("type", ""),
        value=_number(element, "value", 0.0),
        station=_number(element, "s", 0.0),
        offset=_number(element, "t", 0.0),
        height=_number(element, "zOffset", 0.0),
        heading=_number(element, "hOffset", 0.0),
        ahead=_AHEAD.get(element.get("orientation", "")),
        lanes=tuple((first, last) for first, last in ranges),
        unit=element.get("unit", ""),
        name=element.get("name", ""),
        is_reference=element.tag == "signalReference",
    )


def _limits(elements: Iterable[Element], start: str, speed: str) -> Iterator[tuple[float, float]]:
    """Yield where speed limits begin, and the limits in m/s, in order; NaN for none."""
    for element in sorted(elements, key=lambda element: _number(element, start, 0.0)):
        found = element.find(speed)
        limit = None if found is None else in_metres_per_second(found.get("max"), found.get("unit"))
        yield _number(element, start, 0.0), nan if limit is None else limit


def in_metres_per_second(value: str | float | None, unit: str | None) -> float | None:
    """Return a speed limit in m/s; None if there is no such limit.

    Args:
        value: A number, or a word such as `undefined`.
        unit: `m/s`, `km/h` or `mph`; without one, OpenDRIVE means m/s.
    """
    try:
        limit = float(value or "") * _UNITS.get(unit or "m/s", 1.0)
    except ValueError:
        return None
    return limit if _SLOWEST <= limit < _FASTEST else None


def _profile(elements: Iterable[Element], start: str, end: float, most: float, steepest: float = np.inf) -> Profile:
    """Return the function of some records up to an end.

    Args:
        elements: The records.
        start: The attribute that says where a record begins.
        end: The end of the last one.
        most: The largest absolute value of a term.
        steepest: The largest absolute value of a term, but of the first one, for each m of the record and one more.

    Raises:
        _InvalidError: A coefficient is no number, or too large.
    """
    records: list[tuple[float, Coefficients]] = []
    for element in elements:
        a, b, c, d = (_number(element, name, nan) if name in element.attrib else 0.0 for name in "abcd")
        records.append((_number(element, start, 0.0), (a, b, c, d)))
    records.sort(key=lambda record: record[0])
    ends = [*(record[0] for record in records[1:]), end]
    for (first, (a, b, c, d)), last in zip(records, ends, strict=False):
        length = max(last - first, 0.0)
        bend = max(abs(b) * length, abs(c) * length**2, abs(d) * length**3)
        if not (max(abs(a), bend) <= most and bend <= steepest * (length + 1)):
            raise _InvalidError
    return Profile(records)


def _integer(text: str | None) -> int:
    """Return a number of a road or lane; 0 where it is none."""
    try:
        value = int(text or "")
    except ValueError:
        return 0
    return value if abs(value) < 1 << 31 else 0


def _number(element: Element, name: str, default: float) -> float:
    try:
        value = float(element.get(name, ""))
    except ValueError:
        return default
    return value if abs(value) < 1e9 else default
