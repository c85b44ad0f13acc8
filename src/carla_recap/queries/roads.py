"""The roads of a recording's map, for the queries that need them."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError, RecapWarning

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.roads.network import RoadNetwork

WHERE_MAPS: Final = "--map or CARLA_RECAP_MAPS says where maps are"
WITHOUT_ROADS: Final = f"rules of the road are left out; {WHERE_MAPS}"
"""What follows from an unknown map, and what to do, for warnings."""


def roads_of(
    source: Reader, road_map: str | None = None, *, needed: bool = False, lane_types: frozenset[str] | None = None
) -> RoadNetwork | None:
    """Return the roads of a recording's map, with some types of lanes; None if its file is unknown; see `find_map_of`."""
    from carla_recap.roads import load_road_network

    found = find_map_of(source, road_map, needed=needed)
    return None if found is None else load_road_network(found, lane_types)


def find_map_of(source: Reader, road_map: Path | str | None = None, *, needed: bool = False) -> Path | None:
    """Return the OpenDRIVE file of a recording's map: a given one, or one of its name in a folder, or in the usual ones.

    Without any, it is None, or an error if a folder is given or the map is `needed`.
    """
    from carla_recap.roads import find_map

    name = source.header.map_name
    if road_map is not None and not Path(road_map).is_dir():
        return Path(road_map)
    found = find_map(name, road_map)
    if found is None and road_map is not None:
        raise RecapError(f"{source.location}: no .xodr in {road_map} for the map {name!r}")
    if found is None and needed:
        raise RecapError(f"{source.location}: {_unknown(name)}, but its roads are needed; {WHERE_MAPS}")
    return found


def warn_without_roads(source: Reader) -> None:
    """Warn that the map of a recording is unknown."""
    message = f"{source.location}: {_unknown(source.header.map_name)}; {WITHOUT_ROADS}"
    warnings.warn(message, RecapWarning, stacklevel=4)


def unknown_map(warning: str) -> str | None:
    """Return the name of the map, quoted, that a warning says is unknown; None if it is about something else."""
    match = re.search(rf"the map (.*) is unknown; {WITHOUT_ROADS}", warning)
    return match[1] if match else None


def _unknown(name: str) -> str:
    return f"the map {name!r} is unknown"
