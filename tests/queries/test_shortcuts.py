"""Shortcuts of queries: recordings at random give the same answers without them."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap import create_recording, open_recording
from carla_recap.model.records import UE4
from carla_recap.queries import braking
from carla_recap.queries.blocked import blocked

FRAMES, VEHICLES, TICK = 400, 12, 0.05


@pytest.fixture(params=range(4))
def path(request, tmp_path):
    """A recording of vehicles that stop and go, jump, and are missing in some frames; of some, velocities are recorded."""
    rng = np.random.default_rng(request.param)
    wanted = np.repeat(rng.choice([0.0, 300.0, 1500.0], (FRAMES // 40, VEHICLES)), 40, axis=0)
    speed = np.zeros((FRAMES, VEHICLES))
    for row in range(1, FRAMES):
        speed[row] = speed[row - 1] + np.clip(wanted[row] - speed[row - 1], -900 * TICK, 400 * TICK)
    way = np.cumsum(speed * TICK, axis=0)
    for _ in range(5):
        way[rng.integers(FRAMES) :, rng.integers(VEHICLES)] += rng.choice([300.0, 5000.0, np.nan])
    present = np.ones((FRAMES, VEHICLES), bool)
    if request.param % 2:
        present[:, 6:] = rng.random((FRAMES, VEHICLES - 6)) < 0.9
    ids = np.arange(1, VEHICLES + 1)
    path = tmp_path / "run.log"
    with create_recording(path, map_name="Town01") as recording:
        for row in range(FRAMES):
            there = np.flatnonzero(present[row])
            poses = np.zeros(len(there), UE4.named("transforms").dtype)
            poses["id"], poses["x"] = ids[there], way[row, there]
            measured = there[there < 3]
            velocities = np.zeros(len(measured), UE4.named("velocities").dtype)
            velocities["id"], velocities["x"] = ids[measured], speed[row, measured] / 100
            recording.add_frame(row * TICK, transforms=poses, velocities=velocities)
    return path


def test_no_hard_braking_is_missed(path, monkeypatch):
    with open_recording(path) as recording:
        found = braking.hard_braking(recording.reader, range(1, VEHICLES + 1), 6.0)
        monkeypatch.setattr(braking, "_suspects", lambda poses, *_: poses.ids())
        assert found == braking.hard_braking(recording.reader, range(1, VEHICLES + 1), 6.0)
    assert len(found) > 5


@pytest.mark.parametrize("compat", [False, True])
def test_packets_followed_without_a_group_count_the_same(path, monkeypatch, compat):
    with open_recording(path) as recording:
        found = list(blocked(recording.reader, 0.3, 20.0, compat=compat))
        monkeypatch.setattr("carla_recap.model.stationary._FEW", 0)
        assert found == list(blocked(recording.reader, 0.3, 20.0, compat=compat))
    assert len(found) > 5
