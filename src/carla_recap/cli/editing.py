"""The commands that make recordings of recordings and of tracks: convert, recover, cut, import."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from carla_recap.cli import options
from carla_recap.cli.output import wrote

if TYPE_CHECKING:
    from carla_recap.editing.import_tracks import AngleUnit, LengthUnit, TimeUnit, TrackAxes

_copy = options.together(options.source, options.destination, options.force, options.written)


@click.command()
@_copy
def convert(source: str, destination: str, force: bool) -> None:
    """Write a recording in another format; DST's suffix says which.

    .log to .mcap and back gives the same bytes.
    """
    from carla_recap.cli.progress import watch
    from carla_recap.editing.convert import convert as run

    extent = run(source, destination, force=force, progress=watch("converting"))
    wrote(destination, frames=extent.frames, seconds=extent.duration)


@click.command()
@_copy
def recover(source: str, destination: str, force: bool) -> None:
    """Save what is intact in a recording that is damaged, or was never finished."""
    from carla_recap.cli.progress import watch
    from carla_recap.editing.recover import recover as run

    result = run(source, destination, force=force, progress=watch("recovering"))
    lost = {"lost_frames": result.lost_frames, "lost_packets": result.lost_packets, "lost_bytes": result.lost_bytes}
    words = result.losses or ["nothing lost"]
    wrote(destination, *words, frames=result.frames, seconds=result.duration, **lost, finished=result.finished)


@click.command()
@_copy
@options.start
@options.duration
def clip(source: str, destination: str, force: bool, start: float, duration: float) -> None:
    """Cut a part out of a recording.

    DST is a recording of its own; its suffix says the format. SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    from carla_recap.cli.progress import watch
    from carla_recap.editing.clip import clip as run

    source, start, duration = options.timed(source, start, duration)
    extent = run(source, destination, start=start, duration=duration, force=force, progress=watch("cutting"))
    wrote(destination, frames=extent.frames, seconds=extent.duration)


@click.command(name="import")
@click.argument("source", type=click.Path(), metavar="CSV")
@options.destination
@click.option("--map-name", default="", metavar="NAME", help="The name of the map, such as Town01.")
@click.option("--hero", metavar="ID", help="The object with the role name hero.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME=COLUMN",
    help="The name that a column has in the file, such as x=east; may be repeated.",
)
@click.option("--time-unit", type=click.Choice(["s", "ms", "us", "ns"]), help="Else s; of a column total_nanos, ns.")
@click.option("--length-unit", type=click.Choice(["m", "cm"]), default="m", show_default=True)
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
    map_name: str,
    hero: str | None,
    columns: tuple[str, ...],
    time_unit: TimeUnit | None,
    length_unit: LengthUnit,
    angle_unit: AngleUnit,
    axes: TrackAxes,
    force: bool,
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
    extent = import_tracks(
        source,
        destination,
        map_name=map_name,
        columns=names,
        time_unit=time_unit,
        length_unit=length_unit,
        angle_unit=angle_unit,
        axes=axes,
        hero=hero,
        force=force,
    )
    wrote(destination, frames=extent.frames, seconds=extent.duration)
