"""A town to drive in: lanes, signals, junctions, walkways and barriers, from an OpenDRIVE file."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.roads.find import described_folder, find_map, plain_name
from carla_recap.roads.parsing import decode, parse_in_child, read_content
from carla_recap.sim.geometry import Location, Rotation, Transform
from carla_recap.sim.town.lanes import Lane, LaneIndex
from carla_recap.sim.town.parsing.packing import from_bytes
from carla_recap.util import cache

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

BUILT_IN: Final = "Brickfield"
"""The name of the town that comes with this package."""
_SUFFIX: Final = ".xodr"
_ABOVE: Final = 0.3  # m: the height of spawn points above the road, about as in CARLA's towns
_ABOVE_ENTRIES: Final = 3.0  # m: the same, in maps that clients send
_APART: Final = 10.0  # m: between spawn points; longer than any of the vehicles
_MOST_TOWNS: Final = 4  # in memory
_FROM_ENDS: Final = 5.0  # m: between a spawn point and the end of its lane


class SignalKind(StrEnum):
    """The kind of a signal."""

    LIGHT = "light"
    STOP = "stop"
    YIELD = "yield"
    SPEED_LIMIT = "speed_limit"


@dataclass(frozen=True, slots=True)
class Signal:
    """A traffic light or sign.

    Attributes:
        index: Its index in the list of signals.
        opendrive_id: Its id in the file.
        kind: The kind.
        transform: Its location; it faces the traffic that it governs.
        speed_limit: The speed limit in m/s, if it is a speed-limit sign.
        junction: The id of the junction before which it stands, if there is one.
        controller: The id of the controller of a light; lights of one controller change together.
        stops: The lanes that it governs, and the distance along each of the stop line, or of the begin of the speed limit.
        governs: The lanes beyond it, in the junction.
    """

    index: int
    opendrive_id: str
    kind: SignalKind
    transform: Transform
    speed_limit: float | None
    junction: int | None
    controller: str | None
    stops: tuple[tuple[int, float], ...]
    governs: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Conflict:
    """A stretch of a lane in a junction where another lane crosses it, or comes to it.

    Every conflict is listed twice, once for each of the two lanes.

    Attributes:
        lane: The lane.
        other: The other lane.
        begin: The distance along the lane at which the stretch begins, in m.
        end: The distance at which it ends, in m.
        merging: Whether both lanes lead to the same one; otherwise they cross.
        yields: Whether the traffic of the lane yields to that of the other one.
    """

    lane: int
    other: int
    begin: float
    end: float
    merging: bool
    yields: bool


@dataclass(frozen=True, slots=True)
class Junction:
    """A junction.

    Attributes:
        id: Its id in the file.
        lanes: The lanes through it.
        conflicts: The stretches where two of them cross or merge.
        phases: The lights that are green together, as indices of signals: one phase after another; empty without lights.
    """

    id: int
    lanes: tuple[int, ...]
    conflicts: tuple[Conflict, ...]
    phases: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, eq=False)
class WalkwayGraph:
    """The walkways: sidewalks and crossings, as a graph.

    Attributes:
        nodes: Locations, (n, 3).
        edges: Pairs of indices of nodes, each once, (m, 2).
        crossing: Whether an edge leads over a road, (m,).
    """

    nodes: Floats
    edges: Integers
    crossing: NDArray[np.bool_]


@dataclass(eq=False)
class Town:
    """A town, which is immutable. All is in m, in CARLA's axes: x forward, y right, z up.

    Attributes:
        name: Its name.
        opendrive: The text of its OpenDRIVE file.
        lanes: The lanes for cars.
        signals: Traffic lights and signs.
        junctions: The junctions.
        sidewalks: The middles of sidewalks, (n, 3) each.
        crossings: The outlines of pedestrian crossings, closed, (n, 3) each.
        walks: The walkways.
        barriers: Lines beyond the sidewalks that stop cars, (n, 3) each.
        spawn_points: Transforms somewhat above lanes from which all others can be reached.
        index: The index of the lanes.
    """

    name: str
    opendrive: str = field(repr=False)
    lanes: list[Lane] = field(repr=False)
    signals: list[Signal] = field(repr=False)
    junctions: list[Junction] = field(repr=False)
    sidewalks: list[Floats] = field(repr=False)
    crossings: list[Floats] = field(repr=False)
    walks: WalkwayGraph = field(repr=False)
    barriers: list[Floats] = field(repr=False)
    spawn_points: list[Transform] = field(init=False, repr=False)
    index: LaneIndex = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.index = LaneIndex(self.lanes)
        self.spawn_points = [place for lane in main_lanes(self.lanes) for place in _spawn_points(self.lanes[lane])]

    def renamed(self, name: str) -> Town:
        """Return the same town under another name."""
        town = copy(self)
        town.name = name
        return town

    def standalone(self) -> Town:
        """Return the same town with the spawn points that CARLA makes for a map that a client sends."""
        town = copy(self)
        town.spawn_points = _road_entries(self.lanes)
        return town

    def height(self, x: ArrayLike, y: ArrayLike, z: ArrayLike | None = None) -> Floats:
        """See `LaneIndex.height`."""
        return self.index.height(x, y, z)

    def nearest_lane(
        self, x: ArrayLike, y: ArrayLike, *, z: ArrayLike | None = None, heading: ArrayLike | None = None
    ) -> tuple[Integers, Floats]:
        """See `LaneIndex.nearest_lane`."""
        return self.index.nearest_lane(x, y, z=z, heading=heading)

    def project(self, lane: ArrayLike, x: ArrayLike, y: ArrayLike, s_hint: ArrayLike) -> tuple[Floats, Floats]:
        """See `LaneIndex.project`."""
        return self.index.project(lane, x, y, s_hint)


def load_town(name_or_path: str | Path = "", maps: Path | None = None) -> Town:
    """Return a town from an OpenDRIVE file; what was parsed before is kept, in memory and in the user's cache folder.

    Args:
        name_or_path: Nothing for the built-in town; else its name, a file, or the name of a map, such as `Town01`.
        maps: The folder of maps; else the environment variable CARLA_RECAP_MAPS says it.

    Raises:
        RecapError: There is no such town, or the file cannot be read or is no OpenDRIVE map with lanes for cars.
        MissingExtra: CARLA's client library is not installed.
    """
    name, path = _find(str(name_or_path), maps)
    content = read_content(path)
    key = content_key(content)
    with _lock:
        same = [town for (known, _), town in _towns.items() if known == key]
        town = _towns.pop((key, name), None)
    if town is None:
        town = (same or [_cached_town(key, content) or _parsed_town(key, content, path)])[0].renamed(name)
    with _lock:
        _towns[key, name] = town
        if len(_towns) > _MOST_TOWNS:
            del _towns[next(iter(_towns))]
    return town


def content_key(content: bytes) -> str:
    """Return the key of a map's content in the cache."""
    return cache.content_key(content, "sim/town/parsing", "roads")


def fill_cache(path: Path) -> None:
    """Parse an OpenDRIVE file into the user's cache folder, unless it is there.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map.
    """
    content = read_content(path)
    key = content_key(content)
    if cache.read_entry(key) is None:
        cache.write_entry(key, parse_in_child("carla_recap.sim.town.parsing", path, content))


def _cached_town(key: str, content: bytes) -> Town | None:
    data = cache.read_entry(key)
    if data is None:
        return None
    try:
        return _town(decode(content), data)
    except Exception:  # whatever an invalid entry causes
        cache.remove_entry(key)
        return None


def _parsed_town(key: str, content: bytes, path: Path) -> Town:
    data = parse_in_child("carla_recap.sim.town.parsing", path, content)
    town = _town(decode(content), data)
    cache.write_entry(key, data)
    return town


def _town(text: str, data: bytes) -> Town:
    parsed = from_bytes(data)
    edges = parsed.facts["walk_edges"]
    (nodes,) = parsed.lines["walks"]
    return Town(
        "",
        text,
        [_lane(row, rows) for row, rows in zip(parsed.facts["lanes"], parsed.lines["lanes"], strict=True)],
        [_signal(row) for row in parsed.facts["signals"]],
        [_junction(row) for row in parsed.facts["junctions"]],
        parsed.lines["sidewalks"],
        parsed.lines["crossings"],
        WalkwayGraph(
            nodes,
            np.array([edge["nodes"] for edge in edges], np.int64).reshape(-1, 2),
            np.array([edge["crossing"] for edge in edges], np.bool_),
        ),
        parsed.lines["barriers"],
    )


def main_lanes(lanes: Sequence[Lane]) -> list[int]:
    """Return the indices of the lanes of the largest strong component (Kosaraju): each of them leads to all others."""
    order = _postorder([lane.successors for lane in lanes], range(len(lanes)))
    components = []
    left = set(order)
    for start in reversed(order):
        if start in left:
            component = _reached([lane.predecessors for lane in lanes], start, left)
            components.append(sorted(component))
    return max(components, key=len)


def _postorder(following: Sequence[tuple[int, ...]], starts: range) -> list[int]:
    order, seen = [], set()
    for start in starts:
        stack = [(start, iter(following[start]))] if start not in seen else []
        seen.add(start)
        while stack:
            node, rest = stack[-1]
            unseen = next((other for other in rest if other not in seen), None)
            if unseen is None:
                order.append(node)
                stack.pop()
            else:
                seen.add(unseen)
                stack.append((unseen, iter(following[unseen])))
    return order


def _reached(following: Sequence[tuple[int, ...]], start: int, left: set[int]) -> list[int]:
    """Return the nodes that can be reached within a set, and remove them from it."""
    left.discard(start)
    reached = [start]
    for node in reached:  # grows
        for other in following[node]:
            if other in left:
                left.discard(other)
                reached.append(other)
    return reached


_towns: Final[dict[tuple[str, str], Town]] = {}
_lock: Final = Lock()


def _find(name: str, maps: Path | None) -> tuple[str, Path]:
    """Return the name of a town and its file."""
    if name.endswith(_SUFFIX):
        return Path(name).stem, Path(name)
    path = find_map(name or BUILT_IN, maps)
    if path is None:
        raise RecapError(f"town {name!r}: expected {BUILT_IN}, an {_SUFFIX} file, or a map in {described_folder(maps)}")
    return plain_name(name or BUILT_IN), path


def _spawn_points(lane: Lane) -> list[Transform]:
    if lane.junction is not None:
        return []
    at = np.arange(_FROM_ENDS, lane.length - _FROM_ENDS, _APART)
    columns = [np.interp(at, lane.s, column).tolist() for column in (*lane.points.T, lane.heading)]
    return [
        Transform(Location(x, y, z + _ABOVE), Rotation(yaw=_wrapped(np.degrees(heading).item())))
        for x, y, z, heading in zip(*columns, strict=True)
    ]


def _road_entries(lanes: Sequence[Lane]) -> list[Transform]:
    """Return the transforms at which lanes enter roads, junctions included: by road, right lanes before left ones."""
    last = {lane.road_id: lane.section for lane in sorted(lanes, key=lambda lane: lane.section)}
    entering = [lane for lane in lanes if lane.section == (0 if lane.lane_id < 0 else last[lane.road_id])]
    entering.sort(key=lambda lane: (lane.road_id, lane.lane_id > 0, lane.lane_id))
    points = []
    for lane in entering:
        (x, y, z), (_, _, ahead) = lane.points[:2].tolist()
        pitch = np.degrees(np.arctan2(ahead - z, lane.s[1] - lane.s[0])).item()
        yaw = _wrapped(np.degrees(lane.heading[0]).item())
        points.append(Transform(Location(x, y, z + _ABOVE_ENTRIES), Rotation(pitch, yaw)))
    return points


def _wrapped(degrees: float) -> float:
    """Return an angle within -180 and 180 degrees."""
    return degrees if -180 < degrees <= 180 else 180 - (180 - degrees) % 360


def _lane(row: dict[str, Any], rows: Floats) -> Lane:
    length = row.pop("length")
    row["successors"], row["predecessors"] = tuple(row["successors"]), tuple(row["predecessors"])
    return Lane(points=rows[:, :3].copy(), s=np.linspace(0, length, len(rows)), heading=rows[:, 3].copy(), **row)


def _signal(row: dict[str, Any]) -> Signal:
    x, y, z, yaw = row.pop("place")
    row["kind"] = SignalKind(row["kind"])
    row["stops"] = tuple((lane, s) for lane, s in row["stops"])
    row["governs"] = tuple(row["governs"])
    return Signal(transform=Transform(Location(x, y, z), Rotation(yaw=yaw)), **row)


def _junction(row: dict[str, Any]) -> Junction:
    return Junction(
        row["id"],
        tuple(row["lanes"]),
        tuple(Conflict(**conflict) for conflict in row["conflicts"]),
        tuple(tuple(phase) for phase in row["phases"]),
    )
