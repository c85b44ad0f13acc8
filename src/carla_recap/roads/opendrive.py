"""The roads of an OpenDRIVE file as curves, evaluated from its records: lanes, markings, objects and signals.

Units are m and radians; axes are right-handed: x forward, y left, z up. As in CARLA, roads are level from side to side.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import TYPE_CHECKING, Final, NamedTuple
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Coefficients = tuple[float, float, float, float]

OUTSIDE: Final = "-1"
"""The junction of a road that is in none."""

# The types of signals in CARLA's maps.
LIGHT: Final = "1000001"
STOP: Final = "206"
YIELD: Final = "205"
SPEED_LIMIT: Final = "274"

_MOST_ROADS: Final = 20_000
_MOST_SECTIONS: Final = 2_000  # of a road
_MOST_LANES: Final = 40  # on one side
_MOST_RECORDS: Final = 20_000  # of one kind, of a road
_MOST_CORNERS: Final = 100
_LONGEST: Final = 100_000.0  # m
_WIDEST: Final = 200.0  # m of a lane
_FARTHEST: Final = 1e6  # m from the origin
_UNITS: Final = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}
_SLOWEST: Final = 0.5  # m/s: what is slower is no limit
_FASTEST: Final = 1e9  # m/s
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
        if not len(self.starts):
            return np.zeros(len(stations))
        index = np.maximum(np.searchsorted(self.starts, stations, "right") - 1, 0)
        along = stations - self.starts[index]
        a, b, c, d = self._coefficients[index].T
        values: Floats = a + along * (b + along * (c + along * d))
        return values


class Marking(NamedTuple):
    """A marking along the outer border of a lane.

    Attributes:
        start: The distance from the start of the section at which it begins.
        kind: The OpenDRIVE type, such as `solid` or `broken`, lower-case.
        color: The OpenDRIVE colour, such as `standard` or `yellow`, lower-case.
        width: The width of a line.
    """

    start: float
    kind: str
    color: str
    width: float


@dataclass(frozen=True, eq=False)
class RoadLane:
    """A lane of a section.

    Attributes:
        id: Its number, ascending to the left of the road; 0 is the line between 1 and -1, without a width.
        kind: The OpenDRIVE type, such as `driving`, lower-case.
        width: The width by the distance from the start of the section.
        markings: The markings along its outer border, in their order.
        limits: Its speed limits in m/s, each with the distance from the start of the section from which on it applies.
    """

    id: int
    kind: str
    width: Profile
    markings: tuple[Marking, ...]
    limits: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class RoadSection:
    """A part of a road along which the lanes are the same.

    Attributes:
        start: The distance along the road at which it begins.
        end: That at which it ends.
        left: The lanes to the left, from the inside.
        right: The lanes to the right, from the inside.
        centre: The lane without a width in between, or None.
    """

    start: float
    end: float
    left: tuple[RoadLane, ...]
    right: tuple[RoadLane, ...]
    centre: RoadLane | None

    def borders(self, stations: Floats) -> Floats:
        """Return how far to the left of the central line each border is: (lanes + 1, n), from the left."""
        along = stations - self.start
        left = np.cumsum([np.zeros(len(along)), *(_width(lane, along) for lane in self.left)], axis=0)
        right = np.cumsum([np.zeros(len(along)), *(_width(lane, along) for lane in self.right)], axis=0)
        offsets: Floats = np.concatenate((left[::-1], -right[1:]))
        return offsets


def _width(lane: RoadLane, along: Floats) -> Floats:
    return np.clip(lane.width(along), 0.0, _WIDEST)


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


@dataclass(frozen=True)
class RoadSignal:
    """A traffic light or sign, or a reference to one of another road.

    Attributes:
        id: The id in the file.
        kind: The OpenDRIVE type, such as 1000001 for a traffic light; empty for a reference.
        value: The value, such as a speed.
        station: The distance along the road.
        offset: The distance to the left of the reference line.
        height: The height above the road.
        heading: The direction relative to that of the road, or against it.
        ahead: Whether it applies in the direction of the road: True, False (against it), or None (in both directions).
        lanes: The ranges of lanes for which it applies; none for all.
        unit: The unit of the value, such as km/h; empty without one.
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

    def at(self, along: Floats) -> tuple[Floats, Floats, Floats]:
        """Return x, y and heading at distances from the start of the piece."""
        u, v, turn = _LOCAL[self.kind](along, self.length, *self.parameters)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return self.x + u * cos - v * sin, self.y + u * sin + v * cos, self.heading + turn


def _line(along: Floats, _: float) -> tuple[Floats, Floats, Floats]:
    return along, np.zeros_like(along), np.zeros_like(along)


def _arc(along: Floats, _: float, curvature: float) -> tuple[Floats, Floats, Floats]:
    if abs(curvature) < 1e-9:
        return _line(along, 0.0)
    turn = along * curvature
    return np.sin(turn) / curvature, (1 - np.cos(turn)) / curvature, turn


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
    "line": _line,
    "arc": _arc,
    "spiral": _spiral,
    "poly3": _poly3,
    "paramPoly3": _parametric,
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
    links: tuple[bool, bool] = (False, False)
    limits: tuple[tuple[float, float], ...] = ()

    @property
    def in_junction(self) -> bool:
        """Whether the road is part of a junction."""
        return self.junction != OUTSIDE

    def reference(self, stations: Floats) -> tuple[Floats, Floats]:
        """Return the points of the reference line at stations, (n, 3), and its headings, (n,)."""
        points = np.empty((len(stations), 3))
        headings = np.empty(len(stations))
        starts = np.array([piece.start for piece in self.pieces])
        index = np.clip(np.searchsorted(starts, stations, "right") - 1, 0, len(starts) - 1)
        for number in np.unique(index).tolist():
            here = index == number
            piece = self.pieces[number]
            points[here, 0], points[here, 1], headings[here] = piece.at(np.maximum(stations[here] - piece.start, 0.0))
        points[:, 2] = self.elevation(stations)
        return points, headings

    def at(self, station: float, offset: float) -> tuple[Floats, float]:
        """Return the point at a distance to the left of the reference line, and the heading there."""
        points, headings = self.reference(np.array([min(max(station, 0.0), self.length)]))
        heading = float(headings[0])
        return points[0] + offset * np.array((-np.sin(heading), np.cos(heading), 0.0)), heading

    def breaks(self) -> list[float]:
        """Return the stations at which curvature, height or widths change abruptly."""
        found = [0.0, self.length, *(piece.start for piece in self.pieces)]
        found += [*self.elevation.starts.tolist(), *self.lane_offset.starts.tolist()]
        for section in self.sections:
            found += [section.start, section.end]
            for lane in (*section.left, *section.right):
                found += (section.start + lane.width.starts).tolist()
        return [station for station in found if 0.0 <= station <= self.length]


def sparse_stations(stations: Floats, lines: Floats) -> Floats:
    """Return stations between which lines are nearly straight.

    Args:
        stations: Stations at equal distances, (n,).
        lines: Lines with a point at each of them, (lines, n, 3).
    """
    step = stations[1] - stations[0]
    bends = np.linalg.norm(lines[:, 2:] - 2 * lines[:, 1:-1] + lines[:, :-2], axis=2).max(axis=0) / step**2
    bends = np.maximum(bends[:-1], bends[1:])  # of the parts between two stations
    bends = np.concatenate((bends[:1], bends, bends[-1:]))
    with np.errstate(divide="ignore"):
        steps = np.clip(np.sqrt(8 * _DENSE_TOLERANCE / bends), *_STEPS)
    numbers = np.concatenate(([0.0], np.cumsum(step / steps)))
    count = max(int(np.ceil(numbers[-1])), 1)
    return np.interp(np.linspace(0.0, numbers[-1], count + 1), numbers, stations)


def read_roads(text: str) -> list[Road]:
    """Return the roads of an OpenDRIVE file, without those that have invalid numbers.

    Raises:
        ValueError: It is no OpenDRIVE file.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"the XML is invalid: {error}") from None
    if root.tag != "OpenDRIVE":
        raise ValueError(f"the root element is {root.tag[:40]!r}")
    roads = []
    for element in root.findall("road")[:_MOST_ROADS]:
        road = _road(element)
        if road is not None:
            roads.append(road)
    return roads


def _road(element: ElementTree.Element) -> Road | None:
    length = _number(element, "length", -1.0)
    pieces = tuple(sorted(filter(None, map(_piece, element.findall("planView/geometry"))), key=lambda piece: piece.start))
    if not 0.01 < length <= _LONGEST or not pieces:
        return None
    sections = _sections(element.findall("lanes/laneSection")[:_MOST_SECTIONS], length)
    if not sections:
        return None
    return Road(
        element.get("id", ""),
        element.get("junction", OUTSIDE),
        length,
        _profile(element.findall("elevationProfile/elevation"), "s"),
        _profile(element.findall("lanes/laneOffset"), "s"),
        sections,
        tuple(_object(found) for found in element.findall("objects/object")[:_MOST_RECORDS]),
        tuple(_signal(found) for found in element.findall("signals/*")[:_MOST_RECORDS]),
        pieces[:_MOST_RECORDS],
        tuple(any(link.get("elementType") == "junction" for link in element.findall(f"link/{end}")) for end in _ENDS),  # type: ignore[arg-type]
        tuple(_limits(element.findall("type")[:_MOST_RECORDS], "s", "speed")),
    )


def _piece(element: ElementTree.Element) -> _Piece | None:
    values = [_number(element, name, np.nan) for name in ("s", "x", "y", "hdg", "length")]
    shape = next(iter(element), None)
    if shape is None or not all(map(isfinite, values)) or max(map(abs, values)) > _FARTHEST:
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
    if shape.tag == "paramPoly3":
        parameters = (float(shape.get("pRange") != "arcLength"), *parameters)
    start, x, y, heading, length = values
    return _Piece(start, x, y, heading, length, shape.tag, parameters)


def _sections(elements: Sequence[ElementTree.Element], length: float) -> tuple[RoadSection, ...]:
    starts = [min(max(_number(element, "s", 0.0), 0.0), length) for element in elements]
    order = sorted(range(len(elements)), key=starts.__getitem__)
    sections = []
    for index, number in enumerate(order):
        end = starts[order[index + 1]] if index + 1 < len(order) else length
        if end - starts[number] < 1e-3:
            continue
        element = elements[number]
        left = sorted(_lanes(element, "left"), key=lambda lane: lane.id)
        right = sorted(_lanes(element, "right"), key=lambda lane: -lane.id)
        centre = next(iter(_lanes(element, "center")), None)
        sections.append(RoadSection(starts[number], end, tuple(left), tuple(right), centre))
    return tuple(sections)


def _lanes(element: ElementTree.Element, side: str) -> list[RoadLane]:
    lanes = []
    for found in element.findall(f"{side}/lane")[:_MOST_LANES]:
        marks = [
            Marking(
                max(_number(mark, "sOffset", 0.0), 0.0),
                mark.get("type", "none").lower(),
                mark.get("color", "standard").lower(),
                min(max(_number(mark, "width", 0.25 if mark.get("weight") == "bold" else 0.12), 0.05), 0.6),
            )
            for mark in found.findall("roadMark")[:_MOST_RECORDS]
        ]
        lanes.append(
            RoadLane(
                int(_number(found, "id", 0.0)),
                found.get("type", "none").lower(),
                _profile(found.findall("width"), "sOffset"),
                tuple(_changes(sorted(marks, key=lambda mark: mark.start))),
                tuple(_limits(found.findall("speed")[:_MOST_RECORDS], "sOffset", ".")),
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


def _object(element: ElementTree.Element) -> RoadObject:
    outlines = [*element.findall("outline"), *element.findall("outlines/outline")]
    corners = outlines[0].findall("cornerLocal")[:_MOST_CORNERS] if outlines else []
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
    )


def _signal(element: ElementTree.Element) -> RoadSignal:
    ranges = [
        sorted((int(_number(validity, "fromLane", 0.0)), int(_number(validity, "toLane", 0.0))))
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
        ahead={"+": True, "-": False}.get(element.get("orientation", "")),
        lanes=tuple((first, last) for first, last in ranges),
        unit=element.get("unit", ""),
    )


def _limits(elements: Iterable[ElementTree.Element], start: str, speed: str) -> Iterator[tuple[float, float]]:
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


def _profile(elements: Iterable[ElementTree.Element], start: str) -> Profile:
    return Profile(
        (_number(element, start, 0.0), tuple(_number(element, name, 0.0) for name in "abcd"))  # type: ignore[misc]
        for element in elements
    )


def _number(element: ElementTree.Element, name: str, default: float) -> float:
    try:
        value = float(element.get(name, ""))
    except ValueError:
        return default
    return value if abs(value) < 1e9 else default
