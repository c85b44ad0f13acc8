"""The town's map that a command shows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.cli.output import warn

if TYPE_CHECKING:
    from carla_recap.maps import RoadMap
    from carla_recap.recording import Recording


def road_map_of(recording: Recording, path: str | None) -> RoadMap | None:
    """The map that was asked for, or that the recording's map name finds; without the extra, none, and a warning."""
    from carla_recap.errors import MissingExtra, RecapError
    from carla_recap.maps import find_map, load_map

    name = recording.header.map_name
    if path is None or Path(path).is_dir():
        found = find_map(name, path)
        if found is None and path is not None:
            raise RecapError(f"{path}: no .xodr for the map {name!r}")
    else:
        found = Path(path)
    if found is None:
        return None
    try:
        return load_map(found)
    except MissingExtra as error:
        warn(f"{error}; the rest is shown without it")
        return None
