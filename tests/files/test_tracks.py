"""Tracks as CSV."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from carla_recap import RecapWarning, Spawn, create_recording, export_csv, open_recording
from tests.samples import CRASH


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_has_pose_velocity_and_size(tmp_path):
    with open_recording(CRASH) as recording:
        (hero,) = recording.heroes
        played = export_csv(recording, tmp_path / "crash.csv")
        path = recording.trajectory(hero.id)
    assert played.frames == 1200
    found = [row for row in rows(tmp_path / "crash.csv") if row["id"] == str(hero.id)]
    assert found[0]["role_name"] == "hero"
    for name in ("time", "x", "y", "z", "yaw", "vx", "vy"):
        assert np.allclose([float(row[name]) for row in found], getattr(path, name))
    assert float(found[0]["length"]) == pytest.approx(2 * hero.bounding_box.extent_x)


def test_velocities_that_were_not_recorded_are_empty(tmp_path):
    with create_recording(tmp_path / "own.log", map_name="") as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(7, 1, type_id="vehicle.a")], transforms=[(7, 0, 0, 0, 0, 0, 0)])
    with open_recording(tmp_path / "own.log") as recording:
        export_csv(recording, tmp_path / "own.csv")
    assert rows(tmp_path / "own.csv")[0]["vx"] == ""


def test_names_are_printable_and_poses_finite(tmp_path):
    with create_recording(tmp_path / "own.log", map_name="") as recorder:
        poses = [(7, 0, 0, 0, 0, 0, 0), (8, float("nan"), 0, 0, 0, 0, 0)]
        spawns = [Spawn(7, 1, type_id='vehicle.\r\n",'), Spawn(8, 1, type_id="vehicle.b")]
        recorder.add_frame(0.0, spawned=spawns, transforms=poses)
    with open_recording(tmp_path / "own.log") as recording, pytest.warns(RecapWarning, match="1 of 2 poses are not finite"):
        export_csv(recording, tmp_path / "own.csv")
    (row,) = rows(tmp_path / "own.csv")
    assert (row["id"], row["type_id"].isprintable()) == ("7", True)
