"""Towns to drive in: lanes, signals, junctions, walkways and barriers, of an OpenDRIVE file.

Where the map of a recording is unavailable, the corridors that its vehicles have driven are the town.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.roads.barriers import barriers
from carla_recap.roads.files import expecting, read_text
from carla_recap.roads.find import described_folder, find_map, plain_name
from carla_recap.roads.landmarks import find_landmarks
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform
from carla_recap.sim.town.graph import Paths, largest_strong_component
from carla_recap.sim.town.junctions import make_junctions, make_signals
from carla_recap.sim.town.lanes import LaneIndex, make_lanes
from carla_recap.sim.town.sidewalks import make_walks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from carla_recap.sim.town.junctions import Junction, Signal
    from carla_recap.sim.town.lanes import Lane
    from carla_recap.sim.town.sidewalks import WalkwayGraph
    from carla_recap.util.arrays import Booleans, Floats, Integers


BUILT_IN: Final = "Brickfield"
"""The name of the town that comes with this package."""
_SUFFIX: Final = ".xodr"
_ABOVE: Final = 0.3  # m: the height of spawn points above the road, about as in CARLA's towns
_ABOVE_ENTRIES: Final = 3.0  # m: the same, in maps that clients send
_APART: Final = 10.0  # m: between spawn points; longer than any of the vehicles
POLE_RADIUS: Final = 0.15  # m
_POLE_BELOW, _POLE_ABOVE = 1.0, 3.0  # m: how far a pole reaches below the road and above its sign
_MOST_TOWNS: Final = 4  # in memory
_MOST_LANES: Final = 8_000  # of a town
_UNNAMED: Final = "Corridors"  # the town of a recording that names no map
_FROM_ENDS: Final = 5.0  # m: between a spawn point and the end of its lane


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
        is_of_corridors: Whether its roads are the corridors of a recording.
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
    is_of_corridors: bool = False
    spawn_points: list[Transform] = field(init=False, repr=False)
    index: LaneIndex = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.index = LaneIndex(self.lanes)
        self.spawn_points = [place for lane in main_lanes(self.lanes) for place in _spawn_points(self.lanes[lane])]

    @cached_property
    def poles(self) -> list[tuple[float, float] | None]:
        """The lowest and the highest z of the pole of each signal, in m; None for those that hang over the road."""
        if not self.signals:
            return []
        places = [signal.transform.location for signal in self.signals]
        x, y, z = np.array([(place.x, place.y, place.z) for place in places]).T
        ground = self.height(x, y, z)
        lowest, highest = ground - _POLE_BELOW, np.maximum(ground, z) + _POLE_ABOVE
        poles = zip(self.on_road(x, y, ground, POLE_RADIUS).tolist(), lowest.tolist(), highest.tolist(), strict=True)
        return [None if hangs else (low, high) for hangs, low, high in poles]

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

    @cached_property
    def paths(self) -> Paths:
        """The shortest paths along the walkways."""
        return Paths(self.walks.nodes, self.walks.edges)

    def expect_walkway(self, start: Location, goal: Location) -> None:
        """Make sure that walkways lead from one location to another; `SimError`: there are none, or none leads there."""
        if not len(self.walks.nodes):
            raise SimError(f"{self.name} has no sidewalks: walkers can only be steered")
        first, last = (self.paths.nearest(place.x, place.y) for place in (start, goal))
        if last not in self.paths.reachable(first):
            raise SimError(f"no sidewalk leads from ({start.x:.1f}, {start.y:.1f}) to ({goal.x:.1f}, {goal.y:.1f})")

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

    def on_road(self, x: ArrayLike, y: ArrayLike, z: ArrayLike, margin: float = 0.0) -> Booleans:
        """Return whether locations, (k,), are on lanes, or within a margin in m beside the nearest one."""
        lanes, s = self.nearest_lane(x, y, z=z)
        aside = self.project(lanes, x, y, s)[1]
        halves = np.array([self.lanes[lane].width / 2 for lane in lanes.tolist()])
        return np.abs(aside) <= halves + margin


def load_town(name_or_path: str | Path = "", maps: Path | None = None, *, called: str = "") -> Town:
    """Return a town from an OpenDRIVE file; those that were made last are kept in memory.

    Args:
        name_or_path: Nothing for the built-in town; else its name, a file, or the name of a map, such as `Town01`.
        maps: The folder of maps; else the environment variable CARLA_RECAP_MAPS says it.
        called: Another name for the town.

    Raises:
        RecapError: There is no such town, or the file cannot be read or is no OpenDRIVE map with lanes for cars.
    """
    name, path = find_town(str(name_or_path), maps)
    name = called or name
    text = read_text(path)
    with _lock:
        same = [town for (known, _), town in _towns.items() if known == text]
        town = _towns.pop((text, name), None)
    if town is None:
        town = (same or [make_town(text, path)])[0].renamed(name)
    with _lock:
        _towns[text, name] = town
        if len(_towns) > _MOST_TOWNS:
            del _towns[next(iter(_towns))]
    return town


def make_town(text: str, path: Path) -> Town:
    """Return the town of the text of an OpenDRIVE file; `FormatError`: it is no OpenDRIVE map with lanes for cars."""
    with np.errstate(all="ignore"), expecting(path):
        roads = TownRoads(read_opendrive(text), _MOST_LANES)
        courses = sorted(
            (lane for lane in roads.lanes if lane.is_driving), key=lambda lane: (lane.road, lane.section, lane.id)
        )
        lanes = make_lanes(courses)
        signals = make_signals(find_landmarks(roads), lanes, courses, roads.content.controllers)
        walks = make_walks(roads)
        return Town(
            "",
            text,
            lanes,
            signals,
            make_junctions(lanes, signals, roads.content),
            walks.sidewalks,
            walks.crossings,
            walks.graph(),
            [barrier.line for barrier in barriers(roads.lanes)],
        )


def main_lanes(lanes: Sequence[Lane]) -> list[int]:
    """Return the indices of the largest set of lanes of which each leads to all others."""
    return largest_strong_component([lane.successors for lane in lanes], [lane.predecessors for lane in lanes])


_towns: Final[dict[tuple[str, str], Town]] = {}
_corridors: Final[dict[tuple[str, int, int], Town]] = {}
_lock: Final = Lock()


def find_town(name: str, maps: Path | None = None) -> tuple[str, Path]:
    """Return the name of a town and its file; see `load_town`. `RecapError`: there is no such town."""
    if name.endswith(_SUFFIX):
        return Path(name).stem, Path(name)
    path = find_map(name or BUILT_IN, maps)
    if path is None:
        raise RecapError(f"town {name!r}: expected {BUILT_IN}, an {_SUFFIX} file, or a map in {described_folder(maps)}")
    return plain_name(name or BUILT_IN), path


def is_unknown(map_name: str, maps: Path | None) -> bool:
    """Return whether there is no file of a map."""
    return not plain_name(map_name) or find_map(plain_name(map_name), maps) is None


def load_corridors(path: Path, map_name: str) -> Town:
    """Return a town of the corridors that the vehicles of a recording have driven; the latest one is kept in memory.

    A `RecapError` is raised if the recording cannot be read.
    """
    from carla_recap.recording import open_recording
    from carla_recap.replay.recorded_map import opendrive_of_corridors

    status = path.stat()
    key = (str(path.absolute()), status.st_mtime_ns, status.st_size)
    with _lock:
        town = _corridors.get(key)
    if town is None:
        with open_recording(path) as recording:
            town = make_town(opendrive_of_corridors(recording), path).renamed(plain_name(map_name) or _UNNAMED)
            town.is_of_corridors = True
        with _lock:
            _corridors.clear()
            _corridors[key] = town
    return town


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
    """Return the transforms at which lanes enter roads, junctions included: by road, those in its direction first."""
    last = {lane.road_id: lane.section for lane in sorted(lanes, key=lambda lane: lane.section)}
    entering = [lane for lane in lanes if lane.section == (last[lane.road_id] if lane.reverse else 0)]
    entering.sort(key=lambda lane: (lane.road_id, lane.reverse, lane.lane_id))
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
