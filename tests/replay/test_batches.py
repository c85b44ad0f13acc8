"""Batches of scenes are the scenes that playing frame by frame gives."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import RecapWarning, Recording, convert, open_recording
from carla_recap.model.frame import Header
from carla_recap.replay import Player, SceneBatch
from carla_recap.replay.player import LiveScenes
from tests.replay.conftest import Record
from tests.replay.scripts import FRAMES, build, pose, spawn, state, write
from tests.samples import CROSSING, carla_log


def same_scenes(recording: Recording, *, is_live: bool = False, **options: Any) -> list[SceneBatch]:
    """Compare the scenes of batches, and of frames as they come, with those of single frames, and return the batches."""
    expected = [(state(scene), scene.events, scene.fresh) for scene in Player(recording, **options).scenes()]
    if is_live:
        live = LiveScenes()
        found = [live.scene(frame) for frame in recording]
        assert repr([state(scene) for scene in found]) == repr([scene for scene, *_ in expected])
        assert repr([scene.events for scene in found[1:]]) == repr([events for _, events, _ in expected[1:]])
    batches = list(Player(recording, **options).batches())
    scenes = [scene for batch in batches for scene in batch]
    found = [(state(scene), scene.events, scene.fresh) for scene in scenes]
    assert repr(found) == repr(expected)  # NaN is NaN
    return batches


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("name", ["carla-0.9.10-lane-center", "carla-0.9.13-lane-center", "crossing"])
def test_batches_of_real_recordings(name: str, suffix: str, tmp_path: Path) -> None:
    path = CROSSING if name == "crossing" else carla_log(f"{name}.log")
    if suffix == ".mcap":
        convert(path, tmp_path / "real.mcap")
        path = tmp_path / "real.mcap"
    with open_recording(path) as recording:
        batches = same_scenes(recording, start=recording.info.duration / 3, duration=4)
        assert sum(map(len, batches)) > 3 * len(batches)


@given(frames=st.lists(FRAMES, min_size=1, max_size=8), start=st.one_of(st.none(), st.floats(0, 1)))
@pytest.mark.parametrize("kind", [".log", ".mcap"])
def test_batches_of_any_recording(tmp_path_factory: pytest.TempPathFactory, kind: str, frames, start: float | None) -> None:
    repeated = [frame for frame in frames for _ in range(2)]
    path = write(tmp_path_factory.mktemp("any") / f"any{kind}", repeated, tick=0.5)
    with open_recording(path) as recording:
        same_scenes(recording, start=(start or 0) * recording.info.duration, is_live=start is None)


@pytest.mark.parametrize(
    "times", [[0, 1, 1, 2, 3, 3], [0, 2, 1, 3, 4, 5], [5, 5, 5, 5, 5, 5], [0, 1, 2, float("nan"), 4, 5]]
)
def test_frames_of_the_same_time_or_an_earlier_one(tmp_path: Path, times: list[float]) -> None:
    frames = [{"transforms": [pose(1, 100 * n)]} for n in range(6)]
    path = build(tmp_path / "odd.log", Header("Town01", 0), frames, times=times)
    warned = pytest.warns(RecapWarning, match="the clock goes back") if times[2] < times[1] else nullcontext()
    with open_recording(path) as recording, warned:
        same_scenes(recording)


def test_a_batch_ends_where_ids_change(record: Record) -> None:
    ids = [(1, 2)] * 4 + [(2, 1)] * 4 + [(2, 3)] * 4
    recording = record(*({"transforms": [pose(id, id) for id in pair]} for pair in ids))
    batches = same_scenes(recording)
    assert [batch.ids.tolist() for batch in batches if len(batch) > 1] == [[1, 2], [1, 2], [2, 3]]


def test_arrays_of_a_batch(record: Record) -> None:
    frames = [{"transforms": [pose(2), pose(1, 100 * n)], "vehicle_controls": [(1, 0, n / 8, 0, 0, 1)]} for n in range(5)]
    frames[0] |= {"spawned": [spawn(1), spawn(2), spawn(3, x=5), spawn(4, x=10)], "parented": [(4, 1)]}
    batch = next(batch for batch in Player(record(*frames)).batches() if len(batch) > 1)
    assert batch.poses.shape == (len(batch), 2, 6)
    assert batch.records("vehicle_controls")["throttle"].ravel().tolist() == [1 / 8, 2 / 8, 3 / 8]
    assert batch.pose_of(1)[:, 0].tolist() == [100, 200, 300]
    assert batch.pose_of(3)[:, 0].tolist() == [5, 5, 5]
    assert batch.pose_of(4)[:, 0] == pytest.approx([110, 210, 310])
    assert batch.pose_of(5) is None
    with pytest.raises(ValueError, match="read-only"):
        batch.poses[0, 0, 0] = 1
