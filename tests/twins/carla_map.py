"""The twin of `carla_recap.roads`: what CARLA's own library says about a map, from a process that it may abort."""

from __future__ import annotations

import json
import os
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

import numpy as np

from carla_recap.roads.landmarks import find_landmarks
from carla_recap.roads.lanes import LaneGeometry, TownRoads

Place = tuple[int, int, float, float]
"""The road, the lane and the station of a waypoint, and how far beyond it the next and the previous ones are."""


class CarlaLibrary:
    """A process that reads maps with CARLA's library, which aborts it at some."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def ask(self, text: str, places: list[Place]) -> dict[str, Any] | None:
        """Return what the library says about a map and about places on it; None if it cannot read the map."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, get_context("spawn"), initializer=_silence)
        try:
            facts: dict[str, Any] | None = json.loads(self._pool.submit(facts_of, text, places).result())
        except BrokenProcessPool:
            self.close()
            return None
        return facts

    def close(self) -> None:
        """End the process."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


_CHANGES = {(False, False): "NONE", (True, False): "Left", (False, True): "Right", (True, True): "Both"}
_AHEAD = {True: "Positive", False: "Negative", None: "Both"}
_EVERY = 40  # points of a lane
_FAR = 0.05  # m
_TURNED = 0.5  # degrees


def differences(
    roads: TownRoads, text: str, library: CarlaLibrary, *, far: float = _FAR, turned: float = _TURNED
) -> list[Any] | None:
    """Return where roads and landmarks differ from the library's; None if it cannot read the map.

    Some points of each lane are compared, which may be some m and degrees apart. The library's `next` and `previous` leave
    out lanes that lead back to where one comes from, unlike its topology.
    """
    ends = {(road.number, part.number): (part.start, part.end) for road in roads.content.roads for part in road.sections}
    places = []
    for lane in roads.lanes:
        start, end = ends[lane.road, lane.section]
        last = len(lane.stations) - 1
        for index in sorted({0, last // 2 + 1, last, *range(0, last, _EVERY)}):
            station = float(lane.stations[index])
            beyond = station - start if index == 0 else end - station if index == last else 0.0
            places.append((lane, index, (lane.road, lane.id, station, beyond + 0.01)))
    theirs = library.ask(text, [place for *_, place in places])
    if theirs is None:
        return None
    lanes = {(lane.road, lane.section, lane.id): lane for lane in roads.lanes}
    before: dict[Any, set[Any]] = {name: set() for name in lanes}
    for name, lane in lanes.items():
        for other in lane.successors:
            before.setdefault(other, set()).add(name)
    found: list[Any] = []
    for (lane, index, place), point in zip(places, theirs["waypoints"], strict=True):
        differing = ["waypoint"] if point is None else list(_differing(lane, index, point, lanes, before, far, turned))
        found += [(what, place, point) for what in differing]
    if {tuple(name) for name in theirs["driving"]} != {name for name, lane in lanes.items() if lane.is_driving}:
        found.append("driving lanes")
    if [corner for outline in roads.crossings for corner in outline.tolist()] != theirs["crossings"]:
        found.append("crossings")
    topology = {(tuple(one), tuple(other)) for one, other in theirs["topology"]}
    known = {(name, other) for name, lane in lanes.items() if lane.is_driving for other in lane.successors}
    ending = {name for name, lane in lanes.items() if not lane.successors}
    found += [("topology", pair) for pair in topology ^ known if pair[1] in lanes and pair[0] not in ending]
    return found + list(_differing_landmarks(roads, theirs["landmarks"]))


def _differing(
    lane: LaneGeometry, index: int, point: Any, lanes: dict[Any, Any], before: dict[Any, Any], far: float, turned: float
) -> Any:
    name = lane.road, lane.section, lane.id
    leading = set(lane.successors), before[name]
    first, last = (-1, 0) if lane.reverse else (0, -1)
    index -= len(lane.stations) if index == len(lane.stations) - 1 else 0
    right = 1 if lane.reverse else -1  # the number to the right
    beside = [(*name[:2], lane.id + step or lane.id + 2 * step) for step in (-right, right)]
    facts = {
        "name": (point["name"], list(name)),
        "kind": (point["kind"].lower(), lane.kind),
        "junction": (point["junction"], lane.junction),
        "left": (point["left"], list(beside[0]) if beside[0] in lanes else None),
        "right": (point["right"], list(beside[1]) if beside[1] in lanes else None),
    }
    station = float(lane.stations[index])
    allowed = lane.allowed(station)
    facts["station"] = point["station"], station
    facts["change"] = point["change"], _CHANGES[allowed.changes]
    facts["crossings"] = point["crossings"], list(allowed.crossings)
    if index == last:
        facts["next"] = _known(point["next"], lanes), _known(leading[0] - leading[1], lanes)
    if index == first:
        facts["previous"] = _known(point["previous"], lanes), _known(leading[1] - leading[0], lanes)
    yield from (what for what, (theirs, ours) in facts.items() if theirs != ours)
    width = np.linalg.norm(lane.left[index] - lane.right[index])
    if not np.abs(lane.centre[index] - point["position"]).max() <= far:
        yield "position"
    if not _turn(np.degrees(lane.headings[index]), point["yaw"]) <= turned:
        yield "yaw"
    if not abs(width - abs(point["width"])) <= max(far, 1e-6):
        yield "width"


def _known(names: Any, lanes: dict[Any, Any]) -> set[Any]:
    return {tuple(name) for name in names} & set(lanes)


def _turn(one: float, other: float) -> float:
    return float(abs((one - other + 180) % 360 - 180))


def _differing_landmarks(roads: TownRoads, theirs: list[Any]) -> Any:
    ours = sorted(
        (
            (
                *(mark.id, mark.kind, mark.value, mark.unit, mark.road, mark.station, _AHEAD[mark.ahead]),
                sorted(map(list, mark.lanes)),
                mark.location.tolist(),
                float(np.degrees(mark.heading)),
            )
            for mark in find_landmarks(roads)
        ),
        key=lambda mark: mark[:8],
    )
    if [mark[:8] for mark in ours] != [tuple(mark[:8]) for mark in theirs]:
        yield "landmarks", ours, theirs
        return
    for one, other in zip(ours, theirs, strict=True):
        if np.abs(np.subtract(one[8], other[8])).max() > _FAR or _turn(one[9], other[9]) > _TURNED:
            yield "landmark", one, other


def _silence() -> None:
    for output in (1, 2):  # the library prints
        os.dup2(os.open(os.devnull, os.O_WRONLY), output)


def facts_of(text: str, places: list[Place]) -> str:
    """Return what `carla.Map` says, in right-handed axes, as JSON; null if it cannot read the map."""
    import carla

    try:
        town: Any = carla.Map("", text)
    except RuntimeError:
        return "null"
    facts = {
        "waypoints": [_waypoint(town.get_waypoint_xodr(*place), beyond) for *place, beyond in places],
        "driving": list(dict.fromkeys(_name(point) for point in town.generate_waypoints(0.5))),
        "topology": sorted({(_name(one), _name(other)) for one, other in town.get_topology()}),
        "landmarks": sorted(_landmark(mark) for mark in town.get_all_landmarks()),
        "crossings": [_position(corner) for corner in town.get_crosswalks()],
    }
    return json.dumps(facts)


def _name(point: Any) -> tuple[int, int, int]:
    return point.road_id, point.section_id, point.lane_id


def _position(location: Any) -> tuple[float, float, float]:
    return location.x, -location.y, location.z


def _waypoint(point: Any, beyond: float) -> dict[str, Any] | None:
    if point is None:
        return None
    left, right = point.get_left_lane(), point.get_right_lane()
    return {
        "name": _name(point),
        "station": point.s,
        "position": _position(point.transform.location),
        "yaw": -point.transform.rotation.yaw,
        "pitch": point.transform.rotation.pitch,
        "width": point.lane_width,
        "kind": str(point.lane_type),
        "junction": point.junction_id if point.is_junction else -1,
        "change": str(point.lane_change),
        "crossings": [_crossed(point.left_lane_marking, "Left"), _crossed(point.right_lane_marking, "Right")],
        "next": sorted({_name(other) for other in point.next(beyond)}),
        "previous": sorted({_name(other) for other in point.previous(beyond)}),
        "left": None if left is None else _name(left),
        "right": None if right is None else _name(right),
    }


def _crossed(marking: Any, side: str) -> bool:
    return bool(marking) and str(marking.lane_change) in (side, "Both")


def _landmark(mark: Any) -> tuple[Any, ...]:
    return (
        *(mark.id, mark.type, mark.value, mark.unit, mark.road_id, mark.s, str(mark.orientation)),
        sorted(mark.get_lane_validities()),
        _position(mark.transform.location),
        -mark.transform.rotation.yaw,
    )
