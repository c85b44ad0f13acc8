"""The commands that print what a recording contains."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import click

from carla_recap.cli import options
from carla_recap.cli.many import QueryRequest, is_one
from carla_recap.cli.options import FOLLOW, MEASURED, TIME, command, flag, option
from carla_recap.cli.output import counted, note
from carla_recap.errors import RecapWarning

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorName
    from carla_recap.queries.incidents import IncidentOptions, Incidents

_sources = options.together(options.sources, options.json, options.text)
_many = options.together(options.jobs, options.dask, options.merged("request", lambda: QueryRequest))
_report = options.together(_sources, options.compat)


@command(
    _report,
    flag("--all", "everything", help="Every record of every frame, not only the events."),
    _many,
    epilog=options.EPILOG,
)
def info(request: QueryRequest, everything: bool) -> None:
    """Print the contents: spawns, collisions and other events."""
    from carla_recap.queries.info import info as query

    request.answer(partial(query, all=everything, compat=request.compat))


@command(
    _report,
    option(
        "--types",
        default="aa",
        metavar="AB",
        help="The two sides: h hero, v vehicle, w walker, t traffic light, o other, a any.",
    ),
    options.max_rows,
    _many,
    epilog=options.EPILOG,
)
def collisions(request: QueryRequest, types: str) -> None:
    """Print the collisions."""
    from carla_recap.queries.collisions import check_letters
    from carla_recap.queries.collisions import collisions as query

    if len(types) != 2:
        raise click.BadParameter(f"{types!r} is not two of the letters h, v, w, t, o, a, such as hv.", param_hint="--types")
    if not request.compat:
        check_letters(*types)
    speeds = request.shape != "text"  # CARLA's text has none
    request.answer(partial(query, type1=types[0], type2=types[1], compat=request.compat, speeds=speeds))


@command(
    _report,
    options.min_time(TIME),
    options.min_distance,
    options.max_rows,
    _many,
    epilog=options.EPILOG,
)
def blocked(request: QueryRequest, min_time: float, min_distance: float) -> None:
    """Print the actors that stood still for long."""
    from carla_recap.queries.blocked import blocked as query

    if min_time < 0 and not request.compat:  # which CARLA accepts
        raise click.BadParameter(f"'{min_time:g}' is not a number of 0 or more.", param_hint="'--min-time'")
    request.answer(partial(query, min_time=min_time, min_distance=min_distance, compat=request.compat))


@command(
    _sources,
    options.road_map,
    _many,
    epilog=options.EPILOG,
)
def summary(request: QueryRequest, road_map: str | None) -> None:
    """Print an overview: actors by kind, how far and how fast the hero drives, incidents by kind.

    Of many recordings, that is a line each.
    """
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.queries.summary import summary as query

    if len(request.sources) == 1 and is_one(request.sources[0]):
        request = replace(request, form=request.form or "text")
    request.answer(partial(query, options=IncidentOptions(kinds="all", road_map=road_map)))


@command(
    _sources,
    _many,
    epilog=options.EPILOG,
)
def actors(request: QueryRequest) -> None:
    """Print the actors, and when they existed."""
    from carla_recap.queries.recorded_actors import actors as query

    request.answer(query)


@command(
    _sources,
    options.kinds,
    options.incident_options,
    options.max_rows,
    _many,
    epilog=options.EPILOG,
)
def incidents(request: QueryRequest, wanted: IncidentOptions) -> None:
    """Print the incidents: collisions, hard braking, long stops, and with --kinds others.

    Only stops of vehicles and walkers are incidents. The page of 'report' also lists near misses and, where the map is
    known, broken rules of the road, as --kinds all does. The duration of a collision is that of the contact: 0 if one frame
    has it.
    """
    if wanted.kinds is None and request.form is None and sys.stdout.isatty():
        note("collisions, hard braking and long stops; --kinds all also finds near misses and broken rules")
    request.answer(partial(_incidents, options=wanted))


def _incidents(source: Reader, options: IncidentOptions) -> Incidents:
    """Return incidents; if there are none of the default kinds, warn of contacts that are not recorded as collisions."""
    from carla_recap.queries.incidents import incidents as query
    from carla_recap.queries.incidents import unrecorded_contacts

    found = query(source, options)
    if options.kinds is None and not found and (count := unrecorded_contacts(source, options)):
        text = f"{counted(count, 'contact')} without a collision record, see --kinds near-miss"
        warnings.warn(f"{source.location}: {text}", RecapWarning, stacklevel=2)
    return found


@command(
    _sources,
    option(
        "--actor",
        "actors",
        type=MEASURED,
        multiple=True,
        metavar="ID|hero|all",
        help="The actor to measure, may be repeated; else the hero, or if there is none, all vehicles.",
    ),
    flag("--over-time", help="Print the measures in each frame instead of their extremes."),
    option(
        "--pair",
        type=FOLLOW,
        nargs=2,
        metavar="A B",
        help="Two actors, each measured over time as if the other were the only one.",
    ),
    options.csv,
    options.road_map,
    _many,
    epilog=options.EPILOG,
)
def measures(
    request: QueryRequest,
    actors: tuple[int | Literal["hero", "all"], ...],
    over_time: bool,
    pair: tuple[ActorName, ActorName] | None,
    road_map: str | None,
) -> None:
    """Print how close others came, how hard and how fast an actor drives.

    These are the extreme values of its measures, such as the least time to collision, and when they occur; with --over-time
    or --pair, the values in each frame.
    """
    from carla_recap.queries.measures import measures_on_roads as query

    words = [actor for actor in actors if isinstance(actor, str)]
    if words and len(actors) > 1:
        raise click.BadParameter("hero and all go with no other actor.", param_hint="'--actor'")
    ids = [actor for actor in actors if isinstance(actor, int)]
    if over_time or pair:
        if pair and actors:
            raise click.UsageError("--pair and --actor say the same in two ways.")
        if road_map is not None:
            raise click.UsageError("--map is about the extremes: it does not go with --over-time or --pair.")
        from carla_recap.queries.measures import measures_over_time

        request.answer(partial(measures_over_time, actors=words[0] if words else ids or None, pair=pair))
    request.answer(partial(query, actors=words[0] if words else ids or None, road_map=road_map))
