from __future__ import annotations

import math
import tracemalloc
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecapWarning
from carla_recap.formats.base import Reader
from carla_recap.model.motion import MOTION
from carla_recap.queries.measures.encroachment import CrossingSearch, Encounter
from carla_recap.queries.measures.near_misses import NearMissDetector
from carla_recap.queries.measures.pairs import ELEMENTS, near_pairs, paths_meet
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
    cars = [straight(id + 1, 0.01 * id, 0, 12, size=None) for id in range(60)]
    assert len(near_misses(drive(cars, seconds=0.1))) == 60 * 59 / 2


# --- limits ----------------------------------------------------------------------------------------------


def bouncing(after: float) -> list[Mover]:
    """A car hits another one after 1 s, and comes back some time later; the second touch is not recorded."""
    return [straight(1, 0, 0, 0), Mover(2, lambda t: 3.9 + 10 * min(abs(t - 1), abs(t - 1 - after)))]


@pytest.mark.parametrize(("after", "count"), [(4.8, 0), (5.2, 1)])
def test_what_follows_a_collision_within_five_seconds_does_not_count(drive: Drive, after: float, count: int) -> None:
    reader = drive(bouncing(after), seconds=8, events={20: {"collisions": [(0, 2, 1, 0, 0)]}})
    assert len(near_misses(reader)) == count


@pytest.mark.parametrize("seconds", [0.5, 3.0, 6.6, 58.0])
def test_any_post_encroachment_time_that_is_asked_for_is_found(drive: Drive, seconds: float) -> None:
    """A car crosses the path of another one some time after it, at any place in a table."""
    cars = [straight(1, -20, 0, 10), straight(2, 0, -20 - 6 - 10 * seconds, 10, yaw=90)]
    reader = drive(cars, seconds=seconds + 8, rate=10)
    (found,) = near_misses(reader, time_to_collision=0, post_encroachment_time=seconds + 0.1)
    assert found.post_encroachment_time == pytest.approx(seconds, abs=0.03)
    assert near_misses(reader, time_to_collision=0, post_encroachment_time=seconds - 0.1) == []


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


@pytest.mark.parametrize("side", [1, -1])
def test_a_path_goes_on_as_it_bends(side: int) -> None:
    """A car turns with a radius of 20 m; 0.2 s before the end of the recording it is 1.5 s from an obstacle."""
    time = np.append(np.arange(61) / 20, 4.3)
    x, y, yaw = 20 * np.sin(time / 2), side * (20 - 20 * np.cos(time / 2)), side * time / 2
    tangent = x[56] + 15 * np.cos(yaw[56]), y[56] + 15 * np.sin(yaw[56])
    ahead = tangent[0], tangent[1], yaw[56]
    rows = [[way[:61], [way[61]] * 61, [beside] * 61] for way, beside in zip((x, y, yaw), ahead, strict=True)]
    speeds = [[10 * function(yaw[:61]), [0.0] * 61, [0.0] * 61] for function in (np.cos, np.sin)]
    table = motion_table(time[:61], *rows[:2], 0.0, rows[2], *speeds)
    assert paths_meet(table, np.zeros(2, int), np.array([1, 2]), np.full(2, 56), np.full(2, 1.5)).tolist() == [True, False]


class Path(NamedTuple):
    """A straight path of a box: the centre in m and the heading in radians at each time."""

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray


def path(x: float, y: float, heading: float, speed: float, seconds: float = 6.0) -> Path:
    time, yaw = np.arange(0, seconds, 0.05), math.radians(heading)
    return Path(x + speed * math.cos(yaw) * time, y + speed * math.sin(yaw) * time, yaw + 0 * time)


def post_encroachment_time(one: Path, other: Path, start: float = 0.0) -> float:
    """The least time between one box of 4 m by 2 m leaving a spot and the other arriving there, up to 3 s; else inf."""
    x, y, yaw = map(np.stack, zip(one, other, strict=True))
    table = motion_table(start + 0.05 * np.arange(x.shape[1]), x, y, yaw=yaw, vx=10.0)
    search = CrossingSearch(3.0)
    search.add(table, np.ones(2, np.bool_))
    return min((each.post_encroachment_time for each in search.finish()), default=math.inf)


EAST = path(-20, 0, 0, 10)


def test_crossings_are_found_at_any_time() -> None:
    """As in a recording whose seconds are those since 1970."""
    found = [post_encroachment_time(EAST, path(0, -28, 90, 10), start) for start in (0.0, 1.7e9)]
    assert found == [pytest.approx(0.2, abs=0.01)] * 2
    with pytest.warns(RecapWarning, match="no crossings are found behind 1e"):
        post_encroachment_time(EAST, path(0, -28, 90, 10), 2e10)


@settings(max_examples=40, deadline=None)
@given(st.floats(4, 14), st.floats(4, 14), st.floats(45, 135), st.floats(-40, -8))
def test_it_is_the_entry_of_the_second_less_the_exit_of_the_first(v1: float, v2: float, turn: float, start: float) -> None:
    """By points on a fine grid in the shared area, each with the times at which the boxes cover it."""
    one = path(-15, 0, 0, v1, seconds=8)
    angle = math.radians(turn)
    other = path(start * math.cos(angle), start * math.sin(angle), turn, v2, seconds=8)
    points = np.stack(np.meshgrid(np.linspace(-4, 4, 161), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2)
    spans = []
    for box, speed in ((one, v1), (other, v2)):
        yaw = box.yaw[0]
        along = (points - (box.x[0], box.y[0])) @ (math.cos(yaw), math.sin(yaw))
        across = (points - (box.x[0], box.y[0])) @ (-math.sin(yaw), math.cos(yaw))
        covered = np.abs(across) <= 1
        spans.append((np.where(covered, (along - 2) / speed, np.nan), np.where(covered, (along + 2) / speed, np.nan)))
    (enter1, leave1), (enter2, leave2) = spans
    later = np.fmax(enter2 - leave1, enter1 - leave2)
    expected = math.inf if not (later > 0).all() and (later <= 0).any() else float(np.nanmin(later))
    found = post_encroachment_time(one, other)
    if expected < 2.8:
        assert found == pytest.approx(expected, abs=0.1)
    elif expected == math.inf:
        assert found == math.inf or found < 0.1


@pytest.mark.parametrize(("moment", "some"), [(1.5, True), (2.4, False), (9.6, False), (10.45, True)])
def test_actors_that_touch_within_three_seconds_are_there_at_once(moment: float, some: bool) -> None:
    """The first one leaves from 4.7 s to 5.3 s, the second one arrives from 6.7 s to 7.3 s, and they touch once."""
    east, north = path(-50, 0, 0, 10, seconds=14), path(0, -70, 90, 10, seconds=14)
    frame = round(moment * 20)
    east.x[frame], east.y[frame] = north.x[frame] + 1, north.y[frame] + 1
    assert (post_encroachment_time(east, north) < math.inf) == some
