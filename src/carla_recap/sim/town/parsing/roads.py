"""The lanes for cars: their middles as driven, their links, and the speed limits on them.

CARLA's parser does not expose speed limits, controllers of lights and priorities of junctions: these are read from the
XML (ASAM OpenDRIVE 1.4 to 1.8, the elements `type`, `speed`, `controller` and `priority`).
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

import numpy as np

from carla_recap.roads.carla_map import NO_JUNCTION
from carla_recap.roads.opendrive import in_metres_per_second

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.roads import carla_map

    Floats = NDArray[np.float64]
    Name = tuple[int, int, int]

SPACING: Final = 1.0  # m
DEFAULT_LIMIT: Final = 30 / 3.6  # m/s: CARLA's, where a map says nothing
_TURN: Final = np.radians(35)  # what bends less goes straight on
_TO_LEFT_HANDED: Final = np.array((1.0, -1, 1, -1, 1))
_SHORTEST: Final = 1e-3  # m: so that one may divide by lengths
_MOST: Final = 4_000_000  # points: 4,000 km of lanes


@dataclass(eq=False)
class ParsedLane:
    """A lane for cars, in CARLA's axes.

    Attributes:
        name: Its road, section and number there.
        rows: Rows of x, y, z, heading and width in the direction of travel, evenly spaced.
        length: The length in m.
        junction: The id of its junction, if it lies in one.
        stations: The stations of the road at which it begins and ends, in the direction of travel.
        row: The fields of a lane of the town.
    """

    name: Name
    rows: Floats
    length: float
    junction: int | None
    stations: tuple[float, float]
    row: dict[str, Any]

    @property
    def index(self) -> int:
        """Its index in the list of lanes."""
        return int(self.row["index"])

    @property
    def width(self) -> float:
        """The width halfway, in m."""
        return float(self.row["width"])


def parse_lanes(roads: carla_map.Roads) -> list[ParsedLane]:
    """Return the lanes for cars, in the order of roads, sections and numbers; without speed limits.

    Raises:
        ValueError: There is none, a coordinate is not finite, or there are too many for a town.
    """
    driving = sorted((lane for lane in roads.lanes if lane.is_driving), key=lambda lane: (lane.road, lane.section, lane.id))
    if not driving:
        raise ValueError("no lane for cars is in it")
    rows = [_rows(lane) for lane in driving]
    if sum(map(len, rows)) > _MOST:
        raise ValueError(f"its lanes are longer than {_MOST * SPACING / 1000:.0f} km, which no town has")
    if not all(np.isfinite(points).all() for points in rows):
        raise ValueError("a lane has places that are no numbers")
    lanes = [_lane(index, lane, points) for index, (lane, points) in enumerate(zip(driving, rows, strict=True))]
    _link(lanes, driving)
    return lanes


def _rows(lane: carla_map.LaneGeometry) -> Floats:
    """Return evenly spaced rows along a lane."""
    width = np.linalg.norm(lane.left - lane.right, axis=1)
    rows: Floats = np.column_stack((lane.centre, np.unwrap(lane.headings), width)) * _TO_LEFT_HANDED
    if lane.reverse:
        rows = rows[::-1]
    at = np.concatenate(((0.0,), np.cumsum(np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1))))
    if not np.isfinite(at[-1]):
        return rows
    even = np.linspace(0, at[-1], max(int(np.ceil(at[-1] / SPACING)), 1) + 1)
    spaced: Floats = np.stack([np.interp(even, at, column) for column in rows.T], axis=1)
    return spaced


def _lane(index: int, lane: carla_map.LaneGeometry, rows: Floats) -> ParsedLane:
    length = max(float(np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1).sum()), _SHORTEST)
    junction = None if lane.junction == NO_JUNCTION else lane.junction
    bend = rows[-1, 3] - rows[0, 3]
    turn = "straight" if junction is None or abs(bend) < _TURN else "right" if bend > 0 else "left"
    stations = float(lane.stations[0]), float(lane.stations[-1])
    return ParsedLane(
        (lane.road, lane.section, lane.id),
        rows,
        length,
        junction,
        stations[::-1] if lane.reverse else stations,
        {
            "index": index,
            "road_id": lane.road,
            "section": lane.section,
            "lane_id": lane.id,
            "length": length,
            "width": float(rows[len(rows) // 2, 4]),
            "junction": junction,
            "turn": turn,
        },
    )


def _link(lanes: list[ParsedLane], driving: Iterable[carla_map.LaneGeometry]) -> None:
    """Set the predecessors, successors and neighbours of the lanes."""
    known = {lane.name: lane for lane in lanes}
    for lane in lanes:
        lane.row["predecessors"] = []
    for lane, source in zip(lanes, driving, strict=True):
        after = sorted({known[name].index for name in source.successors if name in known})
        lane.row["successors"] = after
        for index in after:
            lanes[index].row["predecessors"].append(lane.index)
        rightwards = 1 if source.reverse else -1  # numbers ascend to the left of the road's own direction
        for side, step, allowed in zip(("left", "right"), (-rightwards, rightwards), source.changes, strict=True):
            beside = known.get((source.road, source.section, source.id + step))
            lane.row[side] = beside.index if allowed and beside is not None else None


def limit_speeds(lanes: list[ParsedLane], signals: Iterable[dict[str, Any]], records: Records) -> None:
    """Give every lane a speed limit: its own, or that of a sign on it or of a lane from which one comes, or the default.

    Args:
        lanes: The lanes.
        signals: The rows of the signals.
        records: The speed limits of the file.
    """
    signed = {lane: row["speed_limit"] for row in signals if row["kind"] == "speed_limit" for lane, _ in row["stops"]}
    for lane in lanes:
        own = records.limit(*lane.name, sum(lane.stations) / 2)
        lane.row["speed_limit"] = signed.get(lane.index) if own is None else own
    known = [lane for lane in lanes if lane.row["speed_limit"] is not None]
    for lane in known:  # grows
        for index in lane.row["successors"]:
            if lanes[index].row["speed_limit"] is None:
                lanes[index].row["speed_limit"] = lane.row["speed_limit"]
                known.append(lanes[index])
    for lane in lanes:
        if lane.row["speed_limit"] is None:
            lane.row["speed_limit"] = DEFAULT_LIMIT


@dataclass
class Records:
    """Records of an OpenDRIVE file.

    Attributes:
        limits: The speed limits of roads, by their ids: from which station on, and in m/s.
        lane_limits: Those of lanes, in m/s, by road, section and lane.
        controllers: The ids of the signals of each controller, in the order in which these follow each other.
        priorities: In junctions, by their ids, which connecting roads have priority over which.
        for_all: Roads, and the signals there that name no lanes.
    """

    limits: dict[int, list[tuple[float, float | None]]] = field(default_factory=lambda: defaultdict(list))
    lane_limits: dict[tuple[int, int, int], float] = field(default_factory=dict)
    controllers: dict[str, list[str]] = field(default_factory=dict)
    priorities: dict[int, set[tuple[int, int]]] = field(default_factory=lambda: defaultdict(set))
    for_all: set[tuple[int, str]] = field(default_factory=set)

    def limit(self, road: int, section: int, lane: int, station: float) -> float | None:
        """Return the speed limit of a lane at a station, in m/s, if there is one."""
        own = self.lane_limits.get((road, section, lane))
        if own is not None:
            return own
        records = self.limits[road]
        before = bisect_right(records, (station, inf), key=lambda record: (record[0], inf))
        return records[max(before - 1, 0)][1] if records else None


def read_records(text: str) -> Records:
    """Return the records of an OpenDRIVE file, without those that have invalid numbers.

    Raises:
        ElementTree.ParseError: It is no XML.
    """
    root = ElementTree.fromstring(text)
    records = Records()
    for road in root.iterfind("road"):
        _read_road(road, records)
    ordered = sorted(root.iterfind("controller"), key=lambda controller: _number(controller.get("sequence")) or 0.0)
    for controller in ordered:
        signals = [control.get("signalId", "") for control in controller.iterfind("control")]
        records.controllers[controller.get("id", "")] = list(dict.fromkeys(signals))
    for junction in root.iterfind("junction"):
        for priority in junction.iterfind("priority"):
            high, low = _number(priority.get("high")), _number(priority.get("low"))
            if high is not None and low is not None:
                records.priorities[int(_number(junction.get("id")) or 0)].add((int(high), int(low)))
    return records


def _read_road(element: ElementTree.Element, records: Records) -> None:
    road = int(_number(element.get("id")) or 0)
    for kind in element.iterfind("type"):
        speed = kind.find("speed")
        limit = None if speed is None else in_metres_per_second(speed.get("max"), speed.get("unit"))
        records.limits[road].append((_number(kind.get("s")) or 0.0, limit))
    records.limits[road].sort(key=lambda record: record[0])
    for section, lanes in enumerate(element.iterfind("lanes/laneSection")):
        for lane in lanes.iterfind("*/lane"):
            speed = lane.find("speed")
            limit = None if speed is None else in_metres_per_second(speed.get("max"), speed.get("unit"))
            if limit is not None:
                records.lane_limits[road, section, int(_number(lane.get("id")) or 0)] = limit
    for signal in element.iterfind("signals/*"):
        if signal.find("validity") is None:
            records.for_all.add((road, signal.get("id", "")))


def _number(text: str | float | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if abs(number) < 1e9 else None
