"""Shortcuts of queries: recordings at random give the same answers without them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carla_recap import create_recording, open_recording
from carla_recap.model import braking
from carla_recap.model.motion import MOTION
from carla_recap.model.records import UE4, ActorKind, Spawn
from carla_recap.queries.blocked import blocked
from tests.twins.stationary import stationary

FRAMES, VEHICLES, TICK = 400, 12, 0.05


@pytest.fixture(scope="module", params=[0, 1])
def path(request, tmp_path_factory):
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
    path = tmp_path_factory.mktemp("run") / "run.log"
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
    def hard_braking(recording):
        detector = braking.BrakingDetector(range(1, VEHICLES + 1), 6.0)
        for batch in recording.batches(MOTION):
            detector.batch(batch)
        return detector.finish()

    with open_recording(path) as recording:
        found = hard_braking(recording)
        monkeypatch.setattr(braking, "_SURE", -math.inf)  # every vehicle is examined
        assert found == hard_braking(recording)
        monkeypatch.setattr(braking, "_BLOCK", 70)
        monkeypatch.setattr(braking, "_CELLS", 200)
        assert found == hard_braking(recording)
    assert len(found) > 5


def check_blocked(path, min_time, min_distance, compat):
    with open_recording(path) as recording, np.errstate(all="ignore"):
        wanted = stationary(recording.reader, min_time, min_distance, compat=compat)
        rows = blocked(recording.reader, min_time, min_distance, compat=compat)
        found = [(row.start, row.duration, row.id, row.type_id, (row.x, row.y, row.z)) for row in rows]
        wanted, found = ([repr(row) for row in each] for each in (wanted, found))  # NaN is equal to NaN
        assert sorted(found) == sorted(wanted) if compat else found == wanted  # in CARLA's order, with compat
    return wanted


@pytest.mark.parametrize("compat", [False, True])
@pytest.mark.parametrize(("min_time", "min_distance"), [(0.3, 20.0), (4.0, 20.0), (0.3, 1e-18), (0.0, 3.0), (30.0, 1e20)])
def test_frames_together_and_one_by_one_give_the_same_intervals(path, compat, min_time, min_distance):
    check_blocked(path, min_time, min_distance, compat)


@pytest.fixture(scope="module", params=[2, 3])
def busy(request, tmp_path_factory):
    """A recording of vehicles and walkers of any speed that come and go; walkers fall, and some actors are listed twice."""
    rng = np.random.default_rng(request.param)
    present, path, number = {}, tmp_path_factory.mktemp("busy") / "busy.log", 0
    speeds = np.array([0.0, 0.0, 0.003, 0.4, 2.0, 4.9, 7.0, 19.0, 21.0, 70.0, 1e-20, 1e30])
    with create_recording(path, map_name="Town01") as recording:
        for row in range(400):
            change = {}
            if row % 97 == 0 or rng.random() < 0.01:
                number += 1
                kind, name = (ActorKind.WALKER, "walker.a") if number % 2 else (ActorKind.VEHICLE, "vehicle.a")
                change["spawned"] = [Spawn(number, kind, 0, 0, 0, 0, 0, 0, 0, name, [])]
                present[number] = [rng.normal(0, 1000, 3), 0.0, 0.0]
            if len(present) > 5 and rng.random() < 0.01:
                change["destroyed"] = [(int(rng.choice(list(present))),)]
                present.pop(change["destroyed"][0][0])
            for id, state in present.items():
                if rng.random() < (0.03 if id % 3 else 0.003):
                    state[1] = rng.choice(speeds)
                if rng.random() < 0.02:
                    state[2] = rng.choice([0.0, 0.0, 90.0])
                state[0] = state[0] + state[1] * rng.normal(1, 0.1, 3) / math.sqrt(3) * rng.choice([1, 1, 1, 0, -1])
            poses = [(id, *state[0], state[2], 0, 0) for id, state in present.items()]
            if request.param > 2 and rng.random() < 0.05:
                poses.append((poses[0][0], *rng.normal(0, 10, 3), 0, 0, 0))
            change["transforms"] = np.array(poses, UE4.named("transforms").dtype)
            recording.add_frame(row * TICK + (0.0 if row < 200 else 1.0), **change)
    return path


@pytest.mark.parametrize("compat", [False, True])
@pytest.mark.parametrize(("min_time", "min_distance"), [(0.2, 10.0), (3.0, 10.0), (7.0, 10.0), (3.0, 0.0), (0.0, 10.0)])
def test_actors_that_come_and_go(busy, compat, min_time, min_distance):
    found = check_blocked(busy, min_time, min_distance, compat)
    assert found or min_distance == 0.0
