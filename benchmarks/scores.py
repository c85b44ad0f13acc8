"""The score of a drive along a route, as CARLA's Leaderboard scores it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.hour import DIRECTORY
from benchmarks.measuring import Line, Subject, cpu_time, run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SECONDS: Final = 300
ACTORS: Final = 100
SPACING: Final = 400  # frames between two positions of the route
GOAL: Final = 1.0  # s
MEMORY: Final = 200e6  # bytes


def scores(subject: Subject) -> Iterator[Line]:
    """A drive on autopilot among background traffic, by a route along its way; the processor time of the command."""
    from sys import executable

    for suffix in (".log", ".mcap"):
        recording, route = drive(suffix)
        command = (executable, "-m", "carla_recap", "score", recording, "--route", route, "--json")
        peak = run(*command).peak
        seconds = min(cpu_time(lambda command=command: run(*command)) for _ in range(3))
        what = f"score of {SECONDS} s with {ACTORS} actors, {suffix}"
        yield Line(what, f"{seconds:.2f} s", "", f"≤ {GOAL:.0f} s", seconds <= GOAL)
        yield Line(f"{what}, peak memory", f"{peak / 1e6:.0f} MB", "", f"≤ {MEMORY / 1e6:.0f} MB", peak <= MEMORY)


def drive(suffix: str) -> tuple[Path, Path]:
    """Return a recording of the drive, and the route file; both are made if they are missing."""
    import carla_recap

    log, route = DIRECTORY / "scored.log", DIRECTORY / "scored.xml"
    if not (log.exists() and route.exists()):
        _simulate(log)
        with carla_recap.open_recording(log) as recording:
            way = recording.trajectory("hero", axes="carla")
        rows = np.arange(0, len(way.time), SPACING)
        positions = "".join(f'<position x="{way.x[row]:.1f}" y="{way.y[row]:.1f}" z="0.0"/>' for row in rows.tolist())
        route.write_text(f'<routes><route id="0" town="Brickfield"><waypoints>{positions}</waypoints></route></routes>')
    if suffix == log.suffix:
        return log, route
    mcap = log.with_suffix(suffix)
    carla_recap.convert(log, mcap, force=True)
    return mcap, route


def _simulate(path: Path) -> None:
    from carla_recap.model.records import ActorKind
    from carla_recap.sim import World

    with World(seed=3) as world:
        models = world.blueprints.traffic(ActorKind.VEHICLE)
        places = [world.town.spawn_points[index] for index in world.random.permutation(len(world.town.spawn_points))]
        count = 0
        for place in places:
            role = "background" if count else "hero"
            vehicle = world.try_spawn(models[count % len(models)], place.copy(), role_name=role)
            if vehicle is not None and count < ACTORS:
                vehicle.set_autopilot()
                count += 1
            elif vehicle is not None:
                vehicle.destroy()
        if count < ACTORS:
            raise ValueError(f"the town has room for {count} vehicles, {ACTORS} were expected")
        world.start_recorder(path)
        for _ in range(round(SECONDS / world.delta)):
            world.tick()
        world.stop_recorder()


ROWS: Final = (scores,)
