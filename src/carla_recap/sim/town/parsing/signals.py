"""Traffic lights and signs: what they are, which lanes they are for, and which lights change together."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.maps import opendrive
from carla_recap.sim.town.parsing.records import in_metres_per_second

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.sim.town.parsing.lanes import ParsedLane
    from carla_recap.sim.town.parsing.records import Records

    Row = dict[str, Any]

_KINDS: Final = {
    opendrive.LIGHT: "light",
    opendrive.STOP: "stop",
    opendrive.YIELD: "yield",
    opendrive.SPEED_LIMIT: "speed_limit",
}
_SAME_WAY: Final = np.cos(np.radians(35))  # approaches of a junction that are one, or opposite to each other


def parse_signals(roads: opendrive.Roads, lanes: list[ParsedLane], records: Records) -> list[Row]:
    """The lights and signs in the order of their ids; every one is there once."""
    by_road = defaultdict(list)
    for lane in lanes:
        by_road[lane.name[0]].append(lane)
    places: dict[str, list[opendrive.Sign]] = defaultdict(list)
    for sign in roads.signs:
        if sign.kind in _KINDS and np.isfinite((*sign.place, sign.heading, sign.station)).all():
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
    signs: list[opendrive.Sign],
    by_road: dict[int, list[ParsedLane]],
    lanes: list[ParsedLane],
    records: Records,
) -> Row:
    first = signs[0]
    kind = _KINDS[first.kind]
    told = [
        (lane, sign)
        for sign in signs
        for lane in (_facing if (sign.road, sign.id) in records.for_all else _told)(sign, by_road[sign.road])
    ]
    if not told:  # it says that it is for no lane, and no other road refers to it
        told = [(lane, sign) for sign in signs for lane in _facing(sign, by_road[sign.road])]
    stops, governs = _stops(kind, told, lanes)
    junctions = (lanes[lane].junction for lane in governs)
    (x, y, z), yaw = first.place.tolist(), float(np.degrees(-first.heading))
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


def _told(sign: opendrive.Sign, lanes: Iterable[ParsedLane]) -> Iterator[ParsedLane]:
    """The lanes of a road that a sign names, where it is."""
    for lane in lanes:
        low, high = sorted(lane.stations)
        number = lane.name[2]
        named = any(min(pair) <= number <= max(pair) for pair in sign.lanes)
        if named and low - 1 <= sign.station <= high + 1:
            yield lane


def _facing(sign: opendrive.Sign, lanes: Iterable[ParsedLane]) -> Iterator[ParsedLane]:
    """The lanes of a road on which one drives in the direction that a sign is for, where it is."""
    for lane in lanes:
        start, stop = lane.stations
        along = sign.ahead is None or sign.ahead == (start < stop)
        if along and min(start, stop) - 1 <= sign.station <= max(start, stop) + 1:
            yield lane


def _stops(
    kind: str, told: list[tuple[ParsedLane, opendrive.Sign]], lanes: list[ParsedLane]
) -> tuple[dict[int, float], set[int]]:
    """Where one stops: at the end of a lane before a junction, else at the sign; and what is governed beyond."""
    stops: dict[int, float] = {}
    governs: set[int] = set()
    for lane, sign in told:
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


def _speed(sign: opendrive.Sign) -> float | None:
    """The limit on a sign; without a unit, CARLA's signs are in km/h."""
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
    """The direction in which one drives up to a light."""
    if row["stops"]:
        return float(lanes[row["stops"][0][0]].rows[-1, 3])
    return float(np.radians(row["place"][3] + 90))


def phases(junction: int, rows: list[Row], records: Records) -> list[list[int]]:
    """The lights of a junction that are green together, in the order in which they are."""
    groups = defaultdict(list)
    for row in rows:
        if row["kind"] == "light" and row["junction"] == junction:
            groups[row["controller"]].append(row["index"])
    known = [name for name in records.controllers if name in groups]
    return [groups[name] for name in (*known, *(name for name in groups if name not in records.controllers))]
