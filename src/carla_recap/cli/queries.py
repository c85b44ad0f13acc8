"""The commands that print what a recording contains."""

from __future__ import annotations

from typing import Literal

import click

from carla_recap.cli import options
from carla_recap.cli.output import show

_report = options.together(options.recording, options.json, options.text, options.compat)


@click.command()
@_report
@click.option("--all", "everything", is_flag=True, help="Every record of every frame, not only the events.")
def info(file: str, everything: bool, form: str | None, compat: bool) -> None:
    """Print the contents: spawns, collisions and other events."""
    from carla_recap.queries.info import info as query

    show(query(options.opened(file), all=everything, compat=compat), form)


@click.command()
@_report
@click.option(
    "--types",
    default="aa",
    show_default=True,
    metavar="AB",
    help="The two sides: h hero, v vehicle, w walker, t traffic light, o other, a any.",
)
@options.max_rows
def collisions(file: str, types: str, form: str | None, compat: bool, max_rows: int | None) -> None:
    """Print the collisions."""
    from carla_recap.queries.collisions import collisions as query

    if len(types) != 2:
        raise click.BadParameter(f"{types!r} is not two of the letters h, v, w, t, o, a, such as hv.", param_hint="--types")
    show(query(options.opened(file), *types, compat=compat), form, max_rows)


@click.command()
@_report
@click.option(
    "--min-time", type=options.TIME, default=30, show_default=True, metavar="S", help="Shortest stop to report, in s."
)
@options.min_distance
@options.max_rows
def blocked(file: str, min_time: float, min_distance: float, form: str | None, compat: bool, max_rows: int | None) -> None:
    """Print the actors that stood still for long."""
    from carla_recap.queries.blocked import blocked as query

    if min_time < 0 and not compat:  # which CARLA accepts
        raise click.BadParameter(f"'{min_time:g}' is not a number of 0 or more.", param_hint="'--min-time'")
    show(query(options.opened(file), min_time, min_distance, compat=compat), form, max_rows)


@click.command()
@options.recording
@options.json
@options.text
def actors(file: str, form: str | None) -> None:
    """Print the actors, and when they existed."""
    from carla_recap.queries.actors import actors as query

    show(query(options.opened(file)), form)


@click.command()
@options.recording
@options.json
@options.text
@options.min_time
@options.min_distance
@options.deceleration
@options.max_rows
def incidents(
    file: str, form: str | None, min_time: float, min_distance: float, deceleration: float, max_rows: int | None
) -> None:
    """Print the incidents: collisions, hard braking, long stops.

    Only stops of vehicles and walkers are incidents.
    """
    from carla_recap.queries.incidents import incidents as query

    reader = options.opened(file)
    show(query(reader, min_time=min_time, min_distance=min_distance, deceleration=deceleration), form, max_rows)


@click.command()
@options.recording
@options.json
@options.text
@click.option(
    "--actor",
    "actors",
    type=options.MEASURED,
    multiple=True,
    metavar="ID|hero|all",
    help="The actor to measure, may be repeated; else the hero, or if there is none, all vehicles.",
)
def measures(file: str, form: str | None, actors: tuple[int | Literal["hero", "all"], ...]) -> None:
    """Print how close others came, how hard and how fast an actor drives.

    These are the extreme values of its measures, such as the least time to collision, and when they occur.
    """
    from carla_recap.queries.measures import measures as query

    words = [actor for actor in actors if isinstance(actor, str)]
    if words and len(actors) > 1:
        raise click.BadParameter("hero and all go with no other actor.", param_hint="'--actor'")
    ids = [actor for actor in actors if isinstance(actor, int)]
    show(query(options.opened(file), words[0] if words else ids or None), form)
