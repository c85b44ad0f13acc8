"""A time within a microsecond of a frame is that of the frame: CARLA adds up 32-bit steps, users type round numbers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from carla_recap import Player, Recording, Spawn, clip, convert, create_recording, open_recording
from carla_recap.editing.author import packets_of
from carla_recap.formats.carla_log import LogWriter
from carla_recap.model.frame import Frame, Header
from carla_recap.model.records import UE4

STEP = float(np.float32(0.05))  # a bit more than 0.05
TIMES = list(accumulate([STEP] * 500, initial=0.0))
HIT = 242  # the frame of the collision, at 12.10 s as tables print it


@pytest.fixture(params=[".log", ".mcap"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"drive{request.param}"
    with create_recording(path, map_name="Town01") as recorder:
        for number, time in enumerate(TIMES):
            recorder.add_frame(
                time,
                spawned=[Spawn(7, 1, type_id="vehicle.a")] if not number else [],
                collisions=[(0, 7, 8, 1, 0)] if number == HIT else [],
                transforms={"id": [7], "x": [100.0 * number]},
            )
    return path


@pytest.fixture
def recording(path: Path) -> Iterator[Recording]:
    with open_recording(path) as recording:
        yield recording


@pytest.mark.parametrize("time", [0.0, 0.05, 10, 12.1, 24.95])
def test_a_round_time_is_that_of_its_frame(recording: Recording, time: float) -> None:
    number = round(time / 0.05)
    assert TIMES[number] == pytest.approx(time, abs=1e-6)
    for near in (time, TIMES[number], TIMES[number] - 9e-7, TIMES[number] + 9e-7):
        assert recording.frame_at(near).index == number
        assert next(recording.frames(start=near)).index == number
        assert [frame.index for frame in recording.frames(near, near + 0.1)] == list(range(number, min(number + 2, 501)))
    assert recording.frame_at(max(TIMES[number] - 2e-6, 0.0)).index == max(number - 1, 0)
    assert next(recording.frames(start=TIMES[number] + 2e-6)).index == number + 1


def test_a_clip_of_round_times(path: Path, tmp_path: Path) -> None:
    extent = clip(path, tmp_path / "clip.log", start=10, duration=10)
    assert (extent.frames, extent.duration) == (201, pytest.approx(10, abs=1e-6))
    with open_recording(tmp_path / "clip.log") as short:
        assert [frame["transforms"]["x"].tolist() for frame in short][::200] == [[20_000.0], [40_000.0]]


@pytest.mark.parametrize("smooth", [True, False])
def test_a_scene_of_a_round_time(recording: Recording, smooth: bool) -> None:
    player = Player(recording, smooth=smooth)
    for time in (12.1, TIMES[HIT], TIMES[HIT] - 9e-7):
        scene = player.at(time)
        assert (scene.time, scene.frame.index) == (TIMES[HIT], HIT)
        assert [hit.actor1 for hit in scene.collisions] == [7]
        assert scene.poses[0][0] == 100.0 * HIT
        first, *_ = Player(recording, start=time, duration=1, smooth=smooth).scenes()
        assert (first.time, first.frame.index, len(first.collisions)) == (TIMES[HIT], HIT, 1)
    *_, last = Player(recording, start=10, duration=2.1).scenes()
    assert (last.frame.index, len(last.collisions)) == (HIT, 1)


@given(
    clock=st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=1, max_size=8),
    span=st.tuples(st.integers(-1, 7), st.integers(-1, 8)),
)
@example(clock=[(1, True), (5, False), (2, True)], span=(0, 4))  # after a frame at the stop, the clock goes back
@settings(max_examples=40, deadline=None)
def test_a_sparse_read_has_the_frames_of_a_whole_one_that_hold_something(tmp_path_factory, clock, span) -> None:
    folder = tmp_path_factory.mktemp("clock")
    with LogWriter(folder / "a.log", Header("Town01", 0)) as writer:
        for index, (time, hit) in enumerate(clock):
            records = {"collisions": [(0, 7, 8, 1, 0)]} if hit else {}
            writer.write(Frame(index, index + 1, float(time), 1.0, packets_of(UE4, records, additional_data=False)))
    convert(folder / "a.log", folder / "a.mcap")
    for path in (folder / "a.log", folder / "a.mcap"):
        with open_recording(path) as recording:
            whole = [frame for frame in recording.reader.frames(start=span[0], stop=span[1]) if len(frame["collisions"])]
            found = recording.reader.frames(("collisions",), sparse=True, start=span[0], stop=span[1])
            assert [(frame.index, frame.elapsed) for frame in found] == [(frame.index, frame.elapsed) for frame in whole]
