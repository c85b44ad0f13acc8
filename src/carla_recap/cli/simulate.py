"""The command that makes recordings: traffic in a town, without a simulator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from carla_recap.cli import options
from carla_recap.cli.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.world import World


@click.command()
@options.destination
@click.option("--town", default="", metavar="NAME", help="A map's name or an .xodr; else the built-in town.")
@click.option("--vehicles", type=click.IntRange(0, 1000), default=30, show_default=True, metavar="N", help="On autopilot.")
@click.option("--walkers", type=click.IntRange(0, 1000), default=10, show_default=True, metavar="N", help="Who stroll.")
@click.option("--duration", type=options.NUMBER, default=60, show_default=True, metavar="S", help="How long, in s.")
@click.option("--hero", is_flag=True, help="The first vehicle is the hero, with a collision sensor.")
@click.option("--crash", is_flag=True, help="Stage one: the hero hits a walker, then a van that blocks its lane.")
@click.option("--seed", type=int, default=0, show_default=True, metavar="K", help="The same seed makes the same recording.")
@click.option("--additional-data", is_flag=True, help="Record velocities, boxes, physics and times, too.")
@options.force
def record(
    destination: str,
    town: str,
    vehicles: int,
    walkers: int,
    duration: float,
    hero: bool,
    crash: bool,
    seed: int,
    additional_data: bool,
    force: bool,
) -> None:
    """Record simulated traffic, to .mcap or .log."""
    from carla_recap.cli.progress import watch_ticks
    from carla_recap.conversion import check_free
    from carla_recap.errors import MissingExtra

    check_free(destination, force=force)
    try:
        from carla_recap.sim import World, load_town
        from carla_recap.sim.staging import Crash
        from carla_recap.sim.traffic import populate
    except ImportError:
        raise MissingExtra("the simulator", "sim") from None
    with World(load_town(town), seed=seed) as world:
        if crash:
            Crash(world)
        populate(world, vehicles, walkers, hero=hero and not crash)
        world.start_recorder(Path(destination).absolute(), additional_data)
        for _ in watch_ticks("simulating", duration)(_ticks(world, duration)):
            pass
        world.stop_recorder()
    say(f"{destination}: {world.frame} frames, {world.elapsed:g} s")


def _ticks(world: World, seconds: float) -> Iterator[float]:
    while world.elapsed < seconds:
        world.tick()
        yield world.elapsed


COMMANDS = (record,)
