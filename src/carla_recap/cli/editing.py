"""The commands that make recordings of recordings: convert, recover, cut."""

from __future__ import annotations

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
