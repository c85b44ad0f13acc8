from __future__ import annotations

import math
import tracemalloc
from typing import Any

import numpy as np
import pytest

from carla_recap.formats.base import Reader
from carla_recap.model.motion import MOTION
from carla_recap.queries.measures.encroachment import Encounter
from carla_recap.queries.measures.near_misses import NearMissDetector
from carla_recap.queries.measures.pairs import ELEMENTS, PairFrames, near_pairs, paths_meet
from carla_recap.queries.recorded_actors import lives_and_contacts
from tests.queries.measures.conftest import Drive, Mover, motion_table, straight


def near_misses(reader: Reader, ids: frozenset[int] | None = None, **thresholds: float) -> list[Encounter]:
    detector = NearMissDetector(*lives_and_contacts(reader), ids, **thresholds)
    for batch in reader.batches(MOTION):
        detector.batch(batch)
    return detector.finish()


@pytest.mark.parametrize(
    "other",
    [
        straight(2, 60, 3.2, 0),  # parked beside the road
        straight(2, 60, -2.5, 0, yaw=180),
        straight(2, 120, 3.2, 15, yaw=180),  # oncoming on the other lane
        straight(2, -10, 3.2, 30),  # overtaking
        straight(2, 5, 0, 15),  # close in front, as fast
        straight(2, 60, 0, 0, z=6.0),  # under a bridge
        straight(2, 4.5, 0, 15, parent=1, yaw=0),
    ],
)
def test_no_near_miss(drive: Drive, other: Mover) -> None:
    assert near_misses(drive([straight(1, 0, 0, 15), other], seconds=8)) == []


def test_of_some_actors(drive: Drive) -> None:
    reader = drive([straight(1, -20, 0, 10), straight(2, 0, -30, 10, yaw=90), straight(3, 50, 0, 10)], seconds=6)
    assert len(near_misses(reader, frozenset([1]))) == 1
    assert near_misses(reader, frozenset([3])) == []


# --- hostile recordings ---------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
def test_random_poses_do_no_harm(drive: Drive) -> None:
    random = np.random.default_rng(5)
    values = random.choice([0, 1, 5, -3, 1e8, math.nan, math.inf, 1e30], size=(40, 61, 3))
    movers = [
        Mover(
            id + 1,
            lambda t, id=id: float(values[id, round(t * 20), 0]),
            lambda t, id=id: float(values[id, round(t * 20), 1]),
            lambda t, id=id: float(values[id, round(t * 20), 2]),
            has_velocity=False,
            size=None,
        )
        for id in range(40)
    ]
    near_misses(drive(movers, seconds=3))


def test_all_pairs_of_many_actors_in_one_spot_are_found(drive: Drive) -> None:
    cars = [straight(id + 1, 0.01 * id, 0, 12, size=None) for id in range(120)]
    assert len(near_misses(drive(cars, seconds=0.1))) == 120 * 119 / 2


# --- limits ----------------------------------------------------------------------------------------------


HIT, CROSSING_TIME = [{"collisions": [(0, *pair, 0, 0)]} for pair in ((1, 2), (3, 1))], 6.0


def coming(kind: int = 1) -> list[Mover]:
    """A car is for a frame, after 6 s, within 1.45 s of a standing one; beside them is another actor, far away."""
    car = straight(1, 0, 0, 10, present=lambda t: t < CROSSING_TIME + 0.02)
    type_id = "walker.a" if kind == 2 else "vehicle.a"
    return [car, straight(2, 60 + 14.9 + 4, 0, 0), straight(3, 0, 50, 0, kind=kind, type_id=type_id)]


def bouncing(after: float) -> list[Mover]:
    """A car hits another one after 1 s, and comes back some time later; the second touch is not recorded."""
    return [straight(1, 0, 0, 0), Mover(2, lambda t: 3.9 + 10 * min(abs(t - 1), abs(t - 1 - after)))]


@pytest.mark.parametrize(
    ("movers", "time", "hit", "count"),
    [
        (coming(), 1.1, HIT[1], 0),  # what a vehicle has hit has none for 5 s
        (coming(), 0.8, HIT[1], 1),
        (coming(kind=2), 1.1, HIT[1], 1),  # but what a walker has
        (coming(), 8.9, HIT[0], 0),  # what ends in a collision within 3 s is none
        (coming(), 9.05, HIT[0], 1),
        (coming(), 1.1, HIT[0], 0),  # nor what follows one within 5 s
        (coming(), 0.8, HIT[0], 1),
        (bouncing(4.8), 1.0, HIT[0], 0),
        (bouncing(5.2), 1.0, HIT[0], 1),
    ],
)
def test_limits(drive: Drive, movers: list[Mover], time: float, hit: dict[str, Any], count: int) -> None:
    assert len(near_misses(drive(movers, seconds=9.5, events={round(time * 20): hit}))) == count


@pytest.mark.parametrize("seconds", [0.5, 3.0, 6.6, 58.0])
def test_any_post_encroachment_time_that_is_asked_for_is_found(drive: Drive, seconds: float) -> None:
    """A car crosses the path of another one some time after it, at any place in a table."""
    cars = [straight(1, -20, 0, 10), straight(2, 0, -20 - 6 - 10 * seconds, 10, yaw=90)]
    reader = drive(cars, seconds=seconds + 8)
    (found,) = near_misses(reader, time_to_collision=0, post_encroachment_time=seconds + 0.1)
    assert found.post_encroachment_time == pytest.approx(seconds, abs=0.03)
    assert near_misses(reader, time_to_collision=0, post_encroachment_time=seconds - 0.1) == []


@pytest.mark.parametrize(("dz", "count"), [(2.5, 3), (2.51, 0), (-2.5, 3), (-2.51, 0)])
def test_boxes_are_on_one_level_up_to_half_a_metre_between_them(dz: float, count: int) -> None:
    table = motion_table(np.arange(3) / 20, [[0.0], [5.0]], z=[[0.0], [dz]], height=np.array([1.0, 3.0]))
    assert len(PairFrames.of(table, np.zeros(3, int), np.ones(3, int), np.arange(3)).frame) == count


def test_memory_does_not_grow_with_the_square_of_the_actors() -> None:
    """One actor in 4 is a subject; each is near its neighbours alone."""
    table, subjects = motion_table(np.arange(3) / 20, 100.0 * np.arange(3000)[:, None]), np.arange(3000) % 4 == 0
    tracemalloc.start()
    found = list(near_pairs(table, subjects, np.full(3000, 60.0)))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    pairs = {pair for part in found for pair in zip(part.one.tolist(), part.other.tolist(), strict=True)}
    assert pairs == {(one, one + 1) for one in range(2999) if one % 4 in (0, 3)}
    assert most < 5 * ELEMENTS


def meet(far: float, beside: float, seconds: float) -> bool:
    """Return whether a car at 10 m/s meets one that stands ahead, along a straight line after some seconds."""
    time = np.arange(61) / 20
    table = motion_table(time, [10 * time, far + 0 * time], [[0.0], [beside]], vx=[[10.0], [0.0]])
    one, other = paths_meet(table, *np.array([(0, 1), (1, 0), (0, 0)]), np.full(2, seconds)).tolist()
    assert one == other
    return bool(one)


def test_paths_meet_within_thirty_centimetres() -> None:
    assert [meet(20, beside, 1.6) for beside in (2.29, 2.31, -2.29, -2.31)] == [True, False, True, False]


@pytest.mark.parametrize("seconds", [0.0, 1.0, 9.3, 55.0])
def test_paths_meet_half_a_second_later_at_most(seconds: float) -> None:
    """The front of a car is 2 m ahead of its middle, and the boxes are not wider lengthwise by more than 0.15 m each."""
    assert meet(10 * (seconds + 0.5) + 3.9, 0, seconds)
    assert not meet(10 * (seconds + 0.6) + 4.4, 0, seconds)
