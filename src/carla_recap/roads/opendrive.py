"""The reader of OpenDRIVE files: roads as curves with lanes, markings, objects and signals; junctions; controllers.

Units are m and radians; axes are right-handed: x forward, y left, z up. As in CARLA, roads are level from side to side.
Attributes are read as by CARLA's library: a number is what a text begins with. A file that is too large is refused, as is a
number that no road has; a road without a course or without lanes is left out.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.roads.curves import PARAMETERS, Curve, Profile, double
from carla_recap.roads.elements import read_elements

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from xml.etree.ElementTree import Element

    from carla_recap.roads.curves import Rounding
    from carla_recap.util.arrays import Floats

OUTSIDE: Final = "-1"
"""The junction of a road that is in none."""

BEFORE_END: Final = 1e-6
"""How far before the end of a section its last station is, in m."""

# The types of signals in CARLA's maps.
LIGHT: Final = "1000001"
STOP: Final = "206"
YIELD: Final = "205"
SPEED_LIMIT: Final = "274"

# CARLA's small towns have about 100 roads, and 20 km of lanes. Its large maps are 10 km by 10 km: a road of Town12 has the
# number 10,915.
_MAX_OF_FILE: Final = {"roads": 16_000, "sections of lanes": 20_000, "lanes": 80_000, "m of lanes": 4_000_000}
_MAX_LANES_OF_SIDE: Final = 40
_MAX_LANES_OF_JUNCTION: Final = 500  # CARLA's have up to 60
_HIGHEST: Final = (1 << 31) - 1  # number of a lane
_MAX_RECORDS: Final = 20_000  # of one kind, of a road or junction
_MIN_LENGTH: Final = 0.01  # m of a road
_MAX_LENGTH: Final = 40_000.0  # m of a road
_MIN_SECTION: Final = 1e-3  # m
_FARTHEST: Final = 1e6  # m from the origin
_FARTHEST_ASIDE: Final = 1_000.0  # m that a term of a width or of an offset of lanes may add
_STEEPEST: Final = 10.0  # m that a term of a height may add for each m along it
_MAX_NUMBER: Final = 1e9
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
_LIMIT_OBJECT: Final = re.compile(r"[Ss]peed_(?:STATIC_)?(\d+(?:\.\d+)?)")
_NUMBER: Final = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_WHOLE_NUMBER: Final = re.compile(r"\s*([+-]?\d{1,10})", re.ASCII)


class Marking(NamedTuple):
    """A marking along the outer border of a lane."""

    start: float  # the distance from the start of the section at which it begins
    kind: str  # the OpenDRIVE type, such as `solid` or `broken`, lower-case
    color: str  # the OpenDRIVE colour, such as `standard` or `yellow`, lower-case
    width: float  # the width of a line
    changes: str = "both"  # between which lanes it allows to change: `increase`, `decrease`, `both` or `none`


@dataclass(frozen=True, eq=False)
class RoadLane:
    """A lane of a section."""

    id: int  # its number, ascending to the left of the road; 0 is the line between 1 and -1, without a width
    kind: str  # the OpenDRIVE type, such as `driving`, lower-case
    width: Profile  # the width by the distance from the start of the section
    markings: tuple[Marking, ...]  # the markings along its outer border, in their order
    limits: tuple[tuple[float, float], ...]  # the speed limits: from which distance on, and the limit in m/s
    predecessor: int  # the number of the lane before it, in the direction of the road; 0 for none
    successor: int  # that of the lane after it


@dataclass(frozen=True, eq=False)
class RoadSection:
    """A part of a road along which the lanes are the same."""

    number: int  # which section of the road it is, counted from 0
    start: float  # the distance along the road at which it begins
    end: float  # that at which it ends
    left: tuple[RoadLane, ...]  # the lanes to the left, from the inside
    right: tuple[RoadLane, ...]  # the lanes to the right, from the inside
    centre: RoadLane | None  # the lane without a width in between, or None

    @property
    def lanes(self) -> tuple[RoadLane, ...]:
        """The lanes that have a width, from the left."""
        return (*self.left[::-1], *self.right)

    def borders(self, stations: Floats) -> Floats:
        """Return how far to the left of the central line each border is: (lanes + 1, n), from the left."""
        along = stations - self.start
        left, right = (
            np.cumsum([np.zeros(len(along)), *(np.maximum(lane.width(along), 0.0) for lane in lanes)], axis=0)
            for lanes in (self.left, self.right)
        )
        return np.concatenate((left[::-1], -right[1:]))


@dataclass(frozen=True, eq=False)
class RoadObject:
    """An object beside or on a road."""

    id: str  # the id in the file
    kind: str  # the OpenDRIVE type, such as `crosswalk`, lower-case
    name: str  # the name, such as `StopLine`
    station: float  # the distance along the road
    offset: float  # the distance to the left of the reference line
    height: float  # the height above the road
    heading: float  # the direction relative to the road
    width: float  # the extent across its direction
    length: float  # the extent along its direction
    outline: Floats  # the corners along its direction, to the left of it and above it, (n, 3); relative to its position
    road_corners: Floats  # the corners, of an outline of distances along the road and to the left of it, (n, 2)
    ahead: bool | None  # whether it applies in the direction of the road (True), against it (False), or both ways

    @property
    def speed_limit(self) -> float | None:
        """The number on it in km/h, if it is a speed-limit sign, as in CARLA's towns."""
        named = _LIMIT_OBJECT.match(self.name)
        return float(named[1]) if named else None


@dataclass(frozen=True)
class RoadSignal:
    """A traffic light or sign, or a reference to one of another road."""

    id: str  # the id in the file
    kind: str  # the OpenDRIVE type, such as 1000001 for a traffic light
    value: float  # the value, such as a speed
    station: float  # the distance along the road
    offset: float  # the distance to the left of the reference line
    height: float  # the height above the road
    heading: float  # the direction relative to that of the road, or against it
    ahead: bool | None  # whether it applies in the direction of the road (True), against it (False), or both ways
    lanes: tuple[tuple[int, int], ...]  # the ranges of lanes for which it applies; none for all
    inertial: tuple[float, float, float, float] | None = None  # x, y, z and heading, if the file has its place in the world
    unit: str = ""  # the unit of the value, such as km/h; empty without one
    name: str = ""
    is_reference: bool = False


@dataclass(frozen=True, eq=False)
class Road:
    """A road."""

    id: str  # the id in the file
    junction: str  # the id of its junction, or `OUTSIDE`
    length: float  # the length of its reference line
    elevation: Profile  # the height by the distance along the road
    lane_offset: Profile  # how far the central line is to the left of the reference line
    sections: tuple[RoadSection, ...]  # the sections, in their order
    objects: tuple[RoadObject, ...]
    signals: tuple[RoadSignal, ...]  # the signals, and references to signals
    curves: tuple[Curve, ...]
    links: tuple[bool, bool]  # whether a junction precedes the road, and whether one succeeds it
    limits: tuple[tuple[float, float], ...]  # the speed limits: from which station on, and the limit in m/s; NaN for none
    predecessor: int | None  # the id of the road or junction before it; None for none
    successor: int | None  # that of the one after it
    keeps_left: bool  # whether traffic keeps left on it: lanes to the left lead in its direction, others against it

    @property
    def number(self) -> int:
        """The id as a number, as CARLA has it."""
        return road_number(self.id)

    @property
    def junction_number(self) -> int:
        """The id of the junction as a number, as CARLA has it."""
        return whole_number(self.junction)

    @property
    def in_junction(self) -> bool:
        """Whether the road is part of a junction."""
        return self.junction_number != int(OUTSIDE)

    def is_reverse(self, lane: int) -> bool:
        """Return whether the driving direction of a lane, by its number, is against that of the road."""
        return (lane < 0) if self.keeps_left else (lane > 0)

    def lanes_ahead(self, ahead: bool | None) -> tuple[tuple[int, int], ...]:
        """Return the range of the lanes in the direction of the road, against it, or in both directions."""
        if ahead is None:
            return ((-_HIGHEST, _HIGHEST),)
        return ((1, _HIGHEST),) if ahead == self.keeps_left else ((-_HIGHEST, -1),)

    @cached_property
    def _starts(self) -> Floats:
        return np.array([curve.start for curve in self.curves])

    def reference(self, stations: Floats, rounded: Rounding = double) -> tuple[Floats, Floats]:
        """Return the points of the reference line at stations, (n, 3), and its headings, (n,); with rounded coordinates."""
        points, headings = np.empty((len(stations), 3)), np.empty(len(stations))
        index = np.maximum(np.searchsorted(self._starts, stations, "right") - 1, 0)
        order = np.argsort(index, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(index[order])) + 1):
            if len(rows):
                curve = self.curves[index[rows[0]]]
                points[rows, 0], points[rows, 1], headings[rows] = curve.at(stations[rows] - curve.start, rounded)
        points[:, 2] = rounded(self.elevation(stations))
        return points, headings

    def at(self, station: float, offset: float) -> tuple[Floats, float]:
        """Return the point at a distance to the left of the reference line, and the heading there."""
        points, headings = self.reference(np.array([min(max(station, 0.0), self.length)]))
        heading = float(headings[0])
        return points[0] + offset * np.array((-np.sin(heading), np.cos(heading), 0.0)), heading

    def place_of(self, signal: RoadSignal) -> tuple[Floats, float]:
        """Return where a signal of the road is, and the direction of the traffic that it is for."""
        if signal.inertial is not None:
            return np.array(signal.inertial[:3]), signal.inertial[3]
        point, heading = self.at(signal.station, signal.offset)
        return point, heading + signal.heading

    def outline(self, thing: RoadObject) -> Floats:
        """Return the corners of an object along its direction and to the left of it, (n, 2), relative to its position."""
        if len(thing.outline) or not len(thing.road_corners):
            return thing.outline[:, :2]
        middle, heading = self.at(thing.station, thing.offset)
        cos, sin = np.cos(heading + thing.heading), np.sin(heading + thing.heading)
        outline: Floats = (self.corners(thing) - middle)[:, :2] @ np.array(((cos, -sin), (sin, cos)))
        return outline

    def corners(self, thing: RoadObject) -> Floats:
        """Return the corners of an object by distances along the road and to the left of it, (n, 3)."""
        return np.array([self.at(*corner)[0] for corner in thing.road_corners.tolist()]).reshape(-1, 3)

    def breaks(self) -> list[float]:
        """Return the stations at which curvature, height or widths change abruptly."""
        found = [0.0, self.length, *self._starts.tolist()]
        found += [*self.elevation.starts.tolist(), *self.lane_offset.starts.tolist()]
        for section in self.sections:
            found += [section.start, section.end]
            for lane in (*section.left, *section.right):
                found += (section.start + lane.width.starts).tolist()
        return [station for station in found if 0.0 <= station <= self.length]


class Borders(NamedTuple):
    """The borders of the lanes of a section as points."""

    points: Floats  # the points, from the left, (lanes + 1, n, 3)
    offsets: Floats  # how far to the left of the reference line each border is, (lanes + 1, n)
    lefts: Floats  # the directions to the left, (n, 3)
    headings: Floats  # the directions of the road, (n,)


def borders_at(road: Road, section: RoadSection, stations: Floats) -> Borders:
    """Return the borders of the lanes of a section at stations."""
    points, headings = road.reference(stations)
    lefts = np.stack((-np.sin(headings), np.cos(headings), np.zeros(len(headings))), axis=1)
    offsets = section.borders(stations) + road.lane_offset(stations)
    return Borders(points + offsets[..., None] * lefts, offsets, lefts, headings)


class SparseSection(NamedTuple):
    """A section with stations, between which its lanes are nearly straight."""

    number: int  # the number of the road among all
    road: Road
    section: RoadSection
    stations: Floats  # the distances along the road, ascending, (n,)


def sparse_sections(roads: Sequence[Road], spacing: float, most_examined: int, most: int) -> list[SparseSection]:
    """Return the sections of roads that have lanes, with stations.

    Their course is examined each `spacing` m, farther apart where that were too many points. Where the parts of lanes
    between stations were more than `most`, the stations are farther apart.
    """
    length = sum(road.length for road in roads)
    if length > most_examined * spacing:
        message = f"{length / 1000:,.0f} km of roads are examined at {most_examined:,} points, more than {spacing:g} m apart"
        warnings.warn(message, RecapWarning, stacklevel=2)
        spacing = length / most_examined
    found = [
        SparseSection(number, road, section, _sparse_stations(road, section, spacing))
        for number, road in enumerate(roads)
        for section in road.sections
        if section.lanes
    ]
    excess = sum((len(stations) - 1) * len(section.lanes) for _, _, section, stations in found) / most
    if excess > 1:
        message = f"the lanes have {most:,} straight parts: {excess:.1f} times as many would follow their bends"
        warnings.warn(message, RecapWarning, stacklevel=2)
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
    """The content of an OpenDRIVE file."""

    roads: list[Road] = field(default_factory=list)
    # The ids of the roads through each junction, by its id, in CARLA's order.
    connections: dict[int, list[int]] = field(default_factory=dict)
    # Which connecting roads of a junction have priority over which.
    priorities: dict[int, set[tuple[int, int]]] = field(default_factory=lambda: defaultdict(set))
    # The ids of the signals of each controller, in the order in which these follow each other.
    controllers: dict[str, list[str]] = field(default_factory=dict)


def read_opendrive(text: str | Iterable[str]) -> OpenDrive:
    """Return the content of the text of an OpenDRIVE file, or of its parts.

    A `ValueError` says that it is none or is too large, or which number in it is none that a road can have.
    """
    found = OpenDrive()
    controllers: list[tuple[float, str, list[str]]] = []
    counts = Counter[str]()
    for element in read_elements(text):
        try:
            if element.tag == "road":
                if (road := _road(element)) is not None:
                    _count(counts, road)
                    found.roads.append(road)
            elif element.tag == "junction":
                _add_junction(found, element)
            else:
                signals = [control.get("signalId", "") for control in element.findall("control")]
                controllers.append((_number(element, "sequence"), element.get("id", ""), list(dict.fromkeys(signals))))
        except _ContentError as error:
            raise ValueError(f"{element.tag} {element.get('id', '')[:40]!r}: {error}") from None
    for _, name, signals in sorted(controllers, key=lambda controller: controller[0]):
        found.controllers[name] = signals
    return found


class _ContentError(Exception):
    """An element has content that no map has."""


def _add_junction(found: OpenDrive, element: Element) -> None:
    id = whole_number(element.get("id"))
    by_id: dict[int, list[int]] = {}
    for connection in _all(element, "connection"):
        by_id.setdefault(whole_number(connection.get("id")), []).append(road_number(connection.get("connectingRoad")))
    found.connections.setdefault(id, []).extend(road for number in in_carlas_order(by_id) for road in by_id[number])
    for priority in _all(element, "priority"):
        found.priorities[id].add((road_number(priority.get("high")), road_number(priority.get("low"))))


def _count(counts: Counter[str], road: Road) -> None:
    """Add a road to the counts of a file, which has no more than any town."""
    lanes = sum(len(section.lanes) for section in road.sections)
    counts.update({"roads": 1, "sections of lanes": len(road.sections), "lanes": lanes})
    counts["m of lanes"] += round(lanes_length((road,)))
    most = dict(_MAX_OF_FILE)
    if road.in_junction:
        of_junction = f"lanes in a junction such as {road.junction[:40]!r}"
        counts[of_junction] += lanes
        most[of_junction] = _MAX_LANES_OF_JUNCTION
    for name, number in most.items():
        if counts[name] > number:
            raise ValueError(f"at most {number:,} {name}, and it has {counts[name]:,} and more")


def limit_lanes(roads: Iterable[Road], most: int) -> None:
    """Raise a `ValueError` if roads have more lanes."""
    count = sum(len(section.lanes) for road in roads for section in road.sections)
    if count > most:
        raise ValueError(f"at most {most:,} lanes to draw them or to drive on, and it has {count:,}")


def lanes_length(roads: Iterable[Road]) -> float:
    """Return the length of all lanes of roads, in m."""
    return sum((section.end - section.start) * len(section.lanes) for road in roads for section in road.sections)


def _road(element: Element) -> Road | None:
    """Return a road; None if it has no course or no lanes."""
    length = _number(element, "length")
    if length > _MAX_LENGTH:
        raise _ContentError(f"roads of at most {_MAX_LENGTH / 1000:.0f} km, and one is {length / 1000:,.0f} km long")
    curves = sorted(filter(None, map(_curve, _all(element, "planView/geometry"))), key=lambda curve: curve.start)
    sections = _sections(element, length)
    if not length > _MIN_LENGTH or not curves or not sections:
        return None
    before, after = (element.find(f"link/{end}") for end in _ENDS)
    return Road(
        element.get("id", ""),
        element.get("junction", "0"),  # as in CARLA
        length,
        _profile(element, "elevationProfile/elevation", "s", length, _FARTHEST, _STEEPEST),
        _profile(element, "lanes/laneOffset", "s", length, _FARTHEST_ASIDE),
        sections,
        tuple(map(_object, _all(element, "objects/object"))),
        tuple(map(_signal, _all(element, "signals/*"))),
        tuple(curves),
        (_is_junction(before), _is_junction(after)),
        _limits(element, "type", "s", "speed"),
        None if before is None else road_number(before.get("elementId")),
        None if after is None else road_number(after.get("elementId")),
        element.get("rule") == _LEFT_HAND,
    )


def _is_junction(link: Element | None) -> bool:
    return link is not None and link.get("elementType") == "junction"


def _curve(element: Element) -> Curve | None:
    """Return a part of a reference line; None if its kind is unknown, or it has no length."""
    shape = next((child for child in element if child.tag in PARAMETERS), None)
    if shape is None:
        return None
    place = _numbers(element, start="s", x="x", y="y", heading="hdg", length="length")
    if max(map(abs, place.values())) > _FARTHEST:
        raise _ContentError(f"geometry: expected numbers of at most {_FARTHEST:,.0f}, found {tuple(place.values())}")
    if place["length"] <= 0:
        return None
    end = 1.0 if shape.tag == "paramPoly3" and shape.get("pRange") != "arcLength" else place["length"]
    parameters = tuple(_number(shape, name) for name in PARAMETERS[shape.tag])
    curve = Curve(**place, kind=shape.tag, parameters=parameters, end=end)
    if not curve.is_drivable():
        raise _ContentError(f"{shape.tag}: expected a curve that a road has, found {parameters}")
    return curve


def _sections(element: Element, length: float) -> tuple[RoadSection, ...]:
    elements = _all(element, "lanes/laneSection")
    starts = [min(max(_number(each, "s"), 0.0), length) for each in elements]
    order = sorted(range(len(elements)), key=starts.__getitem__)
    sections = []
    for index, number in enumerate(order):
        start, end = starts[number], starts[order[index + 1]] if index + 1 < len(order) else length
        if end - start >= _MIN_SECTION:
            left, centre, right = (_lanes(elements[number], side, end - start) for side in ("left", "center", "right"))
            left.sort(key=lambda lane: lane.id)
            right.sort(key=lambda lane: -lane.id)
            sections.append(RoadSection(index, start, end, tuple(left), tuple(right), next(iter(centre), None)))
    return tuple(sections)


def _lanes(element: Element, side: str, length: float) -> list[RoadLane]:
    return [
        RoadLane(
            whole_number(lane.get("id")),
            lane.get("type", "none").lower(),
            _profile(lane, "width", "sOffset", length, _FARTHEST_ASIDE),
            tuple(_changes(sorted(map(_marking, _all(lane, "roadMark")), key=lambda mark: mark.start))),
            _limits(lane, "speed", "sOffset", "."),
            *(whole_number(None if (link := lane.find(f"link/{end}")) is None else link.get("id")) for end in _ENDS),
        )
        for lane in _all(element, f"{side}/lane", _MAX_LANES_OF_SIDE)
    ]


def _marking(element: Element) -> Marking:
    width = _number(element, "width", 0.25 if element.get("weight") == "bold" else 0.12)
    return Marking(
        max(_number(element, "sOffset"), 0.0),
        element.get("type", "none").lower(),
        element.get("color", "standard").lower(),
        min(max(width, 0.05), 0.6),
        element.get("laneChange", "both").lower(),
    )


def _changes(markings: Iterable[Marking]) -> Iterator[Marking]:
    """Yield the markings that differ from the one before."""
    last = None
    for mark in markings:
        if last is None or mark[1:] != last[1:]:
            yield mark
        last = mark


def _object(element: Element) -> RoadObject:
    outlines = [*element.findall("outline"), *element.findall("outlines/outline")]
    corners, on_road = ([*_all(outlines[0], tag)] if outlines else [] for tag in ("cornerLocal", "cornerRoad"))
    return RoadObject(
        id=element.get("id", ""),
        kind=element.get("type", "").lower(),
        name=element.get("name", ""),
        outline=np.array([[_number(corner, axis) for axis in "uvz"] for corner in corners], np.float64).reshape(-1, 3),
        road_corners=np.array([(_number(c, "s"), _number(c, "t")) for c in on_road], np.float64).reshape(-1, 2),
        ahead=_AHEAD.get(element.get("orientation", "")),
        **_numbers(element, station="s", offset="t", height="zOffset", heading="hdg", width="width", length="length"),
    )


def _signal(element: Element) -> RoadSignal:
    lanes = (
        (whole_number(validity.get("fromLane")), whole_number(validity.get("toLane")))
        for validity in _all(element, "validity")
    )
    place = element.find("positionInertial")
    x, y, z, heading = (0.0 if place is None else _number(place, name) for name in ("x", "y", "z", "hdg"))
    return RoadSignal(
        inertial=None if place is None else (x, y, z, heading),
        id=element.get("id", ""),
        kind=element.get("type", ""),
        ahead=_AHEAD.get(element.get("orientation", "")),
        lanes=tuple((min(pair), max(pair)) for pair in lanes),
        unit=element.get("unit", ""),
        name=element.get("name", ""),
        is_reference=element.tag == "signalReference",
        **_numbers(element, value="value", station="s", offset="t", height="zOffset", heading="hOffset"),
    )


def _limits(element: Element, path: str, start: str, speed: str) -> tuple[tuple[float, float], ...]:
    """Return where speed limits begin, and the limits in m/s, in order; NaN for none."""
    limits = []
    for each in _all(element, path):
        found = each.find(speed)
        limit = None if found is None else in_metres_per_second(found.get("max"), found.get("unit"))
        limits.append((_number(each, start), nan if limit is None else limit))
    return tuple(sorted(limits, key=lambda limit: limit[0]))


def in_metres_per_second(value: str | float | None, unit: str | None) -> float | None:
    """Return a speed limit in m/s, which is in m/s without a unit; None if there is none, as of the word `undefined`."""
    try:
        limit = float(value or "") * _UNITS.get(unit or "m/s", 1.0)
    except ValueError:
        return None
    return limit if _SLOWEST <= limit < _FASTEST else None


def _profile(element: Element, path: str, start: str, end: float, most: float, steepest: float = inf) -> Profile:
    """Return the function that some records of an element are, of which `end` is where the last one ends.

    No term is larger than `most`, none but the first larger than `steepest` for each m of its record and one more.
    """
    records = []
    for each in _all(element, path):
        a, b, c, d = (_number(each, name) for name in "abcd")
        records.append((_number(each, start), (a, b, c, d)))
    records.sort(key=lambda record: record[0])
    ends = [*(first for first, _ in records[1:]), end]
    for (first, (a, b, c, d)), last in zip(records, ends, strict=False):
        length = max(last - first, 0.0)
        bend = max(abs(b) * length, abs(c) * length**2, abs(d) * length**3)
        if max(abs(a), bend) > most or bend > steepest * (length + 1):
            raise _ContentError(f"{path.rpartition('/')[2]}: expected what a road has, found a={a}, b={b}, c={c}, d={d}")
    return Profile(records)


def _all(element: Element, path: str, most: int = _MAX_RECORDS) -> list[Element]:
    found = element.findall(path)
    if len(found) > most:
        raise _ContentError(f"expected at most {most:,} elements {path}, found {len(found):,}")
    return found


def _numbers(element: Element, **names: str) -> dict[str, float]:
    """Return the values of attributes, each by the name that it has here."""
    return {field: _number(element, name) for field, name in names.items()}


def _number(element: Element, name: str, default: float = 0.0) -> float:
    """Return the value of an attribute: as in CARLA, the number that it begins with, or 0 if there is none."""
    text = element.get(name)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        begin = _NUMBER.match(text)
        value = float(begin[0]) if begin else 0.0
    if not abs(value) < _MAX_NUMBER:
        raise _ContentError(f"{element.tag}: {name}: expected a number below {_MAX_NUMBER:,.0f}, found {text[:40]!r}")
    return value


def whole_number(text: str | None, least: int = -(1 << 31), greatest: int = (1 << 31) - 1) -> int:
    """Return an id as CARLA has it: the whole number that a text begins with, within limits; 0 if there is none."""
    begin = _WHOLE_NUMBER.match(text or "")
    return min(max(int(begin[1]), least), greatest) if begin else 0


def road_number(text: str | None) -> int:
    """Return the id of a road as CARLA has it; see `whole_number`."""
    return whole_number(text, 0, (1 << 32) - 1)
