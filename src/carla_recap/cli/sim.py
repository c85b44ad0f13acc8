"""The commands that simulate: record traffic in a town, or continue a recording there."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from carla_recap.cli import options
from carla_recap.cli.options import NUMBER, POSITIVE, command, flag, option
from carla_recap.cli.output import BAD_INPUT, log_to_stderr, wrote
from carla_recap.cli.progress import watch_ticks

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.world import World

_ROUNDING = 1e-6  # of a tick


def _not_empty(context: click.Context, option: click.Parameter, value: str | None) -> str | None:
    if value == "":
        raise click.BadParameter("expected the name of a map or an .xodr, found an empty text.", context, option)
    return value


def _town(otherwise: str) -> Any:
    """Return the option for the town."""
    words = f"A map's name or an .xodr; else {otherwise}."
    return option("--town", callback=_not_empty, metavar="NAME", help=words)


def _count(name: str, default: int, help: str) -> Any:
    """Return the option for a number of actors."""
    return option(name, type=click.IntRange(0, 1000), default=default, metavar="N", help=help)


@command(options.written)
def record(
    destination: str = options.destination,
    town: str | None = _town("the built-in town"),
    vehicles: int = _count("--vehicles", 30, "On autopilot."),
    walkers: int = _count("--walkers", 10, "On foot."),
    duration: float = option("--duration", type=POSITIVE, default=60, metavar="S", help="How long, in s."),
    hero: bool = flag("--hero", help="The first vehicle is the hero, with a collision sensor."),
    junction: bool = flag("--junction", help="All begin around the town's largest junction with traffic lights."),
    crash: bool = flag("--crash", help="Add a crash: the hero hits a walker, then a van that blocks its lane."),
    blocked: bool = flag("--blocked", help="Add a breakdown: a van stops; the hero and others queue behind it."),
    seed: int | None = option(
        "--seed",
        type=click.IntRange(min=0),
        metavar="K",
        help="The same seed, the same bytes, dated 2026-01-01 10:00 UTC or $SOURCE_DATE_EPOCH; else seed 0, dated now.",
    ),
    additional_data: bool = options.additional_data,
    force: bool = options.force,
) -> None:
    """Record simulated traffic, to .mcap or .log."""
    from carla_recap.editing.convert import check_new

    if crash and blocked:
        raise click.UsageError("--crash and --blocked are two scenes; one recording has one of them.")
    check_new(destination, force=force)
    with _world(town, seed) as world:
        from carla_recap.sim import scenarios
        from carla_recap.sim.traffic.spawning import populate

        if crash:
            scenarios.Crash(world)
        if blocked:
            scenarios.Blockage(world)
        around = scenarios.largest_junction(world.town) if junction else None
        populate(world, vehicles, walkers, hero=hero and not (crash or blocked), around=around)
        with _recording(world, destination, additional_data=additional_data, force=force):
            _watch("simulating", duration, _ticks(world, duration))


@command(options.written)
def replay(
    source: str = options.source,
    destination: str = options.destination,
    town: str | None = _town("that of the recording"),
    start: float | None = options.start,
    duration: float | None = options.duration,
    then: float = option("--then", type=NUMBER, default=10, metavar="S", help="How long to go on by autopilot, in s."),
    ignore_hero: bool = flag("--ignore-hero", help="Leave the hero out."),
    additional_data: bool = options.additional_data,
    force: bool = options.force,
) -> None:
    """Replay a recording in the simulated town, hand its actors to the autopilot, and record everything.

    End the replay before a crash to see whether the autopilot avoids it.
    """
    from carla_recap.editing.convert import check_destination, check_new
    from carla_recap.errors import RecapError
    from carla_recap.formats.sources import is_remote
    from carla_recap.sim.replaying.replayer import find_recording

    check_new(destination, force=True)
    if is_remote(source):
        raise RecapError(f"{source}: is remote; the path of a file to replay was expected, which carla-recap convert writes")
    path = find_recording(Path(source).absolute())
    check_destination(path, destination, force=force)
    with _world(town) as world:
        world.replayer.ignore_hero = ignore_hero
        played = world.replay_file(path, start or 0.0, duration or 0.0, keep_town=town is not None)
        with _recording(world, destination, additional_data=additional_data, force=force) as notes:
            _watch("replaying", played.duration, _replayed(world))
            # the last tick is the first one after the replay
            notes.append(f"by autopilot from frame {world.recorder.frames} on")
            _watch("simulating", then, _ticks(world, then))


def _world(town: str | None, seed: int | None = None) -> World:
    """Return a town without actors; with a seed, the date of its recordings is fixed, too."""
    from carla_recap.sim import World
    from carla_recap.sim.settings import seeded_date

    log_to_stderr()
    return World(town, seed=seed or 0, date=None if seed is None else seeded_date())


@contextmanager
def _recording(world: World, destination: str, *, additional_data: bool, force: bool) -> Iterator[list[str]]:
    """Record a block, and print what was recorded, also when a signal ends it; fail if recording ended before.

    Yields:
        What else to print; the block may add to it.
    """
    from carla_recap.util.files import make_folder

    notes: list[str] = []
    make_folder(Path(destination).parent)
    world.start_recorder(Path(destination).absolute(), additional_data, force=force)
    try:
        yield notes
    finally:
        world.stop_recorder()
        if world.recorder.error is None:
            wrote(destination, *notes, frames=world.recorder.frames, seconds=world.recorder.duration)
        elif sys.exc_info()[0] is None:  # which was a warning
            click.get_current_context().exit(BAD_INPUT)


def _watch(what: str, seconds: float, ticks: Iterator[float]) -> None:
    """Run a simulation, with a progress bar."""
    for _ in watch_ticks(what, seconds)(ticks):
        pass


def _ticks(world: World, seconds: float) -> Iterator[float]:
    count = 0
    while count < seconds / world.delta - _ROUNDING and world.recorder.path:
        world.tick()
        count += 1
        yield count * world.delta


def _replayed(world: World) -> Iterator[float]:
    """Tick until the end of the replay."""
    begin = world.elapsed
    while world.replayer.is_playing and world.recorder.path:
        world.tick()
        yield world.elapsed - begin
