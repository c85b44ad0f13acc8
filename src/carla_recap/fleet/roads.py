"""Queries that take the roads of a recording's map, which is looked for: incidents and measures."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.queries.incidents import incidents as query_incidents
from carla_recap.queries.kinds import KINDS, kind_named
from carla_recap.queries.measures import measures as query_measures

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.queries.incidents import Incidents
    from carla_recap.queries.measures import Measures
    from carla_recap.roads.network import RoadNetwork

WHERE_MAPS: Final = "--map or CARLA_RECAP_MAPS says where maps are"
WITHOUT_ROADS: Final = f"rules of the road are left out; {WHERE_MAPS}"
"""What follows from an unknown map, and what to do, for warnings."""


def roads_of(source: Reader, road_map: str | None = None, *, needed: bool = False) -> RoadNetwork | None:
    """Return the roads of a recording's map; None if its file is unknown.

    Args:
        source: The recording.
        road_map: The map, or the folder to look in; None: the usual folders.
        needed: Whether an unknown map is an error.

    Raises:
        RecapError: The map is needed and unknown, the given folder does not have it, or the map is damaged.
    """
    from carla_recap.roads.surfaces import find_road_network, load_road_network

    name = source.header.map_name
    if road_map is not None and not Path(road_map).is_dir():
        return load_road_network(road_map)
    found = find_road_network(name, road_map)
    if found is None and (needed or road_map is not None):
        if road_map is None:
            raise RecapError(f"{source.location}: {_unknown(name)}, whose roads are needed; {WHERE_MAPS}")
        raise RecapError(f"{source.location}: there is no .xodr in {road_map} for the map {name!r}, whose roads are needed")
    return found


def kinds_and_roads(kinds: Any, source: Reader, road_map: str | None = None) -> tuple[Any, RoadNetwork | None]:
    """Return kinds of incidents that can be found, and the roads that they take; None if they take none.

    Args:
        kinds: The kinds; those of the road are left out if the map is unknown.
        source: The recording.
        road_map: See `roads_of`.

    Raises:
        RecapError: The map is unknown, and all kinds are of the road; or see `roads_of`.

    Warns:
        RecapWarning: The map is unknown, and kinds of the road are left out.
    """
    asked = set(KINDS if kinds == "all" else (kinds,) if isinstance(kinds, str) else kinds or ())
    others = {kind for kind in asked if not kind_named(kind).needs_roads}
    if others == asked:
        return kinds, None
    roads = roads_of(source, road_map, needed=not others)
    if roads is not None:
        return kinds, roads
    warn_without_roads(source)
    return sorted(others), None


def warn_without_roads(source: Reader) -> None:
    """Warn that the map of a recording is unknown."""
    message = f"{source.location}: {_unknown(source.header.map_name)}; {WITHOUT_ROADS}"
    warnings.warn(message, RecapWarning, stacklevel=4)


def _unknown(name: str) -> str:
    return f"the map {name!r} is unknown"


def unknown_map(warning: str) -> str | None:
    """Return the name of the map, quoted, that a warning says is unknown; None if it is about something else."""
    match = re.search(rf"the map (.*) is unknown; {WITHOUT_ROADS}", warning)
    return match[1] if match else None


def incidents(source: Reader, *, kinds: Any = None, road_map: str | None = None, **options: Any) -> Incidents:
    """Return the incidents of a recording; see `carla_recap.queries.incidents.incidents`.

    Args:
        source: The recording.
        kinds: The kinds to include.
        road_map: See `roads_of`; for the kinds of the road.
        options: The other arguments of the query.

    Raises:
        RecapError: See `kinds_and_roads` and the query.

    Warns:
        RecapWarning: See `kinds_and_roads`.
    """
    found, roads = kinds_and_roads(kinds, source, road_map)
    return query_incidents(source, kinds=found, roads=roads, **options)


def measures(source: Reader, *, actors: Any = None, road_map: str | None = None) -> Measures:
    """Return the measures of actors, with those of the road if the map is known; see `carla_recap.queries.measures`.

    Args:
        source: The recording.
        actors: The actors to measure.
        road_map: See `roads_of`.

    Raises:
        RecapError: See `roads_of` and the query.

    Warns:
        RecapWarning: The map is unknown.
    """
    roads = roads_of(source, road_map)
    if roads is None:
        warn_without_roads(source)
    return query_measures(source, actors, roads=roads)
