"""What CARLA's parser reads and does not tell: speed limits, who controls which light, and who has priority.

Sources: ASAM OpenDRIVE 1.4 to 1.8, the elements `type`, `speed`, `controller` and `priority`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from dataclasses import dataclass, field
from math import inf
from typing import Final
from xml.etree import ElementTree

_UNITS: Final = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}
_SLOWEST: Final = 0.5  # m/s: what is slower is no limit


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
        """The speed limit of a lane at a station, in m/s, if there is one."""
        own = self.lane_limits.get((road, section, lane))
        if own is not None:
            return own
        records = self.limits[road]
        before = bisect_right(records, (station, inf), key=lambda record: (record[0], inf))
        return records[max(before - 1, 0)][1] if records else None


def read_records(text: str) -> Records:
    """The records of an OpenDRIVE file; what in them is no number is left out.

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


def in_metres_per_second(value: str | float | None, unit: str | None) -> float | None:
    """A speed limit; None where there is no such limit.

    Args:
        value: A number, or a word such as `undefined`.
        unit: `m/s`, `km/h` or `mph`; without one, OpenDRIVE means m/s.
    """
    number = _number(value)
    if number is None:
        return None
    limit = number * _UNITS.get(unit or "m/s", 1.0)
    return limit if limit >= _SLOWEST else None


def _number(text: str | float | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if abs(number) < 1e9 else None
