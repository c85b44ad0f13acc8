"""Samples of a replay: complete and without repetition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.queries.measures.series import measures_in_parts
from carla_recap.scene.ahead import NO_LIGHT, stop_points
from carla_recap.scene.follow import followed_series
from carla_recap.show.page import samples
from carla_recap.show.page.samples import BLOCK, measure, sample
from carla_recap.show.page.script import MEASURED_UNITS, Packer, measured_data, recording_data
from tests.replay.scripts import pose, spawn
from tests.samples import CROSSING
from tests.show.page.conftest import data, record, report, sampled, unpack


def test_an_actor_that_stands_still_has_one_row_and_one_that_moves_has_one_track(tmp_path: Path) -> None:
    frames = [{"transforms": [(1, n, 0, 0, 0, 0, 0), (2, 100, 200, 0, 0, 0, 90)]} for n in range(3 * BLOCK)]
    frames[0]["spawned"] = [spawn(1), spawn(2)]
    replay = sampled(record(tmp_path / "a.mcap", frames))
    assert [(track.first, track.last, len(track.rows)) for track in replay.tracks] == [
        (0, 3 * BLOCK - 1, 3 * BLOCK),
        (0, 3 * BLOCK - 1, 1),
    ]
    assert replay.tracks[1].rows.tolist() == [[1, -2, -90, 0]]
    assert replay.tracks[0].rows[:, 0] == pytest.approx(np.arange(3 * BLOCK) / 100, abs=1e-5)


def test_the_first_speed_is_that_of_the_first_step_of_the_recording(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [{"transforms": [(1, n * n, 0, 0, 0, 0, 0)]} for n in range(9)], tick=0.01)
    with open_recording(path) as recording:
        first = recording.trajectory(1).speed[0]
    assert sampled(path).tracks[0].rows[0, 3] == pytest.approx(first)
    assert first == pytest.approx(1)


def test_a_jump_a_gap_and_nan_end_a_track(tmp_path: Path) -> None:
    xs = [0, 10, 20, 90_000, 90_010, float("nan"), 90_020, 90_030, None, 90_040, float("inf"), 3e38]
    frames = [{"transforms": [] if x is None else [(1, x, 0, 0, 0, 0, 0)]} for x in xs]
    replay = sampled(record(tmp_path / "a.log", frames))
    assert [(track.first, track.last) for track in replay.tracks] == [(0, 2), (3, 4), (6, 7), (9, 9)]


def test_the_rate_limits_the_samples() -> None:
    replay = sampled(CROSSING, rate=2.0)
    assert len(replay.times) == pytest.approx(53 * 2, abs=2)
    assert np.diff(replay.times).min() > 0.49


def test_what_is_plotted_is_what_is_measured_elsewhere() -> None:
    with open_recording(CROSSING.with_name("crash.mcap")) as recording:
        replay, whole = sample(recording, [], 0.0, 0.0, None)
        (measured,) = measure(recording, [41], replay.times)
        shown = followed_series(recording, 41, stop_points(recording.reader))
        series = recording.time_series(41)
    assert whole
    assert replay.times == pytest.approx(shown.time)
    expected = {
        "acceleration": shown.acceleration,
        "throttle": shown.pedals[:, 0],
        "brake": shown.pedals[:, 1],
        "steer": shown.controls[:, 2],
        "light": np.where(shown.light == NO_LIGHT, np.nan, shown.light_state),
        "distance": shown.light_distance,
        "gap": series.distance_headway,
        "ttc": series.time_to_collision,
    }
    assert set(measured.values) == set(expected) == set(MEASURED_UNITS)
    for name, values in expected.items():
        assert measured.values[name].tolist() == pytest.approx(values.tolist(), nan_ok=True), name
        assert np.isfinite(values).any(), name
    packer = Packer()
    found = unpack(packer.pack(measured_data(measured, packer)))
    for name, unit in MEASURED_UNITS.items():
        values = np.where(found[name] <= -127, np.nan, found[name])
        known = np.where(np.isfinite(expected[name]), expected[name], np.nan)
        assert values.tolist() == pytest.approx(known.tolist(), abs=0.51 * unit, nan_ok=True), name


def test_the_leaders_of_one_life_stay_when_its_id_is_used_again(tmp_path: Path) -> None:
    frames: list[dict[str, Any]] = []
    for n in range(300):
        at = [(2, n * 50.0 + 2000, 0, 0, 0, 0, 0)]
        at += [(1, n * 50.0, 0, 0, 0, 0, 0)] if n < 150 else [(1, n * 50.0, 50000, 0, 0, 0, 0)] if n >= 200 else []
        frames.append({"transforms": at})
    frames[0]["spawned"], frames[150]["destroyed"], frames[200]["spawned"] = [spawn(1), spawn(2)], [(1,)], [spawn(1)]
    with open_recording(record(tmp_path / "a.mcap", frames)) as recording:
        replay, _ = sample(recording, [], 5, 3, None)
        (measured,) = measure(recording, [1], replay.times)
    first = (replay.times > 0.1) & (replay.times < 7.4)  # s, of its first life
    assert np.all(measured.leader[first] == 2)
    assert np.isfinite(measured.values["gap"][first]).all()


def test_what_is_plotted_is_measured_part_by_part(tmp_path: Path) -> None:
    """So that a long recording takes no more memory than a short one."""
    frames: list[dict[str, Any]] = [{"transforms": [pose(1, x=n * 50.0), pose(2, x=n * 40.0 + 2000)]} for n in range(5000)]
    frames[0]["spawned"] = [spawn(1), spawn(2)]
    with open_recording(record(tmp_path / "a.mcap", frames)) as recording:
        parts = [part[1] for part in measures_in_parts(recording.reader, [1])]
        whole = recording.time_series(1)
        times = whole.time[::7]
        (measured,) = measure(recording, [1], times)
    assert len(parts) > 1
    assert np.concatenate([part.leader for part in parts]).tolist() == whole.leader.tolist()
    assert measured.leader.tolist() == whole.leader[::7].tolist()
    assert measured.values["gap"].tolist() == whole.distance_headway[::7].tolist()


def test_a_long_recording_without_incidents_has_no_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "BUDGET", 0)
    there = {"transforms": [pose(1)]}
    path = record(tmp_path / "a.mcap", [there | {"spawned": [spawn(1, role_name="hero")]}, there, there])
    page = report(path, tmp_path / "page")
    (measured,) = data(page, "recording")["measured"]
    assert (measured["id"], measured["leader"].tolist()) == (1, [])


def test_a_colour_that_is_none_is_no_paint(tmp_path: Path) -> None:
    """As in other viewers, which draw such a vehicle in a colour of theirs."""
    colors = ("255,0,0", "300,0,0", " 1, 2, 3 ")
    frames = [{"transforms": [pose(id) for id in range(3)], "spawned": [spawn(id, color=colors[id]) for id in range(3)]}]
    replay = sampled(record(tmp_path / "x.log", frames))
    paints = [actor["paint"] for actor in recording_data(replay, [], Packer())["actors"]]
    assert paints == ["#ff0000", None, "#010203"]
