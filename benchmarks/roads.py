"""The roads of a map: points in relation to lanes, what vehicles do on them in an hour, and that traffic breaks no rule."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.hour import DIRECTORY
from benchmarks.measuring import Line, Subject, cpu_time

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.queries.measures.road import RoadEvent
    from carla_recap.roads.network import RoadNetwork

POINTS: Final = 1_000_000
MINUTES: Final = 10
VEHICLES: Final = 60


def lanes(subject: Subject) -> Iterator[Line]:
    """Points as of vehicles: in lanes and beside their middle."""
    roads = town()
    rng = np.random.default_rng(1)
    pieces = roads.pieces[rng.integers(len(roads.pieces), size=POINTS)]
    share = rng.uniform(size=POINTS)
    points = np.stack([pieces[f"{axis}0"] + share * (pieces[f"{axis}1"] - pieces[f"{axis}0"]) for axis in "xyz"], axis=1)
    points[:, :2] += rng.normal(0.0, 0.7, (POINTS, 2))
    headings = rng.uniform(-np.pi, np.pi, POINTS)
    roads.lanes_at(points[:10])
    seconds = cpu_time(lambda: roads.lanes_at(points, headings))
    yield Line(
        "lanes of a million points", f"{seconds:.2f} s", f"{seconds / POINTS * 1e6:.1f} µs each", "≤ 2 s", seconds <= 2
    )


def rules(subject: Subject) -> Iterator[Line]:
    """What vehicles do in relation to the road in the hour, whose vehicles drive across the roads of the built-in town."""
    network = town()
    network.lanes_at(np.zeros((1, 2)))
    seconds = cpu_time(lambda: found(subject.mcap, network))
    goal = max(15 * subject.seconds / 3600, 1.0)
    each = seconds / subject.frames * 1e6
    yield Line(
        f"rules of the road, {subject.length}",
        f"{seconds:.1f} s",
        f"{each:.0f} µs a frame",
        f"≤ {goal:.0f} s",
        seconds <= goal,
    )


def law_abiding(subject: Subject) -> Iterator[Line]:
    """Ten minutes of traffic on autopilot."""
    from carla_recap.sim import World
    from carla_recap.sim.traffic.spawning import populate

    world = World(seed=1)
    populate(world, VEHICLES, 0)
    path = world.start_recorder(DIRECTORY / "law-abiding.mcap")
    for _ in range(round(60 * MINUTES / world.delta)):
        world.tick()
    world.stop_recorder()
    count = len(found(path, town()))
    what = f"broken rules, {VEHICLES} vehicles, {MINUTES} min"
    yield Line(what, str(count), "", "0", count == 0)


def town() -> RoadNetwork:
    """Return the roads of the built-in town."""
    from carla_recap.roads import find_road_network

    roads = find_road_network("Brickfield")
    assert roads is not None
    return roads


def found(path: Path, roads: RoadNetwork) -> list[RoadEvent]:
    """Return the rules that vehicles break in a recording."""
    from carla_recap.formats import open_reader
    from carla_recap.queries.measures.road import TYPES, RoadSearch
    from carla_recap.queries.recorded_actors import actors

    reader = open_reader(path)
    try:
        search = RoadSearch(reader, roads, actors(reader))
        for batch in reader.batches(TYPES):
            search.add(batch)
        return search.finish()
    finally:
        reader.close()


ROWS: Final = (lanes, rules, law_abiding)
