"""Traffic lights, signs and junctions: the lanes that they govern, the lights that change together, and the right of way."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.roads import opendrive
from carla_recap.roads.opendrive import in_metres_per_second

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.roads import carla_map
    from carla_recap.sim.town.parsing.roads import ParsedLane, Records

    Row = dict[str, Any]

_KINDS: Final = {
    opendrive.LIGHT: "light",
    opendrive.STOP: "stop",
    opendrive.YIELD: "yield",
    opendrive.SPEED_LIMIT: "speed_limit",
}
_SAME_WAY: Final = np.cos(np.radians(35))  # approaches of a junction that are one, or opposite to each other


def parse_signals(roads: carla_map.Roads, lanes: list[ParsedLane], records: Records) -> list[Row]:
    """Return the lights and signs in the order of their ids, each once."""
    by_road = defaultdict(list)
    for lane in lanes:
        by_road[lane.name[0]].append(lane)
    places: dict[str, list[carla_map.Landmark]] = defaultdict(list)
    for sign in roads.landmarks:
        if sign.kind in _KINDS and np.isfinite((*sign.location, sign.heading, sign.station)).all():
            places[sign.id].append(sign)
    rows = [
        _signal(index, signs, by_road, lanes, records)
        for index, (_, signs) in enumerate(sorted(places.items(), key=lambda item: _in_order(item[0])))
    ]
    _control(rows, lanes, records)
    return rows


def _in_order(name: str) -> tuple[int, str]:
    return (int(name) if name.isdecimal() and len(name) < 20 else 0), name


def _signal(
    index: int,
    signs: list[carla_map.Landmark],
    by_road: dict[int, list[ParsedLane]],
    lanes: list[ParsedLane],
    records: Records,
) -> Row:
    first = signs[0]
    kind = _KINDS[first.kind]
    governed = [
        (lane, sign)
        for sign in signs
        for lane in (_facing if (sign.road, sign.id) in records.for_all else _named)(sign, by_road[sign.road])
    ]
    if not governed:  # it says that it is for no lane, and no other road refers to it
        governed = [(lane, sign) for sign in signs for lane in _facing(sign, by_road[sign.road])]
    stops, governs = _stops(kind, governed, lanes)
    junctions = (lanes[lane].junction for lane in governs)
    (x, y, z), yaw = first.location.tolist(), float(np.degrees(-first.heading))
    return {
        "index": index,
        "opendrive_id": first.id,
        "kind": kind,
        "place": [x, -y, z, (yaw + 180) % 360 - 180],
        "speed_limit": _speed(first) if kind == "speed_limit" else None,
        "junction": min((junction for junction in junctions if junction is not None), default=None),
        "controller": None,
        "stops": sorted(stops.items()),
        "governs": sorted(governs),
    }


def _named(sign: carla_map.Landmark, lanes: Iterable[ParsedLane]) -> Iterator[ParsedLane]:
    """Yield the lanes of a road that a sign names, at its station."""
    for lane in lanes:
        low, high = sorted(lane.stations)
        number = lane.name[2]
        named = any(min(pair) <= number <= max(pair) for pair in sign.lanes)
        if named and low - 1 <= sign.station <= high + 1:
            yield lane


def _facing(sign: carla_map.Landmark, lanes: Iterable[ParsedLane]) -> Iterator[ParsedLane]:
    """Yield the lanes of a road with the direction of travel that a sign is for, at its station."""
    for lane in lanes:
        start, stop = lane.stations
        along = sign.ahead is None or sign.ahead == (start < stop)
        if along and min(start, stop) - 1 <= sign.station <= max(start, stop) + 1:
            yield lane


def _stops(
    kind: str, governed: list[tuple[ParsedLane, carla_map.Landmark]], lanes: list[ParsedLane]
) -> tuple[dict[int, float], set[int]]:
    """Return the stop lines, at the end of a lane before a junction, else at the sign, and the lanes governed beyond."""
    stops: dict[int, float] = {}
    governs: set[int] = set()
    for lane, sign in governed:
        after = [index for index in lane.row["successors"] if lanes[index].junction is not None]
        if lane.junction is not None and kind != "speed_limit":
            governs.add(lane.index)
            before = (lanes[index] for index in lane.row["predecessors"])
            stops.update((other.index, other.length) for other in before if other.junction != lane.junction)
        elif after and kind != "speed_limit":
            governs.update(after)
            stops[lane.index] = lane.length
        else:
            start, stop = lane.stations
            share = (sign.station - start) / (stop - start) if stop != start else 1.0
            stops[lane.index] = min(max(share, 0.0), 1.0) * lane.length
    return stops, governs


def _speed(sign: carla_map.Landmark) -> float | None:
    """Return the limit on a sign; without a unit, CARLA's signs are in km/h."""
    return in_metres_per_second(sign.value, sign.unit or "km/h")


def _control(rows: list[Row], lanes: list[ParsedLane], records: Records) -> None:
    """Give every light a controller: that of the file, or else one for all that stand on the same axis of a junction."""
    controllers = {signal: name for name, signals in reversed(records.controllers.items()) for signal in signals}
    axes: dict[int | None, list[tuple[str, float]]] = defaultdict(list)
    for row in rows:
        if row["kind"] != "light":
            continue
        name = controllers.get(row["opendrive_id"])
        if name is None:
            heading = _approach(row, lanes)
            known = axes[row["junction"]] if row["junction"] is not None else []
            same = [other for other, axis in known if abs(np.cos(heading - axis)) > _SAME_WAY]
            name = same[0] if same else f"light {row['opendrive_id']}"
            known.append((name, heading))
        row["controller"] = name


def _approach(row: Row, lanes: list[ParsedLane]) -> float:
    """Return the direction of the traffic that a light governs."""
    if row["stops"]:
        return float(lanes[row["stops"][0][0]].rows[-1, 3])
    return float(np.radians(row["place"][3] + 90))


def phases(junction: int, rows: list[Row], records: Records) -> list[list[int]]:
    """Return the lights of a junction that are green together, phase by phase."""
    groups = defaultdict(list)
    for row in rows:
        if row["kind"] == "light" and row["junction"] == junction:
            groups[row["controller"]].append(row["index"])
    known = [name for name in records.controllers if name in groups]
    return [groups[name] for name in (*known, *(name for name in groups if name not in records.controllers))]


_TOUCHING: Final = 0.7  # of half of both widths: nearer than that, two vehicles on two lanes touch
_ONCOMING: Final = np.cos(np.radians(135))
_ALIKE: Final = np.cos(np.radians(45))
_RANKS: Final = {"straight": 0, "right": 1, "left": 2}
_MOST: Final = 2000  # lanes in a junction


def parse_junctions(lanes: list[ParsedLane], signals: list[Row], records: Records) -> list[Row]:
    """Return the junctions in the order of their ids.

    Raises:
        ValueError: One has too many lanes.
    """
    within = defaultdict(list)
    for lane in lanes:
        if lane.junction is not None:
            within[lane.junction].append(lane)
    return [_junction(junction, within[junction], signals, records) for junction in sorted(within)]


def _junction(junction: int, lanes: list[ParsedLane], signals: list[Row], records: Records) -> Row:
    if len(lanes) > _MOST:
        raise ValueError(f"junction {junction} has more than {_MOST} lanes")
    slowed = {lane for row in signals if row["kind"] in ("stop", "yield") for lane in row["governs"]}
    priorities = records.priorities[junction]
    conflicts = [
        conflict for one, other in combinations(lanes, 2) for conflict in _conflicts(one, other, slowed, priorities)
    ]
    return {
        "id": junction,
        "lanes": [lane.index for lane in lanes],
        "conflicts": sorted(conflicts, key=lambda conflict: (conflict["lane"], conflict["other"])),
        "phases": phases(junction, signals, records),
    }


def _conflicts(one: ParsedLane, other: ParsedLane, slowed: set[int], priorities: set[tuple[int, int]]) -> Iterator[Row]:
    """Yield the conflict of two lanes, if there is one, once for each of them."""
    if set(one.row["predecessors"]) & set(other.row["predecessors"]):
        return  # they part
    near = (one.width + other.width) / 2 * _TOUCHING
    if not _boxes_touch(one.rows[:, :2], other.rows[:, :2], near):
        return
    close = np.linalg.norm(one.rows[:, None, :3] - other.rows[None, :, :3], axis=2) < near
    if not close.any():
        return
    merging = bool(set(one.row["successors"]) & set(other.row["successors"]))
    yields = _yields(one, other, slowed, priorities)
    for lane, rival, axis, gives_way in ((one, other, 1, yields), (other, one, 0, not yields)):
        along = close.any(axis=axis)
        begin, end = np.flatnonzero(along)[[0, -1]] * lane.length / (len(along) - 1)
        yield {
            "lane": lane.index,
            "other": rival.index,
            "begin": float(begin),
            "end": float(end),
            "merging": merging,
            "yields": gives_way,
        }


def _boxes_touch(one: NDArray[np.float64], other: NDArray[np.float64], near: float) -> bool:
    return bool((one.min(axis=0) - near < other.max(axis=0)).all() and (other.min(axis=0) - near < one.max(axis=0)).all())


def _yields(one: ParsedLane, other: ParsedLane, slowed: set[int], priorities: set[tuple[int, int]]) -> bool:
    """Return whether the traffic of one lane yields to that of the other.

    The first rule that distinguishes them decides: stop and yield signs; priorities of the file; left turns yield to
    oncoming traffic; right before left; straight on before a turn.
    """
    if (one.index in slowed) != (other.index in slowed):
        return one.index in slowed
    roads = one.name[0], other.name[0]
    if (roads in priorities) != (roads[::-1] in priorities):
        return roads not in priorities
    between = other.rows[0, 3] - one.rows[0, 3]
    if abs(np.cos(between)) < _ALIKE and np.cos(between) > _ONCOMING:
        return bool(np.sin(between) < 0)  # traffic that heads to the left comes from the right
    ranks = _RANKS[one.row["turn"]], _RANKS[other.row["turn"]]
    return ranks[0] > ranks[1] if ranks[0] != ranks[1] else one.index > other.index
