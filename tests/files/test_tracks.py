"""Tracks as CSV."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from carla_recap import RecapWarning, export_csv, open_recording
from tests.replay.scripts import pose, spawn, velocity, write
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


def test_what_was_not_recorded_or_is_not_finite_is_empty_or_left_out_and_names_are_printable(tmp_path):
    frame = {
        "spawned": [spawn(7, 'vehicle.\r\n",', role_name="\x1b[2J"), spawn(8), spawn(9)],
        "transforms": [pose(7, 100), pose(8, 3e38), pose(9, math.nan)],
        "velocities": [velocity(8, math.inf)],
    }
    path = write(tmp_path / "own.log", [frame], additional_data=True)
    with open_recording(path) as recording, pytest.warns(RecapWarning, match="1 of 3 poses are not finite, and left out"):
        export_csv(recording, tmp_path / "own.csv")
    found = rows(tmp_path / "own.csv")
    assert [(row["id"], row["vx"], row["vy"], row["vz"]) for row in found] == [("7", "", "", ""), ("8", "", "", "")]
    assert np.float32(100 * float(found[1]["x"])) == np.float32(3e38)
    assert (found[0]["type_id"] + found[0]["role_name"]).isprintable()
