"""The command that compares two recordings."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from carla_recap.cli import opening, options
from carla_recap.cli.options import NUMBER, argument, command, option
from carla_recap.cli.output import counted, emit, end, wrote
from carla_recap.cli.progress import watch

if TYPE_CHECKING:
    from carla_recap.queries.differences import Differences
    from carla_recap.recording import Recording


@command()
def diff(
    first: str = argument("first", "A"),
    second: str = argument("second", "B"),
    tolerance: float = option("--tolerance", type=NUMBER, default=0, metavar="M", help="The distance that is equal, in m."),
    time_tolerance: float | None = option(
        "--time-tolerance",
        type=NUMBER,
        metavar="S",
        help="The time that is equal, of spawns, lights and events, in s; 0, or 1 with a tolerance.",
    ),
    events: bool = option(
        "--events/--no-events", default=True, show_default=False, help="Compare incidents, too; by default it does."
    ),
    rrd: str | None = options.path("--rrd", metavar="OUT.rrd", help="Write A for Rerun, with B as a ghost."),
    html: str | None = options.path("--html", metavar="OUT.html", help="Write a page of A, with B as a ghost."),
    road_map: str | None = options.road_map,
    force: bool = options.force,
    form: str | None = options.json_or_text,
) -> NoReturn:
    """Compare two recordings of a scenario.

    Data of sensors are not compared. The exit code is 0 if they are equal within the tolerance, 1 if they differ, 2 if one
    cannot be read.
    """
    from carla_recap.editing.convert import check_destination
    from carla_recap.output import differences as output
    from carla_recap.recording import open_recording

    for path in filter(None, (rrd, html)):
        if Path(path).is_file():  # a folder is a page, too
            for source in (first, second):
                check_destination(source, path, force=force)
    with ExitStack() as stack:
        a, b = (stack.enter_context(open_recording(path)) for path in (first, second))
        found = a.diff(b, tolerance=tolerance, time_tolerance=time_tolerance, events=events)
        emit(form, **{each: partial(getattr(output, each), found) for each in ("text", "table", "json")})
        if rrd:
            _write_rrd(a, b, rrd, road_map, force=force)
        if html:
            _write_page(a, b, found, html, road_map, force=force)
    end(unmet=not found.equal)


def _write_rrd(a: Recording, b: Recording, path: str, road_map: str | None, *, force: bool) -> None:
    from carla_recap.show.rerun.export import export_rerun

    roads = opening.road_map_of(a, road_map)
    played = export_rerun(a, path, ghost=b, road_map=roads, force=force, progress=watch("exporting"))
    wrote(path, frames=played.frames, seconds=played.seconds)


def _write_page(a: Recording, b: Recording, found: Differences, path: str, road_map: str | None, *, force: bool) -> None:
    from carla_recap.show.page import write_report

    progress, town = watch("sampling"), opening.town_of(a, road_map)
    written = write_report(a, path, other=b, differences=found, town=town, force=force, progress=progress)
    wrote(path, counted(written.incidents, "incident"), size=written.size, incidents=written.incidents)
