from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.formats import open_reader
from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import ActorLives
from carla_recap.queries.measures import measures
from carla_recap.queries.measures.motion_blocks import MotionBlock
from carla_recap.queries.measures.near_misses import TYPES, NearMissDetector, paths_meet
from tests.queries.measures.conftest import Mover, straight

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.queries.measures.near_misses import NearMiss
    from tests.queries.measures.conftest import Drive

SAMPLES = Path(__file__).parents[3] / "samples"


def near_misses(reader: Reader, ids: frozenset[int] | None = None, **thresholds: float) -> list[NearMiss]:
    collector, contacts = ActorLives(), Contacts()
    for frame in reader.frames(("spawned", "destroyed", "parented", "bounding_boxes", "collisions"), sparse=True):
        contacts.add(frame)
        for packet in frame.packets:
            collector.add(packet, frame.elapsed)
    detector = NearMissDetector(collector, contacts, ids, **thresholds)
    for batch in reader.batches(TYPES):
        detector.batch(batch)
    return detector.finish()


def braking(id: int, x: float, speed: float, from_time: float, deceleration: float, **given: Any) -> Mover:
    """Return a car that drives east, and brakes to a standstill from a time on."""
    stop = speed / deceleration

    def position(t: float) -> float:
        after = min(max(t - from_time, 0.0), stop)
        return x + speed * min(t, from_time) + speed * after - deceleration / 2 * after * after

    return Mover(id, position, **given)


# --- by time to collision -------------------------------------------------------------------------------


def test_a_late_braking_behind_a_standing_car(drive: Drive) -> None:
    """From 15 m/s at 7 m/s², to a stop 1 m behind it: the time to collision is least shortly before the end."""
    (found,) = near_misses(drive([braking(1, 0, 15, 2.0, 7.0), straight(2, 30 + 225 / 14 + 5, 0, 0)], seconds=8))
    assert (found.id1, found.id2) == (1, 2)
    assert 1.6 <= found.start < found.time <= found.stop < 4.2
    speed = found.speed
    gap = 1 + speed * speed / 14
    assert found.time_to_collision == pytest.approx(gap / speed, abs=0.01)
    assert speed / (2 * found.time_to_collision) >= 3.4
    assert found.post_encroachment_time == math.inf


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("from_time", [0.5, 1.27, 1.4, 2.0])
def test_the_time_is_the_least_until_the_encounter_ends(drive: Drive, suffix: str, from_time: float) -> None:
    """It brakes from 15 m/s to 1.5 m/s, where no deceleration would be critical, and rolls on for 0.3 s until it stands."""
    slow = from_time + 13.5 / 7

    def position(t: float) -> float:
        braking = min(max(t - from_time, 0.0), 13.5 / 7)
        return 15 * (min(t, from_time) + braking) - 3.5 * braking * braking + 1.5 * min(max(t - slow, 0.0), 0.3)

    reader = drive([Mover(1, position), straight(2, position(slow) + 4.8, 0, 0)], seconds=6, suffix=suffix)
    (found,) = near_misses(reader)
    (least,) = (row for row in measures(reader, {1}) if row.measure == "time_to_collision")
    assert least.time > slow
    assert (found.time_to_collision, found.time) == (least.value, least.time)
    assert found.speed == pytest.approx(1.5, abs=0.01)
    assert found.start < found.time == found.stop


def test_braking_gently_behind_a_standing_car_is_none(drive: Drive) -> None:
    assert near_misses(drive([braking(1, 0, 15, 2.0, 2.0), straight(2, 30 + 225 / 4 + 6, 0, 0)], seconds=11)) == []


def test_a_queue_that_closes_up_is_none(drive: Drive) -> None:
    assert near_misses(drive([braking(1, 0, 3, 1.0, 3.0), straight(2, 3 + 1.5 + 4.5, 0, 0)], seconds=4)) == []


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


def test_the_other_lane_of_a_bend_is_no_obstacle(drive: Drive) -> None:
    """Two cars meet in a bend, and others are parked beside it; their headings lead into each other."""

    def bend(id: int, radius: float, speed: float, start: float) -> Mover:
        def angle(t: float) -> float:
            return start + speed * t / radius

        return Mover(
            id,
            lambda t: radius * math.cos(angle(t)),
            lambda t: radius * math.sin(angle(t)),
            lambda t: math.degrees(angle(t)) + math.copysign(90, speed),
        )

    cars = [bend(1, 25, 9, 0), bend(2, 28.2, -9, 2.5), *(bend(3 + n, 31, 1e-9, n / 4) for n in range(8))]
    assert near_misses(drive(cars, seconds=6)) == []


def test_two_frames_are_too_few(drive: Drive) -> None:
    car = Mover(1, lambda t: 15 * t, lambda t: 0.0 if t < 1.92 else (t - 1.92) * 40, lambda t: 0 if t < 1.9 else 70)
    assert near_misses(drive([car, straight(2, 32, -1.99, 0)], seconds=2.2), time_to_collision=0.1) == []


def test_cutting_in(drive: Drive) -> None:
    """A slow car comes from the side into the lane, and the other one brakes."""
    cutting = Mover(2, lambda t: 30 + 5 * t, lambda t: 3.5 - min(max(t - 1, 0), 1) * 3.5, lambda t: -35 if 1 < t < 2 else 0)
    (found,) = near_misses(drive([braking(1, 0, 15, 1.8, 8.0), cutting], seconds=6))
    assert (found.id1, found.id2) == (1, 2)
    assert found.time_to_collision < 1.5


def test_a_pedestrian_in_front_of_a_car(drive: Drive) -> None:
    walker = straight(2, 30, -3, 1.5, yaw=90, kind=2, type_id="walker.pedestrian.0001", size=(0.5, 0.5))
    (found,) = near_misses(drive([braking(1, 0, 12, 1.2, 7.5), walker], seconds=8))
    assert (found.id1, found.id2) == (1, 2)
    assert found.time_to_collision <= 1.5


def test_pedestrians_do_not_nearly_miss_each_other(drive: Drive) -> None:
    walkers = [
        straight(id, x, 0, 3, yaw=yaw, kind=2, type_id="walker.a", size=(0.5, 0.5))
        for id, x, yaw in ((1, 0, 0), (2, 10, 180))
    ]
    assert near_misses(drive(walkers, seconds=1.5)) == []


# --- where paths cross ----------------------------------------------------------------------------------


def test_crossing_paths(drive: Drive) -> None:
    (found,) = near_misses(drive([straight(1, -20, 0, 10), straight(2, 0, -30, 10, yaw=90)], seconds=6))
    assert (found.id1, found.id2) == (2, 1)
    assert found.post_encroachment_time == pytest.approx(0.4, abs=0.03)
    assert found.time_to_collision == math.inf
    assert (found.start, found.stop) == (pytest.approx(2.3, abs=0.06), pytest.approx(2.7, abs=0.06))


def test_crossing_later_is_none(drive: Drive) -> None:
    assert near_misses(drive([straight(1, -20, 0, 10), straight(2, 0, -38, 10, yaw=90)], seconds=6)) == []


def test_a_greater_threshold(drive: Drive) -> None:
    reader = drive([straight(1, -20, 0, 10), straight(2, 0, -38, 10, yaw=90)], seconds=6)
    (found,) = near_misses(reader, post_encroachment_time=2.0)
    assert found.post_encroachment_time == pytest.approx(1.2, abs=0.03)


def test_following_around_a_corner_is_no_crossing(drive: Drive) -> None:
    def corner(id: int, ahead: float) -> Mover:
        def share(t: float) -> float:
            return min(max((8 * t + ahead - 20) / (4 * math.pi), 0.0), 1.0)

        def x(t: float) -> float:
            return min(8 * t + ahead, 20.0) + 8 * math.sin(share(t) * math.pi / 2)

        def y(t: float) -> float:
            return 8 - 8 * math.cos(share(t) * math.pi / 2) + max(8 * t + ahead - 20 - 4 * math.pi, 0.0)

        return Mover(id, x, y, lambda t: 90 * share(t))

    assert near_misses(drive([corner(1, 0), corner(2, 8)], seconds=8)) == []


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


def test_near_misses_in_different_blocks(drive: Drive) -> None:
    """A car meets a crossing one every 51.2 s, as often as parts of a recording begin."""

    def x(t: float) -> float:
        return 10 * ((t - 0.2) % 51.2) - 20

    cars = [
        Mover(1, x, present=lambda t: abs(x(t)) < 30),
        Mover(2, lambda _: 0.0, lambda t: x(t) - 10, lambda _: 90.0, present=lambda t: abs(x(t)) < 30),
    ]
    found = near_misses(drive(cars, seconds=160))
    assert [miss.start for miss in found] == pytest.approx([2.5 + 51.2 * n for n in range(4)], abs=0.1)


def test_a_collision_is_no_near_miss_nor_is_what_follows(drive: Drive) -> None:
    hero = Mover(1, lambda t: min(10 * t, 20.0), role_name="hero")
    reader = drive([hero, straight(2, 24, 0, 0)], seconds=6.0, events={40: {"collisions": [(0, 1, 2, 1, 0)]}})
    assert near_misses(reader) == []
    assert near_misses(drive([hero, straight(2, 24, 0, 0)], seconds=6.0)) != []  # which is not recorded


def test_of_some_actors(drive: Drive) -> None:
    reader = drive([straight(1, -20, 0, 10), straight(2, 0, -30, 10, yaw=90), straight(3, 50, 0, 10)], seconds=6)
    assert len(near_misses(reader, frozenset([1]))) == 1
    assert near_misses(reader, frozenset([3])) == []


def test_a_teleport_is_none(drive: Drive) -> None:
    car = Mover(1, lambda t: 15 * t if t < 2 else 15 * t + 40)
    assert near_misses(drive([car, straight(2, 90, 0, 0)], seconds=2.45)) == []


@pytest.mark.parametrize("name", ["junction.mcap", "blocked.mcap"])
def test_samples_without(name: str) -> None:
    with closing(open_reader(SAMPLES / name)) as reader:
        assert near_misses(reader) == []


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


@pytest.mark.filterwarnings("error")
def test_many_actors_in_one_spot_are_processed_in_bounded_time(drive: Drive) -> None:
    cars = [straight(id + 1, id % 7, id % 5, 12, size=None) for id in range(1500)]
    near_misses(drive(cars, seconds=0.3))


# --- limits ----------------------------------------------------------------------------------------------


def approaching(frames: int, *, later: int = 0, other: float = 0.0) -> list[Mover]:
    """A car at 15 m/s is in each of 20 frames of a second 0.05 s nearer to a standing one.

    It has less than 1.51 s to the collision in some frames, from frame 10 on or later, and then vanishes.
    """

    def present(time: float) -> bool:
        return time < (10 + later + frames) / 20 - 0.01

    return [straight(1, -0.75 * later, 0, 15, present=present), straight(2, 34, other, 0)]


@pytest.mark.parametrize("later", [0, 53, 54, 55, 200])  # frames of a run are looked for in 64 frames at once
@pytest.mark.parametrize("frames", [2, 3, 10])
def test_a_near_miss_takes_three_frames(drive: Drive, later: int, frames: int) -> None:
    found = near_misses(drive(approaching(frames, later=later), seconds=2 + later / 20), time_to_collision=1.51)
    if frames < 3:
        assert found == []
        return
    (miss,) = found
    assert (miss.start, miss.stop) == pytest.approx(((10 + later) / 20, (9 + later + frames) / 20))
    assert (miss.time, miss.time_to_collision) == pytest.approx((miss.stop, 1.55 - frames / 20), abs=1e-4)
    assert (miss.x, miss.y, miss.speed) == pytest.approx((15 * miss.stop - 0.75 * later, 0, 15), abs=1e-3)


@pytest.mark.parametrize(("frame", "count"), [(78, 0), (80, 1)])
def test_what_ends_in_a_collision_within_three_seconds_is_none(drive: Drive, frame: int, count: int) -> None:
    """The run ends after 0.95 s."""
    reader = drive(approaching(10), seconds=15, events={frame: {"collisions": [(0, 1, 2, 0, 0)]}})
    assert len(near_misses(reader, time_to_collision=1.51)) == count


@pytest.mark.parametrize(("frame", "count"), [(2, 0), (0, 1)])
def test_what_follows_a_collision_within_five_seconds_is_none(drive: Drive, frame: int, count: int) -> None:
    """The run starts after 5.05 s."""
    reader = drive(approaching(10, later=91), seconds=15, events={frame: {"collisions": [(0, 1, 2, 0, 0)]}})
    assert len(near_misses(reader, time_to_collision=1.51)) == count


def block_of(*movers: Mover, seconds: float = 3.0) -> MotionBlock:
    """Return the motion of actors, 20 frames a second; the block ends with its last frame."""
    time = np.arange(round(seconds * 20) + 1) / 20

    def rows(function: str) -> np.ndarray:
        return np.array([[getattr(mover, function)(t) for t in time] for mover in movers], float)

    def slopes(values: np.ndarray) -> np.ndarray:
        return np.gradient(values, time, axis=1, edge_order=2)

    x, y, ones = rows("x"), rows("y"), np.ones(len(movers))
    return MotionBlock(
        index=0,
        first=0,
        last=len(time),
        time=time,
        ids=np.array([mover.id for mover in movers]),
        actors=(),
        is_vehicle=ones > 0,
        x=x,
        y=y,
        z=np.zeros_like(x),
        yaw=np.deg2rad(rows("yaw")),
        vx=slopes(x),
        vy=slopes(y),
        length=4 * ones,
        width=2 * ones,
        height=1.5 * ones,
        offset=np.zeros((len(movers), 3)),
    )


@pytest.mark.parametrize(("beside", "meet"), [(2.29, True), (2.31, False), (-2.29, True), (-2.31, False)])
def test_paths_meet_within_thirty_centimetres(beside: float, meet: bool) -> None:
    block = block_of(straight(1, 0, 0, 10), straight(2, 20, beside, 0))
    assert paths_meet(block, 0, 1, 0) == meet
    assert paths_meet(block, 1, 0, 0) == meet


@pytest.mark.parametrize(("far", "meet"), [(23.9, True), (24.9, False)])
def test_paths_meet_within_two_seconds(far: float, meet: bool) -> None:
    """After 2 s at 10 m/s, the front of a car is 22 m ahead of where its middle was; the wider box is not longer."""
    assert paths_meet(block_of(straight(1, 0, 0, 10), straight(2, far, 0, 0)), 0, 1, 0) == meet


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
    block = block_of(bend, ahead, tangent)
    assert [paths_meet(block, 0, other, round(now * 20)) for other in (1, 2)] == [True, False]
