"""What is to be seen in scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import Player, open_recording
from carla_recap.scene.description import SceneDescriber, SceneDescription
from tests.replay.scripts import pose, spawn, write

CAR, SENSOR, BIN, MOUNTED = 1, 2, 3, 4


def described(folder: Path, frames: list[dict[str, Any]]) -> SceneDescription:
    """Return the description of all frames but the first one, in which the actors appear, as one batch."""
    describer = SceneDescriber()
    with open_recording(write(folder / "in.log", [*frames, frames[-1]])) as recording:
        _, between, _ = (describer.describe(batch) for batch in Player(recording).batches())
        return between


@pytest.fixture
def description(tmp_path: Path) -> SceneDescription:
    """A car that drives, a sensor with recorded poses, a bin that stands, and a prop that is mounted on the car."""
    frames: list[dict[str, Any]] = [{"transforms": [pose(CAR, 100 * n, 50), pose(SENSOR, 100 * n)]} for n in range(-1, 2)]
    frames[0]["spawned"] = [
        spawn(CAR),
        spawn(SENSOR, "sensor.camera.rgb"),
        spawn(BIN, "static.prop.bin", x=500),
        spawn(MOUNTED, "static.prop.box01", x=20),
    ]
    frames[0]["parented"] = [(MOUNTED, CAR)]
    return described(tmp_path, frames)


def test_poses_are_in_metres_and_right_handed(description: SceneDescription) -> None:
    assert description.ids.tolist() == [CAR, BIN, MOUNTED]
    car, standing, mounted = np.moveaxis(description.poses[..., :3], 1, 0)
    assert car.tolist() == [[0, -0.5, 0], [1, -0.5, 0]]
    assert standing.tolist() == [[5, 0, 0]] * 2
    assert mounted == pytest.approx(car + np.array((0.2, 0, 0)))
    assert description.shown.all()


def test_recorded_poses_are_those_of_all_actors(description: SceneDescription) -> None:
    assert description.batch.ids.tolist() == [CAR, SENSOR]
    assert description.recorded_poses[:, 0].tolist() == description.poses[:, 0].tolist()
    assert description.recorded_poses[:, 1, 0].tolist() == [0, 1]
    assert description.recorded_shown.all()


def test_the_pose_of_an_actor(description: SceneDescription) -> None:
    for row, id in enumerate(description.ids.tolist()):
        assert description.pose_of(id, 1) == pytest.approx(description.poses[1, row])
    assert description.pose_of(SENSOR, 1) == pytest.approx((1, 0, 0, 0, 0, 0))
    assert description.pose_of(99, 0) is None


def test_what_is_nowhere_is_not_shown(tmp_path: Path) -> None:
    places = [0.0, 100.0, np.nan, 1e12]
    frames: list[dict[str, Any]] = [{"transforms": [pose(CAR, x), pose(SENSOR, x)]} for x in places]
    frames[0]["spawned"] = [spawn(CAR), spawn(SENSOR, "sensor.camera.rgb")]
    found = described(tmp_path, frames)
    assert found.shown.tolist() == [[True], [False], [False]]
    assert found.recorded_shown.tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert found.pose_of(CAR, 1) is None
