"""The traffic lights and signs of a town at every road where they apply, where CARLA's library has them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads.curves import single
from carla_recap.roads.lanes import DRIVING, aside, rounded, turned
from carla_recap.roads.opendrive import SPEED_LIMIT, RoadSignal, defined_signals
from carla_recap.roads.waypoints import NONE, LaneMap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.roads.lanes import TownRoads
    from carla_recap.roads.opendrive import Road, RoadObject
    from carla_recap.util.arrays import Floats

_LIGHTS: Final = frozenset(("1000001", "1000002", *(str(kind) for kind in range(1000007, 1000014))))
"""The types of signals that CARLA moves forward."""
_LIGHT_AHEAD: Final = 0.25  # m
_BEFORE_END: Final = 1e-5  # m of a road, where CARLA has what is at its end
_GROUND: Final = (DRIVING, "shoulder")
"""The lanes from which CARLA moves signals away."""
_CLEAR: Final = 0.7  # of the width of the lane, from its middle
_STEP_ASIDE: Final = 0.2  # of the width
_MOST_STEPS: Final = 10
_STENCILS: Final = ("Stencil_STOP", "STATIC")
"""In the names of signals that CARLA does not move."""


@dataclass(frozen=True)
class Landmark:
    """A traffic light or sign at a position where it applies; it may apply at several."""

    id: str  # the id in the file
    kind: str  # the OpenDRIVE type, such as `opendrive.LIGHT`
    value: float  # the value, such as a speed
    unit: str  # the unit of the value
    road: int  # the road along which it applies
    station: float  # the distance along the road
    lanes: tuple[tuple[int, int], ...]  # the ranges of lanes for which it applies: first and last lane
    is_for_all: bool  # whether the file names no lanes; the ranges are CARLA's then, all lanes on one side
    ahead: bool | None  # whether it applies in the direction of the road (True), against it (False), or both ways
    location: Floats  # the position, (3,)
    heading: float  # the direction that it faces


def find_landmarks(roads: TownRoads) -> list[Landmark]:
    """Return the traffic lights and signs at every road where they apply, with the objects that are speed-limit signs."""
    signals = defined_signals(roads.content.roads)
    found: list[tuple[Landmark, RoadSignal]] = []
    for road in roads.roads.values():
        limits = (_limit_sign(road, thing) for thing in road.objects)
        found += [(_landmark(road, sign, road, sign), sign) for sign in limits if sign is not None]
        for place in road.signals:
            is_for_none = bool(place.lanes) and all(ends == (0, 0) for ends in place.lanes)
            if place.id in signals and not is_for_none:
                found.append((_landmark(road, place, *signals[place.id]), signals[place.id][1]))
    return _beside_the_road(roads, found)


def _beside_the_road(roads: TownRoads, found: list[tuple[Landmark, RoadSignal]]) -> list[Landmark]:
    """Return landmarks, those on a lane moved aside, so that they face as the lane leads."""
    marks = [mark for mark, _ in found]
    locations = np.array([mark.location for mark in marks]).reshape(-1, 3)
    headings = np.array([mark.heading for mark in marks])
    moved, turns = locations.copy(), headings.copy()
    fixed = (signal.inertial or any(stencil in signal.name for stencil in _STENCILS) for _, signal in found)
    left = np.flatnonzero([not each for each in fixed])
    lanes = LaneMap(roads, _GROUND)
    for _ in range(_MOST_STEPS):
        at = lanes.nearest(moved[left], *_GROUND)
        near = (at.lane != NONE) & (np.linalg.norm(moved[left] - at.position, axis=1) < _CLEAR * at.width)
        done, left = left[~near], left[near]
        locations[done], headings[done] = moved[done], turns[done]
        if not len(left):
            break
        turns[left] = at.heading[near]
        beside = [lanes.lanes[lane] for lane in at.lane[near].tolist()]
        leftwards = np.array([1.0 if (lane.id > 0) != lane.reverse else -1.0 for lane in beside])
        step = leftwards * _STEP_ASIDE * at.width[near]
        moved[left, 0] -= step * np.sin(turns[left])
        moved[left, 1] += step * np.cos(turns[left])
    return [
        replace(mark, location=location, heading=float(heading))
        for mark, location, heading in zip(marks, locations, headings, strict=True)
    ]


def _limit_sign(road: Road, thing: RoadObject) -> RoadSignal | None:
    """Return the signal that CARLA makes of an object that is a speed-limit sign; it faces the lanes on one side."""
    limit = thing.speed_limit
    if limit is None:
        return None
    place = thing.station, thing.offset, thing.height, thing.heading
    lanes = tuple(_one_side(road, thing.station, ahead=thing.ahead))
    return RoadSignal(thing.id, SPEED_LIMIT, limit, *place, thing.ahead, lanes, unit="mph", name=thing.name)


def _landmark(road: Road, place: RoadSignal, home: Road, signal: RoadSignal) -> Landmark:
    location, heading = _place(home, signal)
    station = _placed(road, place)
    lanes = place.lanes or tuple(_one_side(road, station, ahead=place.ahead))
    return Landmark(
        place.id,
        signal.kind,
        signal.value,
        signal.unit,
        road.number,
        station,
        lanes,
        not place.lanes,
        place.ahead,
        location.astype(np.float64),
        heading,
    )


def _place(road: Road, signal: RoadSignal) -> tuple[Floats, float]:
    """Return where a signal is, and the direction that it faces."""
    if signal.inertial is not None:
        return road.place_of(signal)
    points, headings = road.reference(np.array([min(max(_placed(road, signal), 0.0), road.length)]), single)
    (location,) = aside(points, headings, -signal.offset)
    (heading,) = rounded(headings + signal.heading)
    location[2] = single(location[2]) + single(signal.height)
    if signal.kind in _LIGHTS:
        location = single(location) + single(_LIGHT_AHEAD) * turned(single(np.degrees(heading)))[0]
    return location, float(heading)


def _placed(road: Road, place: RoadSignal) -> float:
    """Return the station of a signal, which is not at the very end of a road."""
    return min(place.station, road.length - _BEFORE_END)


def _one_side(road: Road, station: float, *, ahead: bool | None) -> Iterator[tuple[int, int]]:
    """Yield the lanes for which a signal applies that names none: as in CARLA, those on the left if it is for the road."""
    sections = [section for section in road.sections if section.start <= station]
    lanes = [lane.id for lane in sections[-1].lanes] if sections else []
    if ahead is not False and max(lanes, default=0) > 0:
        yield 1, max(lanes)
    if ahead is not True and min(lanes, default=0) < 0:
        yield min(lanes), -1
