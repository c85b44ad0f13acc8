"""Route files of CARLA's Leaderboard: the places that a route passes, and its town."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.roads.elements import DocumentShape, read_elements
from carla_recap.roads.files import expecting, read_parts
from carla_recap.roads.find import map_key, plain_name
from carla_recap.util.text import first_of, visible

if TYPE_CHECKING:
    from collections.abc import Sequence
    from xml.etree.ElementTree import Element

    from carla_recap.formats.base import Reader
    from carla_recap.util.arrays import Floats


_ROUTES: Final = DocumentShape(
    root="routes",
    content=frozenset(("route",)),
    known=frozenset(("waypoints", "position", "waypoint", "scenarios", "scenario")),
    file="route file",
    part="route",
    most=1_000_000,
    most_of_part=100_000,
)
_EXPECTED: Final = "a route file of CARLA's Leaderboard"
_MOST_ROUTES: Final = 10_000  # of a file; the Leaderboard's have up to 220
_MOST_POSITIONS: Final = 2_000  # of a route; the Leaderboard's have up to 200
_FARTHEST: Final = 1e6  # m from the origin
_SHOWN: Final = 40  # characters of a wrong value in an error
_RECORDED: Final = re.compile(r"RouteScenario_(.+)_rep(\d+)")
"""The name of a recording of the evaluator: the id of the route, and the number of the repetition."""


@dataclass(frozen=True, eq=False)
class Route:
    """A route of a route file.

    Attributes:
        id: The id.
        town: The name of the map.
        positions: The places that it passes, (n, 3), in m, right-handed.
        scenarios: The types of the scenarios along it.
        path: The file.
    """

    id: str
    town: str
    positions: Floats
    scenarios: tuple[str, ...] = ()
    path: str = ""


def read_routes(*paths: Path | str) -> list[Route]:
    """Return the routes of route files, of Leaderboard 1.0 or 2.

    Raises:
        RecapError: A file cannot be read.
        FormatError: One is no route file, or something in it is wrong.
    """
    return [route for path in dict.fromkeys(map(Path, paths)) for route in _routes(path)]


def _routes(path: Path) -> list[Route]:
    with expecting(path, _EXPECTED):
        routes: list[Route] = []
        for element in read_elements(read_parts(path, _ROUTES.file), _ROUTES):
            if len(routes) >= _MOST_ROUTES:
                raise ValueError(f"at most {_MOST_ROUTES:,} routes, and it has more")
            routes.append(_route(element, str(path)))
        if not routes:
            raise ValueError("no route is in it")
    return routes


def route_for(routes: Sequence[Route], source: Reader, id: str | None = None) -> Route:
    """Return the route by which a recording is scored.

    It is the one of an id, else of that in the name of the recording, if the evaluator has named it, else the only one of
    its town. If routes of several files fit, that of the file in the recording's folder is taken.

    Raises:
        RecapError: There is none, or it is of another town.
    """
    files, location = first_of(list(dict.fromkeys(route.path for route in routes))), source.location
    named = _RECORDED.search(Path(location).name) if id is None else None
    wanted = named[1] if named else id
    town = plain_name(source.header.map_name)
    fitting = routes if wanted is None else [route for route in routes if route.id == wanted]
    if not fitting and named:
        raise RecapError(
            f"{location}: the name says route {visible(named[1])!r}; {files} has {_listed(routes)}; --route-id names another"
        )
    if not fitting:
        raise RecapError(f"{files}: there is no route {visible(wanted or '')!r}; it has {_listed(routes)}")
    if not (of_town := [route for route in fitting if map_key(route.town) == map_key(town)]):
        towns = first_of(sorted({visible(route.town) for route in fitting}))
        raise RecapError(f"{location}: is of the map {visible(town)!r}, and the route of {files} is of {towns}")
    folder = Path(location).absolute().parent
    found = [route for route in of_town if Path(route.path).absolute().parent == folder] or of_town
    if len({route.id for route in found}) > 1:
        raise RecapError(f"{files}: has {len(found)} routes for {location}; --route-id names one of {_listed(found)}")
    if len(found) > 1:
        paths = first_of([route.path for route in found])
        raise RecapError(f"{location}: expected one route {visible(found[0].id)!r}, found {len(found)}: in {paths}")
    return found[0]


def repetition(location: str) -> int:
    """Return the number of the repetition in the name of a recording of the evaluator; else 0."""
    named = _RECORDED.search(Path(location).name)
    return int(named[2][:9]) if named else 0


def _listed(routes: Sequence[Route]) -> str:
    return first_of([visible(route.id[:_SHOWN]) for route in routes], 5)


def _route(element: Element, path: str) -> Route:
    id, town = element.get("id", ""), element.get("town", "")
    name = visible(id[:_SHOWN])
    if not id:
        raise ValueError("a route has no id")
    if not town:
        raise ValueError(f"route {name!r} has no town")
    places = element.findall("waypoints/position") or element.findall("waypoint")
    if not 2 <= len(places) <= _MOST_POSITIONS:
        raise ValueError(f"2 to {_MOST_POSITIONS:,} positions of a route, and route {name!r} has {len(places):,}")
    rows = [
        [_number(place, axis, f"position {number} of route {name!r}") for axis in "xyz"]
        for number, place in enumerate(places, 1)
    ]
    scenarios = tuple(scenario.get("type", "") for scenario in element.findall("scenarios/scenario"))
    return Route(id, town, np.array(rows) * (1.0, -1.0, 1.0), scenarios, path)


def _number(element: Element, axis: str, what: str) -> float:
    text = element.get(axis, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= _FARTHEST:
        shown = visible(text[:_SHOWN])
        raise ValueError(f"{what} has a number {axis} of at most {_FARTHEST:,.0f} m, and it is {shown!r}")
    return value
