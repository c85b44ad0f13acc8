"""CARLA's own recordings, and the sample of a crossing, replayed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from carla_recap import Recording, convert, open_recording
from carla_recap.model.frame import Header
from carla_recap.replay import Player
from tests.replay.scripts import build, pose, spawn, velocity, x_of
from tests.samples import CROSSING, carla_log

NAMES = ("carla-0.9.10-lane-center", "carla-0.9.13-lane-center", "crossing")


@pytest.fixture(params=NAMES)
def recording(request: pytest.FixtureRequest, tmp_path: Path, suffix: str) -> Iterator[Recording]:
    log = CROSSING if request.param == "crossing" else carla_log(f"{request.param}.log")
    path = log
    if suffix == ".mcap":
        path = tmp_path / "real.mcap"
        convert(log, path)
    with open_recording(path) as opened:
        yield opened


def test_the_hero_follows_its_trajectory(recording: Recording) -> None:
    player = Player(recording)
    hero = player.followed
    assert hero is not None
    assert recording.actors[hero].is_hero
    way = recording.trajectory(hero, axes="carla")
    seen = 0
    for scene in player.scenes(rate=17):
        if not way.time[0] <= scene.time <= way.time[-1]:
            continue
        place = scene.pose_of(hero)
        assert place is not None
        expected = [np.interp(scene.time, way.time, column) * 100 for column in (way.x, way.y, way.z)]
        assert place[:3] == pytest.approx(expected, abs=1e-3)
        yaw = np.interp(scene.time, way.time, np.unwrap(way.yaw, period=360))
        assert abs(np.exp(1j * np.radians(place[5])) - np.exp(1j * np.radians(yaw))) < 1e-6
        seen += 1
    assert seen > 100


def test_double_precision(tmp_path: Path, suffix: str) -> None:
    far = 1e9 + 0.001
    frames = [
        {"spawned": [spawn(1)], "transforms": [pose(1, far), pose(2)], "velocities": [velocity(1, 9)]},
        {"transforms": [pose(1, far + 1000), pose(2, 100)]},
        {},
    ]
    with open_recording(build(tmp_path / f"ue5{suffix}", Header("Town10", 0, wide=True), frames)) as recording:
        scene = Player(recording).at(0.5)
        assert scene.poses[:, 0].tolist() == [far + 500, 50]
        assert scene.velocities["x"].tolist() == [9]
        last = Player(recording).at(2.0)
        assert (last.ids.tolist(), last.poses[:, 0].tolist()) == ([1], [far + 1000])


def test_packets_before_the_first_frame(tmp_path: Path, suffix: str) -> None:
    frames = [{"spawned": [spawn(1)]}, {"transforms": [pose(1)]}, {"transforms": [pose(1, 100)]}]
    with open_recording(build(tmp_path / f"early{suffix}", Header("Town01", 0), frames, preamble=True)) as recording:
        scenes = list(Player(recording).scenes(rate=2))
        assert [x_of(scene) for scene in scenes] == [0, 50, 100]
        assert [event.actor.id for scene in scenes for event in scene.spawned] == [1]
