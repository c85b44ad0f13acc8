"""The differences of generated recordings, compared with those that a loop over frames and actors finds."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.model.frame import Header
from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.differences import differences
from carla_recap.queries.matching import match
from tests.replay.scripts import build
from tests.samples import reading
from tests.twins.differences import Drive, actor_differs, light, paths

TYPES = ("spawned", "destroyed", "transforms", "light_states")
ACTORS, LIVES = 3, 2
LIGHT = ACTORS

times = st.one_of(
    st.builds(
        lambda rate, count, start: [start + n / rate for n in range(count)],
        st.sampled_from([0.3, 1.0, 5.0, 10.0, 20.0, 100.0]) | st.floats(0.2, 200),
        st.integers(1, 12),
        st.just(0.0) | st.floats(-3, 3),
    ),
    st.lists(st.sampled_from([0, 1, 2, 3, 3.0000004, 4, 5, 5.0000015]) | st.floats(0, 8), min_size=1, max_size=12).map(
        sorted
    ),
)
numbers = st.sampled_from([0.0, 1.0, 100.0, 501.0, 10_000.0, math.nan, math.inf, -3e38]) | st.floats(-1000, 1000, width=32)
poses = st.tuples(numbers, numbers, st.just(0.0), st.floats(-720, 720, width=32) | numbers)
tolerances = st.sampled_from([0.0, 1e-6, 0.5, 1.0, 5.0, math.inf]) | st.floats(0, 1e4)


@st.composite
def drives(draw: Any, pose: Callable[[int, float], tuple[float, ...]]) -> list[tuple[float, dict[str, Any]]]:
    """Frames of three actors, which come and go, each with two lives, and of a traffic light."""
    clock = draw(times)
    frames: list[tuple[float, dict[str, Any]]] = []
    cuts = [sorted(draw(st.tuples(*[st.integers(0, len(clock))] * 4))) for _ in range(ACTORS)]
    aside = draw(st.sampled_from([0.0, 0.0, 30.0, 600.0]))
    change = draw(st.integers(0, len(clock)))
    for n, time in enumerate(clock):
        records: dict[str, list[Any]] = {name: [] for name in TYPES}
        if n == 0:
            records["spawned"].append(spawn(LIGHT, 0))
        for id, (start, stop, again, end) in enumerate(cuts):
            for life, (first, last) in enumerate(((start, stop), (again, end))):
                records["spawned"] += [spawn(id, life)] * (n == first)
                records["destroyed"] += [id] * (n == last and first < last)
                if first <= n < last and draw(st.integers(0, 5)):
                    x, y, z, yaw = draw(poses) if not draw(st.integers(0, 7)) else pose(id, time)
                    records["transforms"].append((id, x + aside * (n % 2), y, z, 0.0, 0.0, yaw))
        if draw(st.integers(0, 5)):
            records["light_states"].append((LIGHT, 0, 0.0, 2 if n < change else draw(st.integers(0, 2))))
        frames.append((time, records))
    return frames


def spawn(id: int, life: int) -> Spawn:
    kind, type_id = (3, "traffic.traffic_light") if id == LIGHT else (1, f"vehicle.{id}.{life}")
    return Spawn(id, kind, type_id=type_id, attributes=attributes(role_name=f"{id}.{life}"))


def along(id: int, time: float) -> tuple[float, ...]:
    return 1000.0 * time + id, 100.0 * id, 0.0, 30.0 * time - 170.0


@given(drives(along), drives(along), tolerances, st.none() | tolerances, st.sampled_from([".log", ".mcap"]))
def test_differences_are_those_of_a_loop(
    a: Any, b: Any, tolerance: float, time_tolerance: float | None, suffix: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            build(
                Path(folder) / name, Header("Town01", 0), [records for _, records in side], times=[time for time, _ in side]
            )
            for name, side in ((f"a{suffix}", a), ("b.log", b))
        )
        with reading(first) as reader_a, reading(second) as reader_b:
            found = differences(reader_a, reader_b, tolerance=tolerance, time_tolerance=time_tolerance, events=False)
            ours, theirs = Drive(reader_a), Drive(reader_b)
    if time_tolerance is None:
        time_tolerance = 1.0 if tolerance else 0.0
    assert {row.role_name for row in found.actors} == ours.lives.keys() & theirs.lives.keys()
    assert {life.role_name for life in found.missing} == ours.lives.keys() - theirs.lives.keys()
    assert {life.role_name for life in found.extra} == theirs.lives.keys() - ours.lives.keys()
    for row in found.actors:
        expected = paths(row.role_name, ours, theirs, tolerance)
        measured = {name: getattr(row, name) for name in expected}
        if not any(math.isclose(distance, tolerance) for distance in (row.max, row.first_distance or math.nan)):
            assert row.differs == actor_differs(row.role_name, ours, theirs, tolerance, time_tolerance)
        assert known(measured) == pytest.approx(known(expected), rel=1e-6, abs=1e-6, nan_ok=True)
    for row in found.lights:
        expected = light(f"{LIGHT}.0", ours, theirs)
        assert known({name: getattr(row, name) for name in expected}) == pytest.approx(known(expected))
        assert row.differs == (row.first is not None and (row.seconds > time_tolerance or time_tolerance == 0))


def known(values: dict[str, float | None]) -> list[float]:
    return [-1.0 if value is None else value for value in values.values()]


spawns = st.tuples(st.integers(0, 3), st.sampled_from([0.0, 0.2, 0.4, 0.5, 0.6, 5.0]), st.sampled_from([0.0, 0.3, 1.0, 1.5]))


@given(st.lists(spawns, max_size=30), st.lists(spawns, max_size=30))
def test_the_nearest_spawns_are_matched_as_by_all_pairs(a: Any, b: Any) -> None:
    ours, theirs = (
        [ActorLife(id, "walker.a", "walker", "", time, time, spawn=Spawn(id, 2, 100 * x)) for id, x, time in side]
        for side in (a, b)
    )
    pairs = sorted(
        (math.dist(p.place, q.place), abs(p.spawned_at - q.spawned_at), p.id != q.id, m, n)
        for m, p in enumerate(ours)
        for n, q in enumerate(theirs)
        if math.dist(p.place, q.place) <= 0.5 and abs(p.spawned_at - q.spawned_at) <= 1
    )
    left = set(range(len(ours))), set(range(len(theirs)))
    expected = []
    for *_, m, n in pairs:
        if m in left[0] and n in left[1]:
            left[0].remove(m)
            left[1].remove(n)
            expected.append((m, n))
    assert sorted((p, q) for p, q, by in match(ours, theirs) if by == "birth") == sorted(expected)
