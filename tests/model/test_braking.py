"""Hard braking: from which deceleration on, for how long, and of which vehicles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.model import braking
from carla_recap.model.batch import Batch
from carla_recap.model.braking import BrakingDetector
from carla_recap.model.frame import Frame
from carla_recap.model.records import ActorKind, Spawn
from tests.twins import braking as twin

Speed = Callable[[float], float]

TICK = 0.05


def slowing(deceleration: float, start: float = 1.0, seconds: float = 1.0, speed: float = 20.0) -> Speed:
    """Return the speed of a car that brakes for some time."""
    return lambda time: speed - deceleration * min(max(time - start, 0.0), seconds)


def detected(cars: Mapping[int, Speed], *, frames: int = 60) -> BrakingDetector:
    """Return a detector that got the drive of cars to the east; ids below 100 are known vehicles."""
    detector = BrakingDetector([id for id in cars if id < 100], 6.0)
    way = dict.fromkeys(cars, 0.0)
    for number in range(frames):
        poses = [(id, 100 * way[id], 100.0 * id, 0.0, 0.0, 0.0, 0.0) for id in cars]
        detector.batch(Batch.of(Frame(number, number + 1, number * TICK, TICK, []).replace(transforms=poses)))
        for id, speed in cars.items():
            way[id] += speed((number + 0.5) * TICK) * TICK
    return detector


def test_braking_is_found_with_place_and_speed() -> None:
    detector = detected({1: slowing(7), 2: slowing(5), 3: slowing(-7)})
    (found,) = detector.finish()
    assert (found.id, found.y) == (1, 100)
    assert (found.start, found.stop) == pytest.approx((1.05, 1.95), abs=0.11)
    assert found.speed == pytest.approx(20 - 7 * (found.start - 1), abs=0.1)
    assert found.x == pytest.approx(100 * (20 * found.start - 3.5 * (found.start - 1) ** 2), abs=5)


def test_the_hardest_moment_is_within_the_given_time() -> None:
    first, second = slowing(7), slowing(9, 3.0)
    detector = detected({1: lambda time: first(time) + second(time)}, frames=100)
    detector.finish()
    assert detector.hardest(1, 0, 5)[0] == pytest.approx(9, abs=0.01)
    assert detector.hardest(1, 0, 2.5)[0] == pytest.approx(7, abs=0.01)
    deceleration, time = detector.hardest(1, 0, 5)
    assert detector.hardest(1, time, time) == (deceleration, time)
    assert np.isnan(detector.hardest(1, 0, 0.5)).all()
    assert np.isnan(detector.hardest(2, 0, 5)).all()


def test_a_vehicle_whose_spawn_comes_after_its_records_is_reported() -> None:
    detector = detected({1: slowing(7), 200: slowing(7)})
    assert detector.add_spawns([Spawn(1, ActorKind.VEHICLE), Spawn(5, ActorKind.VEHICLE), Spawn(200, ActorKind.WALKER)])
    assert not detector.add_spawns([Spawn(200, ActorKind.VEHICLE)])
    assert [each.id for each in detector.finish()] == [1]


def test_frames_of_a_few_seconds_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(braking, "_BLOCK", 50)
    detector = BrakingDetector({1}, 6.0)
    for number in range(2000):
        frame = Frame(number, number + 1, number * TICK, TICK, []).replace(transforms=[(1, *6 * [0.0])])
        detector.batch(Batch.of(frame))
        assert len(detector._elapsed) <= 2 * (50 + 50 + 50)


def drives(choose: Random, count: int, tick: float, deceleration: float) -> list[Frame]:
    """Return frames of four vehicles that brake now and then; each is in some frames alone, and the clock may go back.

    Many brake about as hard, and for about as long, as makes a difference.
    """
    speeds, ways = dict.fromkeys(range(1, 5), 20.0), dict.fromkeys(range(1, 5), 0.0)
    rates, presence = dict.fromkeys(speeds, 0.0), {id: choose.choice((1.0, 1.0, 0.7, 0.1)) for id in speeds}
    left, limits = dict.fromkeys(speeds, 0), (deceleration, twin.TYRES, 1.1 * twin.TYRES)
    has_velocities, restarts, frames, elapsed = choose.choice((0.0, 0.5, 1.0)), choose.choice((0.0, 0.02)), [], 0.0
    for number in range(count):
        poses, velocities = [], []
        for id in speeds:
            left[id] -= 1
            if left[id] <= 0:
                about = -choose.choice(limits) * choose.choice((0.999, 1.001))
                rates[id] = choose.choice((0.0, 0.0, 12.0, choose.uniform(-80, 10), about, about, about))
                seconds = choose.choice((0.1, 0.3, 0.3, 1.0, choose.expovariate(2.5)))
                left[id] = round(seconds / tick) + choose.choice((-1, 0, 0, 1))
            speeds[id] = min(max(speeds[id] + rates[id] * tick, 0.0), 45.0)
            ways[id] += speeds[id] * tick
            if choose.random() < presence[id]:
                poses.append((id, 100 * ways[id], 100.0 * id, 0.0, 0.0, 0.0, 0.0))
                if choose.random() < has_velocities:
                    velocities.append((id, speeds[id], 0.0, choose.choice((0.0, 0.0, np.nan)), 0.0, 0.0, 0.0))
        poses.append((9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        frame = Frame(number, number + 1, elapsed, tick, [])
        frames.append(frame.replace(transforms=poses, velocities=velocities))
        elapsed += tick if choose.random() >= restarts else choose.choice((0.0, -tick, -10 * tick, 30 * tick))
    return frames


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 120),
    tick=st.sampled_from((0.05, 0.1, 0.02)) | st.floats(0.001, 0.6),
    block=st.integers(1, 1000),
    cells=st.integers(1, 500),
    collected=st.integers(1, 2000),
    deceleration=st.floats(0.5, 34.3),
)
@settings(max_examples=settings.default.max_examples // 2)
def test_as_the_twin_has_it_in_blocks_of_any_size(
    seed: int, count: int, tick: float, block: int, cells: int, collected: int, deceleration: float
) -> None:
    frames = drives(Random(seed), count, tick, deceleration)
    detector = BrakingDetector(range(1, 5), deceleration)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(braking, "_BLOCK", block)
        patch.setattr(braking, "_CELLS", cells)
        patch.setattr(braking, "_COLLECTED", collected)
        for frame in frames:
            detector.batch(Batch.of(frame))
        found = detector.finish()
    expected = twin.braking(frames, range(1, 5), deceleration)
    assert [(each.id, each.start, each.stop) for each in found] == [each[:3] for each in expected]
    for each, (*_, first, last, hardest) in zip(found, expected, strict=True):
        possible = detector.by_tyres(each)
        assert (possible is None) is math.isnan(hardest)
        if possible is not None:
            assert (possible.start, possible.stop) == (first, last)
            assert detector.hardest(each.id, each.start, each.stop)[0] == pytest.approx(hardest, abs=1e-5)
