from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from carla_recap.formats.base import Reader
from carla_recap.model.motion import MOTION
from carla_recap.model.records import Spawn
from carla_recap.queries.measures.encroachment import Encounter
from carla_recap.queries.measures.motion_table import MotionTable
from carla_recap.queries.measures.near_misses import NearMissDetector
from carla_recap.queries.measures.pairs import paths_meet
from carla_recap.queries.recorded_actors import lives_and_contacts
from tests.queries.measures.conftest import Drive, Mover, motion_table, straight


def near_misses(reader: Reader, ids: frozenset[int] | None = None, **thresholds: float) -> list[Encounter]:
    detector = NearMissDetector(*lives_and_contacts(reader), ids, **thresholds)
    for batch in reader.batches(MOTION):
        detector.batch(batch)
    return detector.finish()


def braking(id: int, x: float, speed: float, from_time: float, deceleration: float, **given: Any) -> Mover:
    """Return a car that drives east, and brakes to a standstill from a time on."""
    stop = speed / deceleration

    def position(t: float) -> float:
        after = min(max(t - from_time, 0.0), stop)
        return x + speed * min(t, from_time) + speed * after - deceleration / 2 * after * after

    return Mover(id, position, **given)


def test_encounters_of_two_actors_with_one_id_are_two(drive: Drive) -> None:
    """A car comes near another one at 1 s; from 1.5 s on, a car with its id comes from farther away."""
    again = {"destroyed": [(2,)], "spawned": [Spawn(2, 1, type_id="vehicle.mini.cooper_s", attributes=[])]}
    cars = [straight(1, 0, 0, 0), Mover(2, lambda t: 10 * (t if t < 1.475 else t - 1.5) - (25 if t < 1.475 else 27))]
    found = near_misses(drive(cars, seconds=3.0, events={30: again}))
    types = [each.one.type_id for each in found]
    assert types == ["vehicle.audi.tt", "vehicle.mini.cooper_s"]
    assert found[0].stop < 1.5 <= found[1].start <= found[0].stop + 3


# --- by time to collision -------------------------------------------------------------------------------


@pytest.mark.parametrize(("final_gap", "deceleration", "required"), [(2.0, 2.0, 1.0), (1.5, 3.0, 1.5), (1.0, 7.0, 3.5)])
def test_an_encounter_is_found_by_its_time_unless_it_requires_too_little_deceleration(
    drive: Drive, final_gap: float, deceleration: float, required: float
) -> None:
    """A car brakes with a to a stop d behind another one: its time to collision is least, √(2 d / a), at a gap of 2 d."""
    v = 3 * deceleration
    reader = drive(
        [braking(1, 0, v, 1.0, deceleration), straight(2, v + v * v / (2 * deceleration) + final_gap + 4, 0, 0)], seconds=6
    )
    (found,) = near_misses(reader)
    assert found.time_to_collision == pytest.approx(math.sqrt(2 * final_gap / deceleration), abs=0.02)
    assert found.required_deceleration >= required - 0.05
    assert near_misses(reader, required_deceleration=found.required_deceleration) == [found]
    assert near_misses(reader, required_deceleration=found.required_deceleration + 1e-6) == []


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


# --- encounters -----------------------------------------------------------------------------------------


def test_an_encounter_is_one_near_miss(drive: Drive) -> None:
    """A car brakes from 10 to 4 m/s before the path of another one, and crosses it 0.45 s after that."""

    def x(t: float) -> float:
        braking = min(max(t - 1.5, 0.0), 1.0)
        return -30 + 10 * min(t, 1.5) + 10 * braking - 3 * braking * braking + 4 * max(t - 2.5, 0.0)

    (found,) = near_misses(drive([Mover(1, x), straight(2, 0, -30, 10, yaw=90)], seconds=6))
    assert found.time_to_collision == pytest.approx(1.1, abs=0.02)
    assert found.post_encroachment_time == pytest.approx(0.45, abs=0.02)
    assert (found.start, found.stop) == pytest.approx((1.2, 3.8), abs=0.06)


@pytest.mark.parametrize(("after", "count"), [(4.9, 0), (5.2, 1)])
@pytest.mark.parametrize(("kind", "is_thrown"), [(1, True), (2, False)])
def test_what_a_vehicle_has_hit_has_no_near_misses_for_five_seconds(
    drive: Drive, after: float, count: int, kind: int, is_thrown: bool
) -> None:
    """The car that comes within 1.45 s of a standing one for a frame was hit by a vehicle, or has hit a walker, before."""
    car = straight(1, 0, 0, 10, present=lambda t: t < 6.02)
    far = straight(3, 0, 50, 0, kind=kind, type_id="walker.a" if kind == 2 else "vehicle.a")
    at = 6.0 - after
    events = {round(at * 20): {"collisions": [(0, 3, 1, 0, 0)]}}
    reader = drive([car, straight(2, 60 + 14.9 + 4, 0, 0), far], seconds=7, events=events)
    assert len(near_misses(reader)) == (count if is_thrown else 1)


def test_a_collision_is_no_near_miss_nor_is_what_follows(drive: Drive) -> None:
    hero = Mover(1, lambda t: min(10 * t, 20.0), role_name="hero")
    reader = drive([hero, straight(2, 24, 0, 0)], seconds=6.0, events={40: {"collisions": [(0, 1, 2, 1, 0)]}})
    assert near_misses(reader) == []
    assert near_misses(drive([hero, straight(2, 24, 0, 0)], seconds=6.0)) != []  # which is not recorded


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


def approaching(frames: int, *, later: int = 0, other: float = 0.0) -> list[Mover]:
    """A car at 15 m/s is in each of 20 frames of a second 0.05 s nearer to a standing one.

    It has less than 1.51 s to the collision in some frames, from frame 10 on or later, and then vanishes.
    """

    def present(time: float) -> bool:
        return time < (10 + later + frames) / 20 - 0.01

    return [straight(1, -0.75 * later, 0, 15, present=present), straight(2, 34, other, 0)]


@pytest.mark.parametrize("later", [0, 53, 54, 55, 200])  # frames are looked for 64 at once
@pytest.mark.parametrize("frames", [1, 3, 10])
def test_the_critical_time_is_all_frames_below_the_limit(drive: Drive, later: int, frames: int) -> None:
    (miss,) = near_misses(drive(approaching(frames, later=later), seconds=2 + later / 20), time_to_collision=1.51)
    assert (miss.start, miss.stop) == pytest.approx(((10 + later) / 20, (9 + later + frames) / 20))
    assert (miss.time, miss.time_to_collision) == pytest.approx((miss.stop, 1.55 - frames / 20), abs=1e-4)
    assert (*miss.place[:2], miss.speed) == pytest.approx((15 * miss.stop - 0.75 * later, 0, 15), abs=1e-3)


@pytest.mark.parametrize("seconds", [0.5, 3.0, 6.6, 58.0])
def test_any_post_encroachment_time_that_is_asked_for_is_found(drive: Drive, seconds: float) -> None:
    """A car crosses the path of another one some time after it, at any place in a table."""
    cars = [straight(1, -20, 0, 10), straight(2, 0, -20 - 6 - 10 * seconds, 10, yaw=90)]
    reader = drive(cars, seconds=seconds + 8)
    (found,) = near_misses(reader, time_to_collision=0, post_encroachment_time=seconds + 0.1)
    assert found.post_encroachment_time == pytest.approx(seconds, abs=0.03)
    assert near_misses(reader, time_to_collision=0, post_encroachment_time=seconds - 0.1) == []


@pytest.mark.parametrize(("frame", "count"), [(78, 0), (80, 1)])
def test_what_ends_in_a_collision_within_three_seconds_is_none(drive: Drive, frame: int, count: int) -> None:
    """The run ends after 0.95 s."""
    reader = drive(approaching(10), seconds=15, events={frame: {"collisions": [(0, 1, 2, 0, 0)]}})
    assert len(near_misses(reader, time_to_collision=1.51)) == count


def test_what_follows_a_collision_within_five_seconds_does_not_count(drive: Drive) -> None:
    """The time to collision is critical after 5.05 s."""
    reader = drive(approaching(10, later=91), seconds=15, events={4: {"collisions": [(0, 1, 2, 0, 0)]}})
    assert [miss.start for miss in near_misses(reader, time_to_collision=1.51)] == [pytest.approx(5.25)]


@pytest.mark.parametrize(("after", "count"), [(4.8, 0), (5.2, 1)])
def test_boxes_that_overlap_again_within_five_seconds_do_not_count(drive: Drive, after: float, count: int) -> None:
    """The other car comes back after the collision; the second touch is not recorded."""
    other = Mover(2, lambda t: 3.9 + 10 * min(abs(t - 1), abs(t - 1 - after)))
    reader = drive([straight(1, 0, 0, 0), other], seconds=8, events={20: {"collisions": [(0, 2, 1, 0, 0)]}})
    assert len(near_misses(reader)) == count


def table_of(*movers: Mover, seconds: float = 3.0) -> MotionTable:
    """Return the motion of actors, 20 frames a second; the table ends with its last frame."""
    time = np.arange(round(seconds * 20) + 1) / 20

    def rows(function: str) -> np.ndarray:
        return np.array([[getattr(mover, function)(t) for t in time] for mover in movers], float)

    x, y, yaw = map(rows, ("x", "y", "yaw"))
    vx, vy = (np.gradient(values, time, axis=1, edge_order=2) for values in (x, y))
    return motion_table(time, x, y, 0.0, np.deg2rad(yaw), vx, vy)


def meet(table: MotionTable, one: int, other: int, frame: int, seconds: float) -> bool:
    (found,) = paths_meet(table, *(np.array([value]) for value in (one, other, frame)), np.array([seconds]))
    return bool(found)


@pytest.mark.parametrize(("beside", "expected"), [(2.29, True), (2.31, False), (-2.29, True), (-2.31, False)])
def test_paths_meet_within_thirty_centimetres(beside: float, expected: bool) -> None:
    table = table_of(straight(1, 0, 0, 10), straight(2, 20, beside, 0))
    assert meet(table, 0, 1, 0, 1.6) == expected
    assert meet(table, 1, 0, 0, 1.6) == expected


@pytest.mark.parametrize("seconds", [0.0, 1.0, 9.3, 55.0])
def test_paths_meet_half_a_second_later_at_most(seconds: float) -> None:
    """The front of a car is 2 m ahead of its middle, and the boxes are not wider lengthwise by more than 0.15 m each."""
    for far, expected in ((10 * (seconds + 0.5) + 3.9, True), (10 * (seconds + 0.6) + 4.4, False)):
        assert meet(table_of(straight(1, 0, 0, 10), straight(2, far, 0, 0)), 0, 1, 0, seconds) == expected


@pytest.mark.parametrize("side", [1, -1])
def test_a_path_goes_on_as_it_bends(side: int) -> None:
    """A car turns with a radius of 20 m; 0.2 s before the end of the recording it is 1.5 s from an obstacle."""

    def angle(t: float) -> float:
        return t * 10 / 20

    bend = Mover(
        1,
        lambda t: 20 * math.sin(angle(t)),
        lambda t: side * (20 - 20 * math.cos(angle(t))),
        lambda t: side * math.degrees(angle(t)),
    )
    now, then = 2.8, 4.3
    cos, sin = math.cos(angle(now)), side * math.sin(angle(now))
    ahead = straight(2, bend.x(then), bend.y(then), 0, yaw=bend.yaw(then))
    tangent = straight(3, bend.x(now) + 15 * cos, bend.y(now) + 15 * sin, 0, yaw=bend.yaw(now))
    table = table_of(bend, ahead, tangent)
    assert [meet(table, 0, other, round(now * 20), 1.5) for other in (1, 2)] == [True, False]
