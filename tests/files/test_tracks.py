"""Tracks as CSV."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from carla_recap import export_csv, open_recording
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
