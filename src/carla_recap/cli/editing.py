"""The commands that make recordings of recordings: convert, recover, cut."""

from __future__ import annotations

from typing import Any

import click

from carla_recap.cli import options
from carla_recap.cli.output import say

_copy = options.together(options.source, options.destination, options.force)


@click.command()
@_copy
def convert(source: str, destination: str, force: bool) -> None:
    """Write a recording in another format; DST's suffix says which.

    .log to .mcap and back gives the same bytes.
    """
    from carla_recap.cli.progress import watch
    from carla_recap.editing.convert import convert as run

    extent = run(source, destination, force=force, progress=watch("converting"))
    say(f"{destination}: {extent.frames} frames, {extent.duration:g} s")


@click.command()
@_copy
def recover(source: str, destination: str, force: bool) -> None:
    """Save what is intact in a recording that is damaged, or was never finished."""
    from carla_recap.cli.progress import watch
    from carla_recap.editing.recover import recover as run

    result = run(source, destination, force=force, progress=watch("recovering"))
    say(f"{destination}: {result}")


@click.command()
@_copy
@options.start
@options.duration
def clip(source: str, destination: str, force: bool, start: float, duration: float) -> None:
    """Cut a part out of a recording.

    DST is a recording of its own; its suffix says the format.
    """
    from carla_recap.cli.progress import watch
    from carla_recap.editing.clip import clip as run

    extent = run(source, destination, start=start, duration=duration, force=force, progress=watch("cutting"))
    say(f"{destination}: {extent.frames} frames, {extent.duration:g} s")


@click.command()
@options.source
@options.folder
@options.force
@click.option("--collisions", is_flag=True, help="Of collisions; without any of these three, of all incidents.")
@click.option("--blocked", is_flag=True, help="Of long stops of vehicles and walkers.")
@click.option("--braking", is_flag=True, help="Of vehicles that braked hard.")
@options.before
@options.after
@click.option(
    "--format", "suffix", type=click.Choice(["mcap", "log"]), default="mcap", show_default=True, help="Of the clips."
)
@click.option("--rrd/--no-rrd", default=None, help="Write an .rrd beside each clip; by default if Rerun is installed.")
@options.min_time
@options.min_distance
@options.deceleration
@options.road_map
@click.option(
    "--limit", type=click.IntRange(min=1), default=100, show_default=True, metavar="N", help="The largest number of clips."
)
def clips(
    source: str,
    folder: str,
    collisions: bool,
    blocked: bool,
    braking: bool,
    suffix: str,
    rrd: bool | None,
    road_map: str | None,
    **which: Any,
) -> None:
    """Cut a clip of each incident, into a folder."""
    from carla_recap.cli.progress import watch_incidents
    from carla_recap.export.clips import clips as run
    from carla_recap.recording import open_recording

    every = not (collisions or blocked or braking)
    with open_recording(source) as recording:
        roads = options.road_map_of(recording, road_map) if rrd is not False else None
    written = run(
        source,
        folder,
        collisions=collisions or every,
        blocked=blocked or every,
        braking=braking or every,
        suffix=f".{suffix}",
        rerun=rrd,
        road_map=roads,
        progress=watch_incidents("cutting"),
        **which,
    )
    for each in written:
        say(f"{each.recording}: {each.incident.text}")
    if not written:
        say(f"{folder}: no incidents, no clips")
