"""The map of a recording: found by its name, or made of where its vehicles have driven."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from carla_recap.errors import MissingExtra, RecapError, RecapWarning
from carla_recap.maps.corridors import corridor_map
from carla_recap.maps.road_map import RoadMap, find_map

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.recording import Recording

T = TypeVar("T")

_AROUND: Final = 30.0  # s around what is shown, in which vehicles drive along what are its roads


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

    None if that is not known either, or if an extra is missing; a warning says so.

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
            corridors = corridor_map(recording, begin - _AROUND, stop)
            return None if corridors is None else convert(corridors)
        except RecapError:  # as of a damaged recording, which is reported elsewhere
            return None
    try:
        return load(found)
    except MissingExtra as error:
        warnings.warn(f"{error}; the rest is shown without it", RecapWarning, stacklevel=2)
        return None
