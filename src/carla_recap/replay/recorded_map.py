"""The map of a recording: found by its name, or made of where its vehicles have driven."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.motion import place_in_metres
from carla_recap.roads.corridors import POSE, corridor_map, corridor_opendrive
from carla_recap.roads.find import find_map, plain_name
from carla_recap.tables.trajectories import actor_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.roads.drawing import RoadMap

T = TypeVar("T")

_AROUND: Final = 30.0  # s around what is shown, in which vehicles drive along what are its roads
_LONGEST: Final = 1800.0  # s of a recording
_AT_ONCE: Final = 10.0  # s in which a first pose is looked for


def find_map_of(recording: Recording, path: Path | str | None) -> Path | None:
    """Return the OpenDRIVE file of a recording's town; None if it is unknown.

    Args:
        recording: The recording; its map name is looked for.
        path: The map, or the folder to look in; None: the usual folders.

    Raises:
        RecapError: The given folder has no such map.
    """
    name = recording.header.map_name
    if path is not None and not Path(path).is_dir():
        return Path(path)
    found = find_map(name, path)
    if found is None and path is not None:
        raise RecapError(f"{path}: no .xodr for the map {name!r}")
    return found


def load_map_of(
    recording: Recording,
    path: Path | str | None,
    load: Callable[[Path], T],
    convert: Callable[[RoadMap], T],
    start: float = 0.0,
    duration: float = 0.0,
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

    Raises:
        RecapError: The given folder has no such map, or the map is damaged.
    """
    found = find_map_of(recording, path)
    if found is None:
        try:
            begin = max(start if start >= 0 else recording.info.duration + start, 0.0)
            stop = begin + duration + _AROUND if duration > 0 else math.inf
            corridors = corridors_of(recording, begin - _AROUND, stop)
            return None if corridors is None else convert(corridors)
        except RecapError:  # as of a damaged recording, which is reported elsewhere
            return None
    return load(found)


def corridors_of(recording: Recording, start: float = -math.inf, stop: float = math.inf) -> RoadMap | None:
    """Return what the vehicles of a recording have driven along as a road map.

    Args:
        recording: The recording.
        start: The elapsed seconds from which on it is read.
        stop: The elapsed seconds until which it is read.

    Returns:
        None for more than half an hour, which take too long to read for that.
    """
    if min(stop, recording.info.duration) - max(start, 0.0) > _LONGEST:
        return None
    return corridor_map(plain_name(recording.header.map_name), *_driven(recording, start, stop))


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
