"""The simulator in one of CARLA's own towns, which is not part of this repository; without it, these rows have no lines."""

from __future__ import annotations

import re
import resource
import statistics
import sys
import time
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.core import broken_rules
from benchmarks.hour import DIRECTORY
from benchmarks.measuring import DATA, TOWN, Line, Subject, at_least, at_most, line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.world import World

WARM_UP: Final = 20.0  # s
BLOCK: Final = 96  # ticks that are timed together
ROUNDS: Final = 60  # of blocks with and without a recorder
PAUSE: Final = 0.05  # s of real time, in which the recorded ticks are written
COUNTS: Final = (50, 100, 200, 400)
DRIVES: Final = {
    "the Lincoln of 0.9.10": ("carla-0.9.10-lane-center", 259, 5.3, 99.0),
    "the Lincoln of 0.9.13": ("carla-0.9.13-lane-center", 234, 4.4, 99.0),
    "a Tesla at 0.5": ("town05-two-cars", 190, 0.0, 3.2),
    "a Tesla at 0.6": ("town05-two-cars", 192, 0.0, 3.2),
}
"""Recordings, actors, and where their drives begin and how long they take in s: without falls, pauses and collisions."""


def driving(_: Subject) -> Iterator[Line]:
    for world in crowded(100, 30):
        yield _rate("ticks, 100 vehicles, 30 walkers, recorded", world, 60.0, 300)


def parked(_: Subject) -> Iterator[Line]:
    for world in crowded(100, 0, drive=False):
        yield _rate("ticks, 100 parked vehicles, recorded", world, 250.0, 1_500)


def recorder(_: Subject) -> Iterator[Line]:
    """The time that recording adds to a tick: ticks with and without it alternate in one world."""
    for world in crowded(120, 30):
        record(world)
        recorded, bare = [], []
        for _ in range(ROUNDS):
            recorded.append(ticks(world))
            time.sleep(PAUSE)
            world.listeners.remove(world.recorder)
            bare.append(ticks(world))
            world.listeners.append(world.recorder)
        world.close()
        share = statistics.median(block / other - 1 for block, other in zip(recorded[1:], bare[1:], strict=True))
        tick = statistics.median(bare[1:]) / BLOCK
        measured = f"{share * tick * 1e6:.0f} µs of {tick * 1e3:.2f} ms"
        yield line("recorder of 150 actors, .mcap", measured, at_most(100 * share, "{:.1f} %", 5))


def scaling(_: Subject) -> Iterator[Line]:
    """The time of a tick by the number of vehicles."""
    for count in COUNTS:
        for world in crowded(count, 0):
            tick = min(ticks(world) for _ in range(10)) / BLOCK
            yield line(f"tick of {count} vehicles", f"{tick * 1e3:.2f} ms", f"{tick / count * 1e6:.1f} µs each")


def an_hour(_: Subject) -> Iterator[Line]:
    """The growth of memory in an hour of recording, after the first 10 minutes."""
    for world in crowded(10, 5):
        world.settings.fixed_delta_seconds = 0.1
        record(world)
        world.run(600.0)
        before = peak()
        world.run(3_000.0)
        grown = at_most((peak() - before) / 1e6, "{:+.1f} MB", 5)
        world.close()
        yield line("memory, recording for an hour", f"{before / 1e6:.0f} MB", grown)


def traffic(_: Subject) -> Iterator[Line]:
    """100 cars on autopilot for 10 minutes: collisions and stops."""
    for world in crowded(100, 0):
        world.settings.collisions_of = "all"
        pairs: set[frozenset[int | None]] = set()
        stopped = longest = np.zeros(len(world.vehicles))
        end = world.elapsed + 600.0
        while world.elapsed < end:
            world.tick()
            pairs |= {frozenset((collision.actor1, collision.actor2)) for collision in world.events.collisions}
            stopped = np.where(np.abs(world.vehicles.speed) < 0.1, stopped + world.delta, 0.0)
            longest = np.maximum(longest, stopped)
        yield line("100 cars, 10 min: pairs that collide", at_most(len(pairs), "{:.0f}", 5))
        yield line("100 cars, 10 min: longest stop", at_most(longest.max(), "{:.0f} s", 180))


def law_abiding(_: Subject) -> Iterator[Line]:
    """Ten minutes of traffic on autopilot in the built-in town."""
    from carla_recap import open_recording
    from carla_recap.sim import World
    from carla_recap.sim.traffic import populate

    world = World(seed=1)
    populate(world, 60, 0)
    path = world.start_recorder(DIRECTORY / "law-abiding.mcap")
    world.run(600.0)
    world.stop_recorder()
    with open_recording(path) as recording:
        yield line("broken rules, 60 vehicles, 10 min", at_most(len(broken_rules(recording)), "{:.0f}", 0))


def drives(_: Subject) -> Iterator[Line]:
    """Recorded drives of CARLA, whose throttle, brake and steering drive the simulator's vehicle again."""
    for drive, (name, actor, start, duration) in DRIVES.items():
        path = DATA / "carla-logs" / f"{name}.log"
        if path.exists():
            tool = drive_again_tool()
            *_, theirs, ours, _ = tool.drive_again(path, actor, start, duration)
            speed, place, heading = tool.off_by(theirs, ours)
            rms, after = float(np.sqrt(np.mean(speed**2))), tool.soon(theirs)
            good = bool(rms <= 0.5 and place[after] <= 1.0 and abs(heading[after]) <= 2.0)
            then = f"{place[after]:.2f} m, {abs(heading[after]):.1f}° off"
            what = f"{drive} driven again: speed, and place after 3 s"
            yield Line(what, f"{rms:.2f} m/s rms", then, "≤ 0.5 m/s, 1 m, 2°", good)


ROWS: Final = (driving, parked, recorder, scaling, an_hour, traffic, law_abiding, drives)


def drive_again_tool() -> ModuleType:
    """Return the module of `tools/drive-again`."""
    loader = SourceFileLoader("drive_again", str(Path(__file__).parents[1] / "tools" / "drive-again"))
    module = ModuleType(loader.name)
    sys.modules[loader.name] = module
    loader.exec_module(module)
    return module


def crowded(vehicles: int, walkers: int, *, drive: bool = True) -> Iterator[World]:
    """Yield a world with traffic that has driven for a while; none if the town is missing."""
    from carla_recap.sim.town.loading import load_town
    from carla_recap.sim.traffic import populate
    from carla_recap.sim.world import World

    if TOWN.exists():
        world = World(load_town(TOWN), seed=0, date=0)
        populate(world, vehicles, walkers)
        for vehicle in world.vehicles.actors:
            vehicle.set_autopilot(drive)
        world.run(WARM_UP)
        yield world


def record(world: World) -> None:
    DIRECTORY.mkdir(parents=True, exist_ok=True)
    world.start_recorder((DIRECTORY / "simulated.mcap").resolve())


def ticks(world: World) -> float:
    """Return the seconds of a block of ticks."""
    begin = time.perf_counter()
    for _ in range(BLOCK):
        world.tick()
    return time.perf_counter() - begin


def peak() -> int:
    """Return the peak memory of this process in bytes, on Linux together with that of the writer process."""
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    children = [id for task in Path("/proc/self/task").glob("*/children") for id in task.read_text().split()]
    statuses = [Path(f"/proc/{id}/status").read_text() for id in children]
    return own + sum(int(found[1]) * 1024 for status in statuses if (found := re.search(r"VmHWM:\s+(\d+) kB", status)))


def _rate(what: str, world: World, seconds: float, goal: int) -> Line:
    """Return the line of the recorded ticks a second, including the time to complete the recording."""
    record(world)
    first, begin = world.frame, time.perf_counter()
    world.run(seconds)
    world.close()
    rate = (world.frame - first) / (time.perf_counter() - begin)
    return line(what, at_least(rate, "{:,.0f} a second", goal), f"{rate * world.delta:,.0f} x real time")
