"""The commands that make recordings: of traffic in a town, and of what becomes of a recording that is replayed there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from carla_recap.cli import options
from carla_recap.cli.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.world import World

_ROUNDING = 1e-6  # of a tick
_FAILED = 2  # the exit code for bad input

_seed = click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="K",
    help="The same seed, the same recording.",
)
_additional_data = click.option("--additional-data", is_flag=True, help="Record velocities, boxes, physics and times, too.")


@click.command()
@options.destination
@click.option("--town", default="", metavar="NAME", help="A map's name or an .xodr; else the built-in town.")
@click.option("--vehicles", type=click.IntRange(0, 1000), default=30, show_default=True, metavar="N", help="On autopilot.")
@click.option("--walkers", type=click.IntRange(0, 1000), default=10, show_default=True, metavar="N", help="Who stroll.")
@click.option("--duration", type=options.NUMBER, default=60, show_default=True, metavar="S", help="How long, in s.")
@click.option("--hero", is_flag=True, help="The first vehicle is the hero, with a collision sensor.")
@click.option("--junction", is_flag=True, help="All begin around the town's largest junction with traffic lights.")
@click.option(
    "--crash", "scene", flag_value="Crash", help="Stage one: the hero hits a walker, then a van that blocks its lane."
)
@click.option(
    "--blocked",
    "scene",
    flag_value="Blockage",
    help="Stage one: a van breaks down; the hero and others queue behind it.",
)
@_seed
@_additional_data
@options.force
def record(
    destination: str,
    town: str,
    vehicles: int,
    walkers: int,
    duration: float,
    hero: bool,
    junction: bool,
    scene: str | None,
    seed: int,
    additional_data: bool,
    force: bool,
) -> None:
    """Record simulated traffic, to .mcap or .log."""
    from carla_recap.conversion import check_free

    check_free(destination, force=force)
    with _world(town, seed) as world:
        from carla_recap.sim import staging
        from carla_recap.sim.traffic import populate

        if scene:
            getattr(staging, scene)(world)
        around = staging.largest_junction(world.town) if junction else None
        populate(world, vehicles, walkers, hero=hero and not scene, around=around)
        world.start_recorder(Path(destination).absolute(), additional_data)
        _watch("simulating", duration, _ticks(world, duration))
        _finish(world)
    say(f"{destination}: {world.frame} frames, {world.elapsed:g} s")


@click.command()
@options.source
@options.destination
@click.option("--town", default="", metavar="NAME", help="A map's name or an .xodr; else that of the recording.")
@options.start
@options.duration
@click.option(
    "--then", type=options.NUMBER, default=10, show_default=True, metavar="S", help="How long to go on by autopilot, in s."
)
@click.option("--ignore-hero", is_flag=True, help="Leave the hero out.")
@_additional_data
@options.force
def replay(
    source: str,
    destination: str,
    town: str,
    start: float,
    duration: float,
    then: float,
    ignore_hero: bool,
    additional_data: bool,
    force: bool,
) -> None:
    """Replay a recording in the simulated town, hand its actors to the autopilot, and record all of it.

    What would have become of it? End the replay before the crash, and see.
    """
    from carla_recap.conversion import check_free

    check_free(destination, force=force)
    with _world(town) as world:
        world.set_replayer_ignore_hero(ignore_hero)
        played = world.replay_file(Path(source).absolute(), start, duration)
        world.start_recorder(Path(destination).absolute(), additional_data)
        _watch("replaying", played.duration, _replayed(world))
        taken_over = world.frame  # the replay ends in the first tick that it does not tell of
        _watch("simulating", then, _ticks(world, then))
        _finish(world)
    say(f"{destination}: {world.frame} frames, {world.elapsed:g} s, by autopilot from frame {taken_over} on")


def _world(town: str, seed: int = 0) -> World:
    """A town in which nobody is.

    Raises:
        MissingExtra: There is no physics engine.
    """
    from carla_recap.sim import World, load_town

    return World(load_town(town), seed=seed)


def _watch(what: str, seconds: float, ticks: Iterator[float]) -> None:
    """Let time pass; a bar tells how far it is."""
    from carla_recap.cli.progress import watch_ticks

    for _ in watch_ticks(what, seconds)(ticks):
        pass


def _ticks(world: World, seconds: float) -> Iterator[float]:
    count = 0
    while count < seconds / world.delta - _ROUNDING and world.recorder.path:
        world.tick()
        count += 1
        yield count * world.delta


def _replayed(world: World) -> Iterator[float]:
    begin = world.elapsed
    while world.replayer.is_playing and world.recorder.path:
        world.tick()
        yield world.elapsed - begin


def _finish(world: World) -> None:
    """Complete the recording; the command fails if it has ended early, which a warning tells of."""
    world.stop_recorder()
    if world.recorder.error is not None:
        click.get_current_context().exit(_FAILED)


COMMANDS = (record, replay)
