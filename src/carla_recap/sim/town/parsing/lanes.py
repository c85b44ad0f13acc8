"""The lanes for cars: their middles as driven, what follows them, and how fast one may drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.maps.opendrive import NO_JUNCTION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.maps import opendrive
    from carla_recap.sim.town.parsing.records import Records

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
        rows: Of x, y, z, heading and width along it as driven, evenly spaced.
        length: In m.
        junction: The id of its junction, if it lies in one.
        stations: Where along the road it begins and ends, as driven.
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
        """Its place in the list of lanes."""
        return int(self.row["index"])

    @property
    def width(self) -> float:
        """In its middle."""
        return float(self.row["width"])


def parse_lanes(roads: opendrive.Roads) -> list[ParsedLane]:
    """The lanes for cars, in the order of roads, sections and numbers; without speed limits.

    Raises:
        ValueError: There is none, a place is no number, or there are too many for a town.
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


def _rows(lane: opendrive.Lane) -> Floats:
    """Evenly spaced rows along a lane."""
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


def _lane(index: int, lane: opendrive.Lane, rows: Floats) -> ParsedLane:
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


def _link(lanes: list[ParsedLane], driving: Iterable[opendrive.Lane]) -> None:
    """Let the lanes know what is before, after and beside them."""
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
        records: The limits that the file tells.
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
