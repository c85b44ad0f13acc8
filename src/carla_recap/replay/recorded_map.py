"""The map of a recording: found by its name, or made of where its vehicles have driven."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.motion import place_in_metres
from carla_recap.queries.roads import find_map_of
from carla_recap.replay.player import Player
from carla_recap.replay.pose import LOCATION, right_handed
from carla_recap.roads.corridors import POSE, corridor_map, corridor_opendrive
from carla_recap.roads.find import plain_name
from carla_recap.tables.trajectories import actor_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.roads.drawing import RoadMap

T = TypeVar("T")

_AROUND: Final = 30.0  # s around what is shown, in which vehicles drive along what are its roads
LONGEST_DRIVEN: Final = 1800.0
"""The seconds of a recording of which it is read where vehicles have driven; of longer ones that takes too long."""
_LINES: Final = ("junctions", "centre_lines", "lane_borders", "crossings", "stop_lines")  # of a map
_MARGIN: Final = 100.0  # m; the distance from a map at which an actor is still on it
_AT_ONCE: Final = 10.0  # s in which a first pose is looked for


def load_map_of(
    recording: Recording,
    path: Path | str | None,
    load: Callable[[Path], T],
    convert: Callable[[RoadMap], T | None],
    start: float = 0.0,
    duration: float = 0.0,
    *,
    longest: float = LONGEST_DRIVEN,
) -> T | None:
    """Return the map of a recording's town; without one, what its vehicles have driven along.

    None if that is not known either.

    Args:
        recording: The recording; its map name is looked for.
        path: The map, or the folder to look in; None: the usual folders.
        load: What loads a map's file.
        convert: What makes the same of a map of corridors.
        start: The elapsed seconds from which on the recording is shown; negative: before the end.
        duration: The seconds that are shown; 0: all of the rest.
        longest: See `corridors_of`.

    Raises:
        RecapError: The given folder has no such map, or the map is damaged.
    """
    found = find_map_of(recording.reader, path)
    if found is None:
        try:
            begin = max(start if start >= 0 else recording.info.duration + start, 0.0)
            stop = begin + duration + _AROUND if duration > 0 else math.inf
            corridors = corridors_of(recording, begin - _AROUND, stop, longest=longest)
            return None if corridors is None else convert(corridors)
        except RecapError:  # as of a damaged recording, which is reported elsewhere
            return None
    return load(found)


def corridors_of(
    recording: Recording, start: float = -math.inf, stop: float = math.inf, *, longest: float = LONGEST_DRIVEN
) -> RoadMap | None:
    """Return what the vehicles of a recording have driven along as a road map.

    It is read between two moments, in elapsed seconds; None if these are more than `longest` s apart.
    """
    if min(stop, recording.info.duration) - max(start, 0.0) > longest:
        return None
    return corridor_map(plain_name(recording.header.map_name), *_driven(recording, start, stop))


def map_around(road_map: RoadMap | None, player: Player) -> RoadMap | None:
    """Return a map; None without one, or if it is that of another town, far from all actors at the start.

    Warns:
        RecapWarning: It is that of another town.
    """
    if road_map is None:
        return None
    lines = [line[:, :2] for name in _LINES for line in getattr(road_map, name) if len(line)]
    locations = first_locations(player)[:, :2]
    if not lines or not len(locations):
        return road_map
    points = np.concatenate(lines)
    low, high = np.nanmin(points, axis=0) - _MARGIN, np.nanmax(points, axis=0) + _MARGIN
    if ((locations >= low) & (locations <= high)).all(axis=1).any():
        return road_map
    warnings.warn(f"{road_map.name}: no actor is near this map, which is left out", RecapWarning, stacklevel=3)
    return None


def first_locations(player: Player) -> NDArray[np.float64]:
    """Return the locations of the actors at the start, (n, 3) in m, right-handed."""
    scene = Player(player.reader).at(player.start)
    poses = [pose for id in {*scene.ids.tolist(), *scene.actors} if (pose := scene.pose_of(id)) is not None]
    locations = right_handed(np.array(poses).reshape(-1, 6))[:, LOCATION]
    return locations[np.isfinite(locations).all(axis=1)]


def opendrive_of_corridors(recording: Recording) -> str:
    """Return an OpenDRIVE map whose roads are what the vehicles of a recording have driven along."""
    return corridor_opendrive(*_driven(recording))


def _driven(
    recording: Recording, start: float = -math.inf, stop: float = math.inf
) -> tuple[list[NDArray[np.void]], Iterator[NDArray[np.void]]]:
    """Return the poses of each vehicle, and those of all actors soon after the start, read when needed."""
    vehicles = {actor.id for actor in recording.actors.values() if actor.kind == "vehicle"}
    return list(_poses(recording, vehicles, start, stop)), _poses(
        recording, None, start, min(stop, max(start, 0.0) + _AT_ONCE)
    )


def _poses(recording: Recording, ids: set[int] | None, start: float, stop: float) -> Iterator[NDArray[np.void]]:
    """Yield the poses of each actor."""
    rows = actor_rows(recording.reader, ("transforms",), ids, start=start, stop=stop)["transforms"]
    for found in rows.values():
        poses = np.empty(len(found.records), POSE)
        poses["time"] = found.time
        with np.errstate(invalid="ignore"):  # a signaling NaN
            x, y, z, yaw = (found.records[name].astype(np.float64) for name in ("x", "y", "z", "yaw"))
            poses["x"], poses["y"], poses["z"] = place_in_metres(x, y, z)
            poses["yaw"] = -yaw
        yield poses
