"""Playing: start and stop, ticks, rates, and poses between two frames."""

from __future__ import annotations

import gc
import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import RecapError, Recording, open_recording
from carla_recap.model.frame import Frame
from carla_recap.replay import Player, Scene
from tests.replay.conftest import Record
from tests.replay.scripts import pose, spawn, velocity, write, x_of

FRAMES = 11


@pytest.fixture
def drive(record: Record) -> Recording:
    """10 s; actor 1 drives 1 m/s along x, a frame each second."""
    return record(*({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, 100 * n)]} for n in range(FRAMES)))


def ticks(player: Player, *deltas: float) -> list[Scene]:
    scenes = [player.tick(delta) for delta in deltas]
    assert all(scene is not None for scene in scenes)
    return [scene for scene in scenes if scene is not None]


# --- between frames ------------------------------------------------------------------------------------------


@given(
    st.lists(
        st.tuples(*[st.floats(-100, 100, width=32)] * 3, *[st.floats(-180, 180, width=32)] * 3), min_size=2, max_size=6
    ),
    st.lists(st.floats(0, 1), max_size=8),
)
def test_poses_equal_those_of_the_trajectory(
    tmp_path_factory: pytest.TempPathFactory, path: list[tuple[float, ...]], parts: list[float]
) -> None:
    file = tmp_path_factory.mktemp("drive") / "drive.log"
    write(file, [{"transforms": [(7, *place)]} for place in path], tick=0.25)
    with open_recording(file) as recording:
        times = np.arange(len(path)) * 0.25
        player = Player(recording)
        for part in parts:
            time = part * player.total
            place = player.at(time).poses[0]
            assert (np.abs(place[3:]) <= 180).all()
            for column in range(6):
                values = np.array([np.float32(row[column]) for row in path], np.float64)
                if column >= 3:
                    values = np.unwrap(values, period=360)
                off = place[column] - np.interp(time, times, values)
                ways = [off] if column < 3 else [math.remainder(off, 360)]
                if column >= 3 and np.isclose(np.abs(np.diff(values)), 180, atol=1e-3).any():
                    continue  # either way round is the shortest
                assert ways == pytest.approx([0], abs=1e-6)


def test_fast_is_not_interpolated(drive: Recording) -> None:
    player = Player(drive, time_factor=2.0)
    assert [x_of(scene) for scene in ticks(player, 0.25, 0.5, 0.25)] == [0, 100, 200]
    assert x_of(Player(drive, time_factor=1.9).tick(0.25)) == 47.5


def test_without_interpolation(drive: Recording) -> None:
    player = Player(drive, smooth=False)
    assert x_of(player.tick(0.75)) == 0
    player.smooth = True
    assert x_of(player.tick(0.0)) == 75


def test_poses_at_the_last_frame(drive: Recording) -> None:
    player = Player(drive)
    last = player.at(10.0)
    assert (x_of(last), last.frame_id, player.finished) == (1000, FRAMES, True)
    assert player.tick(1.0) is None


def test_the_first_frame_is_shown_before_its_time(record: Record) -> None:
    recording = record({"transforms": [pose(1, 100)]}, {"transforms": [pose(1, 200)]}, times=[5.0, 6.0])
    player = Player(recording)
    assert [x_of(scene) for scene in ticks(player, 0.0, 3.0, 2.5)] == [100, 100, 150]


def test_actors_missing_in_one_frame_are_not_interpolated(record: Record) -> None:
    recording = record(
        {"transforms": [pose(1, 0), pose(2, 0)]},
        {"transforms": [pose(2, 100), pose(3, 100)]},
        {"transforms": [pose(3, 200), pose(2, 200)]},
    )
    scenes = [Player(recording).at(time) for time in (0.5, 1.5)]
    assert [dict(zip(s.ids.tolist(), s.poses[:, 0].tolist(), strict=True)) for s in scenes] == [
        {1: 0, 2: 50},
        {2: 150, 3: 150},
    ]


# --- jumps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("way", "speed", "jumps"), [(499, 0, False), (501, 0, True), (501, 30, False)])
def test_jumps(record: Record, way: float, speed: float, jumps: bool) -> None:
    """How long a step may be is tested in `model.test_motion`."""
    frames = [{"transforms": [pose(8), pose(9, x)], "velocities": [velocity(9, speed)]} for x in (0, way)]
    scene = Player(record(*frames, tick=0.2)).at(0.1)
    assert scene.poses[1, 0] == pytest.approx(0 if jumps else way / 2)


def test_a_replaced_actor_jumps(record: Record) -> None:
    recording = record(
        {"spawned": [spawn(1)], "transforms": [pose(1, 0)]},
        {"spawned": [spawn(1)], "transforms": [pose(1, 100)]},
        {"transforms": [pose(1, 200)]},
    )
    assert [x_of(scene) for scene in ticks(Player(recording), 0.5, 1.0)] == [0, 150]


@pytest.mark.parametrize("odd", [math.nan, math.inf, 3e38])
@pytest.mark.parametrize("field", ["x", "yaw"])
def test_invalid_numbers_are_not_interpolated(record: Record, field: str, odd: float) -> None:
    recording = record(
        {"transforms": [pose(1, 0), pose(2, 0)]},
        {"transforms": [pose(1, **{field: odd}), pose(2, 100)]},
        {"transforms": [pose(1, 200), pose(2, 200)]},
    )
    player = Player(recording)
    assert player.at(0.5).poses[:, 0].tolist() == [0, 50]
    assert player.at(1.5).poses[1, 0] == 150


# --- start, duration, factor ---------------------------------------------------------------------------------


def test_start_and_duration(drive: Recording) -> None:
    player = Player(drive.reader, start=2.5, duration=1.0)  # the source can be a reader
    assert (player.start, player.stop, player.total) == (2.5, 3.5, 10)
    assert [x_of(scene) for scene in player.scenes(rate=2)] == [250, 300, 350]
    assert player.finished
    assert player.tick(1.0) is None


@pytest.mark.parametrize(("start", "expected"), [(-2.5, 7.5), (-10, 0), (-99, 0), (10, 10), (10.00505, 10)])
def test_start_from_the_end(drive: Recording, start: float, expected: float) -> None:
    player = Player(drive, start=start, duration=99)
    assert (player.start, player.stop) == (expected, 10)
    scenes = list(player.scenes())
    assert x_of(scenes[-1]) == 1000
    assert len({scene.time for scene in scenes}) == len(scenes)


@pytest.mark.parametrize("start", [10.01, 1e300, math.inf, math.nan])
def test_start_outside_the_recording(drive: Recording, start: float) -> None:
    with pytest.raises(RecapError, match=r"nothing at .* s; the recording ends at 10 s"):
        Player(drive, start=start)
    with pytest.raises(RecapError, match="nothing at"):
        Player(drive).at(start)


WRONG = {
    "duration": lambda drive, value: Player(drive, duration=value),
    "time factor": lambda drive, value: Player(drive, time_factor=value),
    "tick": lambda drive, value: Player(drive).tick(value),
    "scenes per second": lambda drive, value: next(Player(drive).scenes(value)),
}


@pytest.mark.parametrize(("name", "value"), [*product(WRONG, (-1, math.inf, math.nan)), ("scenes per second", 0)])
def test_invalid_numbers(drive: Recording, name: str, value: float) -> None:
    with pytest.raises(RecapError, match=name):
        WRONG[name](drive, value)


def test_the_factor_changes_while_playing(drive: Recording) -> None:
    player = Player(drive)
    ticks(player, 1.0)
    player.time_factor = 0.5
    assert x_of(player.tick(1.0)) == 150
    player.time_factor = 0
    assert x_of(player.tick(1.0)) == 150
    player.time_factor = 3
    assert player.tick(1.0).time == 4.5
    assert player.time == 4.5


def test_no_frames(record: Record) -> None:
    with pytest.raises(RecapError, match="no frames"):
        Player(record())


# --- scenes, and seeking ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seconds", "before"), [(2.5, [4.0, 5, 6, 6.5]), (20.0, [0.0, 1, 2, 3, 4, 5, 6, 6.5]), (0.0, [])])
def test_the_seconds_before_the_start_change_nothing_of_what_follows(
    drive: Recording, seconds: float, before: list[float]
) -> None:
    player, alone = Player(drive, start=6.5), Player(drive, start=6.5)
    assert [time for batch in player.lead(seconds) for time in batch.time.tolist()] == before
    for scene, expected in zip(player.scenes(), alone.scenes(), strict=True):
        assert (scene.time, x_of(scene), scene.fresh) == (expected.time, x_of(expected), expected.fresh)
        assert scene.events == expected.events


@pytest.mark.parametrize("rate", [3, 10, 30, 60])
def test_scenes_at_a_rate(drive: Recording, rate: int) -> None:
    times = [scene.time for scene in Player(drive).scenes(rate)]
    assert times == pytest.approx(np.arange(10 * rate + 1) / rate)
    assert times[-1] == 10


def test_the_time_factor_applies_to_rates(drive: Recording) -> None:
    assert [scene.time for scene in Player(drive, time_factor=4).scenes(1)] == [0, 4, 8, 10]


def test_seeking(drive: Recording) -> None:
    player = Player(drive)
    assert [x_of(player.at(time)) for time in (9.5, 0.5, 0.25, 4.75, 4.0, -1.0)] == [950, 50, 25, 475, 400, 900]
    assert x_of(player.tick(0.5)) == 950, "ticks go on from there"


def test_playing_again_after_seeking_back_from_the_end(drive: Recording) -> None:
    player = Player(drive, duration=2)
    assert len(list(player.scenes(1))) == 3
    assert player.tick(1) is None
    player.at(player.start)
    assert not player.finished
    assert len(list(player.scenes(1))) == 3


def test_old_frames_are_freed(tmp_path: Path) -> None:
    with open_recording(write(tmp_path / "long.log", [{"transforms": [pose(1, n)]} for n in range(200)])) as recording:
        gc.collect()
        before = sum(isinstance(thing, Frame) for thing in gc.get_objects())
        for scene in Player(recording).scenes():
            if scene.frame_id == 150:
                gc.collect()
                held = sum(isinstance(thing, Frame) for thing in gc.get_objects()) - before
        assert held <= 4
