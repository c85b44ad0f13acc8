"""The lanes, landmarks and crossings of a town, where CARLA's library has them: `carla.Map`.

Units are m and radians; axes are right-handed: x forward, y left, z up. Positions have single precision, and the order of
operations is CARLA's, so that they are equal.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.roads.curves import single
from carla_recap.roads.opendrive import in_carlas_order, lanes_length, limit_lanes
from carla_recap.roads.speed_limits import lane_limits, limit_signs

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.roads.opendrive import OpenDrive, Road, RoadLane, RoadObject, RoadSection
    from carla_recap.util.arrays import Floats

    Name = tuple[int, int, int]

DRIVING: Final = "driving"
NO_JUNCTION: Final = -1
_STEP: Final = 0.5  # m between points of a lane
_MOST_POINTS: Final = 400_000  # of all lanes, about
_MOST_LANES: Final = 20_000  # of a map; each of CARLA's small towns has about 500
_BEGIN: Final = 10 * np.finfo(np.float64).eps  # m, where CARLA has the first point of a road
_SHARE: Final = 4096  # of a metre, to which the end of a lane is exact
_TO_DEGREES: Final = single(180.0) / single(np.pi)


class Permission(NamedTuple):
    """What the markings of a lane allow from a station on."""

    station: float  # the distance along the road
    changes: tuple[bool, bool]  # to the lanes on the left and right, by `carla.Map`: also without a marking
    crossings: tuple[bool, bool]  # the same for CARLA's route planner, which changes only across a marking


@dataclass(frozen=True, eq=False)
class LaneGeometry:
    """The course of a lane along a section of a road."""

    road: int  # the id of the road
    section: int  # the index of the section of the road
    id: int  # the number of the lane, ascending to the left of the road's own direction; 0 is the line between 1 and -1
    kind: str  # the OpenDRIVE type, such as `driving`, lower-case
    junction: int  # the id of the junction, or `NO_JUNCTION`
    stations: Floats  # the distances along the road, ascending, (n,)
    centre: Floats  # the points in the middle, (n, 3)
    left: Floats  # the points of the left border, as seen in driving direction, (n, 3)
    right: Floats  # the points of the border to the right
    headings: Floats  # the driving directions, (n,)
    reverse: bool  # whether the driving direction is from the last point to the first, against that of the road
    permissions: tuple[Permission, ...]  # what its markings allow, each from a station on, ascending
    successors: tuple[Name, ...]  # the road, section and id of each lane that follows
    limits: Floats  # the speed limits at the stations in m/s, (n,); NaN where there is none

    @property
    def is_driving(self) -> bool:
        """Whether the lane is for cars."""
        return self.kind == DRIVING

    def allowed(self, station: float) -> Permission:
        """Return what the markings at a station allow."""
        return [each for each in self.permissions if each.station <= station][-1]

    def borders(self) -> Iterator[tuple[Name, Floats]]:
        """Yield the two borders, each with a key that it shares with the neighbouring lane."""
        upper = self.id if self.id > 0 else self.id + 1
        higher, lower = (self.right, self.left) if self.reverse else (self.left, self.right)
        yield (self.road, self.section, upper), higher
        yield (self.road, self.section, upper - 1), lower


class TownRoads:
    """The roads of a town by their ids, in CARLA's order, and their lanes; a town of more lanes is a `ValueError`."""

    def __init__(self, content: OpenDrive, most_lanes: int = _MOST_LANES) -> None:
        limit_lanes(content.roads, most_lanes)
        self.content = content
        numbered = {road.number: road for road in reversed(content.roads)}
        self.roads = {number: numbered[number] for number in in_carlas_order(road.number for road in content.roads)}
        self._signs = dict(zip(self.roads, limit_signs(self.roads.values()), strict=True))

    @cached_property
    def lanes(self) -> list[LaneGeometry]:
        """The lanes for cars, and all lanes of their sections, in the order in which CARLA lists roads."""
        length = lanes_length(self.roads.values())
        step = max(_STEP, length / _MOST_POINTS)
        if step > _STEP:
            message = f"{length / 1000:,.0f} km of lanes have {_MOST_POINTS:,} points, {step:.1f} m apart and not {_STEP:g}"
            warnings.warn(message, RecapWarning, stacklevel=2)
        with np.errstate(all="ignore"):
            return [
                lane
                for road in self.roads.values()
                for section in road.sections
                for lane in self._sampled(road, section, step)
            ]

    @cached_property
    def crossings(self) -> list[Floats]:
        """The outlines of pedestrian crossings, closed."""
        return [
            outline
            for road in self.roads.values()
            for thing in road.objects
            if thing.kind == "crosswalk" and len(outline := _crossing(road, thing)) > 2
        ]

    def _sampled(self, road: Road, section: RoadSection, step: float) -> Iterator[LaneGeometry]:
        """Yield the lanes of a section that has one for cars; beside a number that is missing there are no more."""
        if not any(lane.kind == DRIVING for lane in section.lanes):
            return
        stations = _stations(section, step)
        if len(stations) < 2:
            return
        reference = road.reference(stations, single)
        for side, lanes in ((1, section.left), (-1, section.right)):
            consecutive = [lane for number, lane in enumerate(lanes, 1) if lane.id == side * number]
            for index, lane in enumerate(consecutive):
                yield self._lane(road, section, lane, consecutive[: index + 1], stations, reference)

    def _lane(
        self,
        road: Road,
        section: RoadSection,
        lane: RoadLane,
        inner: Sequence[RoadLane],
        stations: Floats,
        reference: tuple[Floats, Floats],
    ) -> LaneGeometry:
        """Return a lane; `inner` are the lanes from the middle of the road to this one."""
        offset, slope = _to_middle(section, inner, stations)
        reverse = road.is_reverse(lane.id)
        centre, headings = _poses(road, stations, reference, offset, slope, reverse=reverse)
        width = lane.width(stations - section.start)
        leftwards = np.stack((-np.sin(headings), np.cos(headings), np.zeros(len(headings))), axis=1)
        to_border = leftwards * width[:, None] / 2
        beside = section.centre if len(inner) == 1 else inner[-2]
        return LaneGeometry(
            road.number,
            section.number,
            lane.id,
            lane.kind,
            road.junction_number if road.in_junction else NO_JUNCTION,
            stations,
            centre,
            centre + to_border,
            centre - to_border,
            headings,
            reverse,
            tuple(_permissions(road, section, lane, beside)),
            tuple(dict.fromkeys(self._successors(road, section, lane))),
            lane_limits(road, section, lane, self._signs[road.number], stations),
        )

    def _successors(self, road: Road, section: RoadSection, lane: RoadLane) -> Iterator[Name]:
        """Yield the lanes that follow: of the next section, of the next road, or of a junction."""
        ahead = not road.is_reverse(lane.id)
        following = lane.successor if ahead else lane.predecessor
        position = road.sections.index(section)
        beyond_section = road.sections[position + 1 :] if ahead else road.sections[:position][::-1]
        if beyond_section:
            yield from _first_with(road, beyond_section, following)
            return
        beyond = road.successor if ahead else road.predecessor
        if beyond in self.roads:
            yield from self._entered(beyond, following)
        elif beyond is not None:
            for way in self._ways.get((beyond, road.number), ()):
                first = way.sections[0].lanes if way.predecessor == road.number else ()
                last = way.sections[-1].lanes if way.successor == road.number else ()
                linked = [other.id for other in first if other.predecessor == lane.id]
                for number in (*linked, *(other.id for other in last if other.successor == lane.id)):
                    yield from self._entered(way.number, number)

    @cached_property
    def _ways(self) -> dict[tuple[int, int], list[Road]]:
        """The roads through each junction, by the junction and by a road that they are linked with."""
        found: dict[tuple[int, int], list[Road]] = {}
        for junction, connecting in self.content.connections.items():
            for way in (self.roads[number] for number in dict.fromkeys(connecting) if number in self.roads):
                for end in {way.predecessor, way.successor}:
                    if end is not None:
                        found.setdefault((junction, end), []).append(way)
        return found

    def _entered(self, road: int, lane: int) -> Iterator[Name]:
        """Yield a lane that begins where a road is entered."""
        if road in self.roads:
            entered = self.roads[road]
            yield from _first_with(entered, entered.sections[:: -1 if entered.is_reverse(lane) else 1], lane)


def _first_with(road: Road, sections: Iterable[RoadSection], lane: int) -> Iterator[Name]:
    """Yield the lane of a number of the first section that has it."""
    numbers = (section.number for section in sections if any(other.id == lane for other in section.lanes))
    yield from ((road.number, number, lane) for number in islice(numbers, 1 if lane else 0))


def _stations(section: RoadSection, step: float) -> Floats:
    """Return stations at equal distances along a section, and its end."""
    inside = np.arange(np.ceil(section.start / step), np.ceil(section.end / step)) * step
    if not len(inside):
        inside = np.array([section.start])
    inside[0] = max(inside[0], _BEGIN)
    last = float(inside[-1])
    shares = int(np.ceil((section.end - last) * _SHARE))
    end = next((at for at in (float(single(last + k / _SHARE)) for k in range(shares, 0, -1)) if at < section.end), last)
    return single(np.append(inside, [end] if end > last else [])).astype(np.float64)


def _to_middle(section: RoadSection, inner: Sequence[RoadLane], stations: Floats) -> tuple[Floats, Floats]:
    """Return how far the middle of a lane is to the right of the central line, and how that changes with the station."""
    along = stations - section.start
    shares = [1.0] * (len(inner) - 1) + [0.5]
    side = 1 if inner[-1].id < 0 else -1
    offset = sum(share * lane.width(along) for share, lane in zip(shares, inner, strict=True))
    slope = sum(share * lane.width.slope(along) for share, lane in zip(shares, inner, strict=True))
    return side * np.asarray(offset), side * np.asarray(slope)


def _poses(
    road: Road,
    stations: Floats,
    reference: tuple[Floats, Floats],
    offset: Floats,
    slope: Floats,
    *,
    reverse: bool = False,
) -> tuple[Floats, Floats]:
    """Return points at distances to the right of the central line of a road, and the headings of a lane there."""
    points, headings = reference
    points = aside(points, headings, -road.lane_offset(stations))
    points = aside(points, headings, offset)
    turn = single(slope) - single(road.lane_offset.slope(stations))
    return points, rounded(headings - turn, reverse=reverse)


def rounded(headings: Floats, *, reverse: bool = False) -> Floats:
    """Return headings as CARLA has them: degrees to the right, in single precision."""
    yaw = single(-headings) * _TO_DEGREES + single(180.0 if reverse else 0.0)
    return np.radians(-yaw.astype(np.float64))


def aside(points: Floats, headings: Floats, right: Floats | float) -> Floats:
    """Return points shifted to the right of a direction."""
    sine, cosine = _sine_and_cosine(single(headings))
    shifted = points.copy()
    shifted[:, 0] = single(points[:, 0]) + single(right) * sine
    shifted[:, 1] = single(points[:, 1]) - single(right) * cosine
    return shifted


_SINE: Final = (1.0, -0.16666654943701084, 0.008332178146138854, -0.00019517298981385725)
_COSINE: Final = (1.0, -0.49999999725108224, 0.041666623324344516, -0.001388676379437604, 2.4390450703564542e-05)


def _sine_and_cosine(turns: Floats) -> tuple[Floats, Floats]:
    """Return sines and cosines in single precision, rounded as by the C library (`sinf`, by polynomials in double)."""
    turns = np.asarray(turns, np.float64)
    quarters = np.rint(turns * (2 / np.pi)).astype(np.int64)
    turns = turns - quarters * (np.pi / 2)
    squares = turns * turns
    sine = single(turns * _polynomial(squares, _SINE))
    cosine = single(_polynomial(squares, _COSINE))
    quarters = quarters % 4
    return (
        np.choose(quarters, (sine, cosine, -sine, -cosine)),
        np.choose(quarters, (cosine, -sine, -cosine, sine)),
    )


def _polynomial(x: Floats, coefficients: Sequence[float]) -> Floats:
    value = np.full(x.shape, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = coefficient + value * x
    return value


def _permissions(road: Road, section: RoadSection, lane: RoadLane, beside: RoadLane | None) -> Iterator[Permission]:
    """Yield what the markings of a lane allow along its section.

    The words for which CARLA's library allows the changes are these, whatever OpenDRIVE means by them.
    """
    outwards = "increase" if lane.id < 0 else "decrease"
    inwards = "increase" if (lane.id > 0 if road.keeps_left else lane.id < -1) else "decrease"
    starts = {mark.start for each in (lane, beside) if each is not None for mark in each.markings}
    for along in (-math.inf, *sorted(starts)):
        inner, outer = _marked(beside, along), _marked(lane, along)
        changes = inner in (None, "both", inwards), outer in (None, "both", outwards)
        crossings = inner in ("both", "decrease"), outer in ("both", "increase")
        if road.keeps_left:
            changes, crossings = changes[::-1], crossings[::-1]
        yield Permission(section.start + along, changes, crossings)


def _marked(lane: RoadLane | None, along: float) -> str | None:
    """Return the changes that the marking of a lane allows; None without a marking."""
    marks = [] if lane is None else list(takewhile(lambda mark: mark.start <= along, lane.markings))
    if not marks:
        return None
    return marks[-1].changes if marks[-1].changes in ("increase", "decrease", "none") else "both"


def _crossing(road: Road, thing: RoadObject) -> Floats:
    if not len(thing.outline):  # CARLA's library does not read such corners
        corners = road.corners(thing)
        return np.concatenate((corners, corners[:1]))
    station = np.array([min(max(thing.station, 0.0), road.length)])
    (point,), (heading,) = _poses(road, station, road.reference(station, single), np.zeros(1), np.zeros(1))
    along, climb = single(np.degrees(heading)), single(road.elevation.slope(station)[0]) * _TO_DEGREES
    middle = single(point) + single(thing.offset) * turned(along + single(90.0), climb)[0]
    ahead, left, up = turned(along + single(thing.heading) * _TO_DEGREES, climb)
    u, v, z = single(thing.outline.T)[..., None]
    outline: Floats = (u * ahead + v * left + z * up + middle).astype(np.float64)
    return outline


def turned(degrees: Floats, climb: Floats | float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Return the directions ahead, to the left and upwards of a heading and a climb in degrees, (3,) each."""
    (sine, sine_up), (cosine, cosine_up) = _sine_and_cosine(
        single(np.array((degrees, climb))) * (single(np.pi) / single(180.0))
    )
    return (
        np.array((cosine_up * cosine, cosine_up * sine, sine_up), np.float32),
        np.array((-sine, cosine, 0.0), np.float32),
        np.array((-sine_up * cosine, -sine_up * sine, cosine_up), np.float32),
    )
