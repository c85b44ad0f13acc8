"""The commands that make recordings of recordings and of tracks: convert, recover, cut, import."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import click

from carla_recap.cli import opening, options
from carla_recap.cli.options import DATE, argument, command, option
from carla_recap.cli.output import wrote
from carla_recap.cli.progress import watch
from carla_recap.cli.writing import WriteRequest, writes
from carla_recap.fleet.outcomes import WrittenFile

_FACTS: Final = ("lost_frames", "lost_packets", "lost_bytes", "finished", "headless", "without_events")
"""What JSON has of a recovery."""
_format = options.format_of_files(["mcap", "log"])


@command(
    writes,
    _format,
)
def convert(request: WriteRequest, suffix: str | None) -> None:
    """Write recordings in another format: one to a file, whose suffix says which; many to a folder.

    .log to .mcap and back gives the same bytes. A .mcap keeps the data of sensors, which a .log cannot hold.
    """
    request.write(_convert, suffix, "mcap", "converting")


@command(
    writes,
    _format,
)
def recover(request: WriteRequest, suffix: str | None) -> None:
    """Save what is intact in recordings that are damaged, or were never finished."""
    request.write(_recover, suffix, "mcap", "recovering")


@command(
    writes,
    _format,
    options.start,
    options.duration,
)
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
    facts = {name: getattr(result, name) for name in _FACTS}
    return WrittenFile(tuple(result.losses or ["nothing lost"]), result.frames, result.duration, facts=facts)


def _clip(given: dict[str, Any], source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.editing.clip import clip as run

    source, given = opening.timed(source, given)
    extent = run(source, destination, force=force, progress=watch("cutting"), **given)
    return WrittenFile(frames=extent.frames, seconds=extent.duration)


@command(
    argument("source", "CSV"),
    options.destination,
    click.option("--map-name", default="", metavar="NAME", help="The name of the map, such as Town01."),
    option("--date", type=DATE, help="The beginning, such as 2024-05-01T12:30; else Unix times of the file, or 1970."),
    option("--hero", metavar="ID", help="The object with the role name hero."),
    option(
        "--column",
        "columns",
        multiple=True,
        metavar="NAME=COLUMN",
        help="The name that a column has in the file, such as x=east; may be repeated.",
    ),
    option("--time-unit", type=click.Choice(["s", "ms", "us", "ns"]), help="Else s; of a column total_nanos, ns."),
    option("--length-unit", type=click.Choice(["m", "cm", "ft"]), default="m"),
    option("--rate", type=float, metavar="HZ", help="The frames of a second, if times are numbers of frames."),
    option(
        "--position",
        type=click.Choice(["center", "corner", "front"]),
        default="center",
        help="What x and y are of a box; with corner, width and height are its extents along x and y (highD).",
    ),
    option("--angle-unit", type=click.Choice(["deg", "rad"]), default="deg"),
    option(
        "--axes",
        type=click.Choice(["right-handed", "carla"]),
        default="right-handed",
        help="Right-handed: y to the left, a positive yaw turns left; carla: y to the right.",
    ),
    options.force,
    options.written,
    name="import",
)
def import_(source: str, destination: str, columns: tuple[str, ...], **given: Any) -> None:
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
