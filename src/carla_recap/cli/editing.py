"""The commands that make recordings of recordings and of tracks: convert, recover, cut, import."""

from __future__ import annotations

from functools import partial
from typing import Any

import click

from carla_recap.cli import opening, options
from carla_recap.cli.output import wrote
from carla_recap.cli.parameter_types import DATE
from carla_recap.cli.progress import watch
from carla_recap.cli.writing import WriteRequest, writes
from carla_recap.fleet.outcomes import WrittenFile

_format = click.option(
    "--to",
    "--format",
    "suffix",
    type=click.Choice(["mcap", "log"]),
    help="The format of files in a folder, by default mcap; a single file has the one of its suffix.",
)


@click.command()
@writes
@_format
def convert(request: WriteRequest, suffix: str | None) -> None:
    """Write recordings in another format: one to a file, whose suffix says which; many to a folder.

    .log to .mcap and back gives the same bytes. A .mcap keeps the data of sensors, which a .log cannot hold.
    """
    request.write(_convert, suffix, "mcap", "converting")


@click.command()
@writes
@_format
def recover(request: WriteRequest, suffix: str | None) -> None:
    """Save what is intact in recordings that are damaged, or were never finished."""
    request.write(_recover, suffix, "mcap", "recovering")


@click.command()
@writes
@_format
@options.start
@options.duration
def clip(request: WriteRequest, suffix: str | None, **given: Any) -> None:
    """Cut a part out of recordings.

    What is cut is a recording of its own. SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    request.write(partial(_clip, given), suffix, "mcap", "cutting")


def _convert(source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.editing.convert import convert as run

    extent = run(source, destination, force=force, progress=watch("converting"))
    return WrittenFile(frames=extent.frames, seconds=extent.duration)


def _recover(source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.editing.recover import recover as run

    result = run(source, destination, force=force, progress=watch("recovering"))
    lost = {"lost_frames": result.lost_frames, "lost_packets": result.lost_packets, "lost_bytes": result.lost_bytes}
    notes, facts = (
        tuple(result.losses or ["nothing lost"]),
        {
            **lost,
            "finished": result.finished,
            "headless": result.headless,
            "without_events": result.without_events,
        },
    )
    return WrittenFile(notes, result.frames, result.duration, facts=facts)


def _clip(given: dict[str, Any], source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.editing.clip import clip as run

    source, given = opening.timed(source, given)
    extent = run(source, destination, force=force, progress=watch("cutting"), **given)
    return WrittenFile(frames=extent.frames, seconds=extent.duration)


@click.command(name="import")
@click.argument("source", type=click.Path(), metavar="CSV")
@options.destination
@click.option("--map-name", default="", metavar="NAME", help="The name of the map, such as Town01.")
@click.option("--date", type=DATE, help="The beginning, such as 2024-05-01T12:30; else Unix times of the file, or 1970.")
@click.option("--hero", metavar="ID", help="The object with the role name hero.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME=COLUMN",
    help="The name that a column has in the file, such as x=east; may be repeated.",
)
@click.option("--time-unit", type=click.Choice(["s", "ms", "us", "ns"]), help="Else s; of a column total_nanos, ns.")
@click.option("--length-unit", type=click.Choice(["m", "cm", "ft"]), default="m", show_default=True)
@click.option("--rate", type=float, metavar="HZ", help="The frames of a second, if times are numbers of frames.")
@click.option(
    "--position",
    type=click.Choice(["center", "corner", "front"]),
    default="center",
    show_default=True,
    help="What x and y are of a box; with corner, width and height are its extents along x and y (highD).",
)
@click.option("--angle-unit", type=click.Choice(["deg", "rad"]), default="deg", show_default=True)
@click.option(
    "--axes",
    type=click.Choice(["right-handed", "carla"]),
    default="right-handed",
    show_default=True,
    help="Right-handed: y to the left, a positive yaw turns left; carla: y to the right.",
)
@options.force
@options.written
def import_(
    source: str,
    destination: str,
    columns: tuple[str, ...],
    **given: Any,
) -> None:
    """Make a recording of tracks: a CSV file with a row for each object at each time.

    Its columns are found by their names: time, id, x and y; and, if it has them, z, roll, pitch, yaw, vx, vy, vz, length,
    width, height, kind, type_id, role_name. DST's suffix says the format.
    """
    from carla_recap.editing.import_tracks import import_tracks

    names = {}
    for column in columns:
        name, separator, in_file = column.partition("=")
        if not (name and separator and in_file):
            raise click.BadParameter(f"{column!r} is no NAME=COLUMN, such as x=east.", param_hint="--column")
        names[name] = in_file
    extent = import_tracks(source, destination, columns=names, **given)
    wrote(destination, frames=extent.frames, seconds=extent.duration)
