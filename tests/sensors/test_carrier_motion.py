"""The motion of carriers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import carla_recap
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.sensors.carrier_motion import CarrierMotion

if TYPE_CHECKING:
    from pathlib import Path

UNEVEN = np.cumsum([0.0, *([0.02, 0.05, 0.03] * 10)])  # s


def drive(path: Path, times: np.ndarray, forward: np.ndarray, **records: Any) -> Path:
    """Write a recording of an actor that moves along x, given in m."""
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        for index, (time, x) in enumerate(zip(times.tolist(), forward.tolist(), strict=True)):
            further = {"spawned": [Spawn(1, ActorKind.VEHICLE)]} if not index else {}
            further |= {name: [values[index]] for name, values in records.items()}
            recorder.add_frame(time, transforms=[(1, 100 * x, 0, 0, 0, 0, 0)], **further)
    return path


def test_a_constant_acceleration_in_uneven_frames(tmp_path: Path) -> None:
    path = drive(tmp_path / "uneven.mcap", UNEVEN, UNEVEN**2)
    with carla_recap.open_recording(path) as recording:
        motion = CarrierMotion(recording, 1)
    for time in UNEVEN[3:]:
        assert motion.at(time).acceleration == pytest.approx((2, 0, 0), abs=0.01)
        assert motion.at(time).velocity[0] == pytest.approx(2 * time, abs=0.06)


def test_velocities_that_are_recorded_count_more_than_steps(tmp_path: Path) -> None:
    velocities = [(1, 3.0 * time, 4.0, 0.0, 0.0, 0.0, 90.0) for time in UNEVEN]
    path = drive(tmp_path / "recorded.mcap", UNEVEN, UNEVEN**2 + 1e3 * (np.arange(len(UNEVEN)) >= 20), velocities=velocities)
    with carla_recap.open_recording(path) as recording:
        carrier = CarrierMotion(recording, 1)
    motion = carrier.at((UNEVEN[10] + UNEVEN[11]) / 2)
    assert motion.velocity == pytest.approx((1.5 * (UNEVEN[10] + UNEVEN[11]), -4, 0))  # y counts to the left
    assert motion.acceleration == pytest.approx((3, 0, 0), abs=1e-4)
    assert motion.rotation == pytest.approx((0, 0, -90))
    assert carrier.at(UNEVEN[20]).velocity == pytest.approx((3 * UNEVEN[20], -4, 0))  # after a jump


def test_from_one_life_of_an_id_to_the_next_is_no_motion(tmp_path: Path) -> None:
    path = tmp_path / "lives.mcap"
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        for index in range(12):
            spawned = {"spawned": [Spawn(1, ActorKind.VEHICLE)]} if index in (0, 6, 9) else {}
            place = {} if index == 5 else {"transforms": [(1, 400.0 * (index >= 6) + 400.0 * (index >= 9), 0, 0, 0, 0, 0)]}
            recorder.add_frame(0.1 * index, **spawned, **place, destroyed=[(1,)] if index == 5 else [])
    with carla_recap.open_recording(path) as recording:
        motion = CarrierMotion(recording, 1)
    for time in np.linspace(0, 1.1, 50):
        assert [part.tolist() for part in motion.at(time)] == [[0, 0, 0]] * 4


def test_numbers_that_are_none(tmp_path: Path) -> None:
    times = np.arange(6) * 0.05
    forward = np.array((0.0, 0.1, np.nan, np.inf, 0.4, 0.5))
    velocities = [(1, np.nan, np.inf, 0, 0, 0, 0)] * 6
    path = drive(tmp_path / "none.mcap", times, forward, velocities=velocities)
    with carla_recap.open_recording(path) as recording:
        motion = CarrierMotion(recording, 1)
        absent = CarrierMotion(recording, 2)
    for time in times:
        assert all(np.isfinite(part).all() for part in motion.at(time))
        assert [part.tolist() for part in absent.at(time)] == [[0, 0, 0]] * 4
    assert motion.at(0.25).velocity == pytest.approx((2, 0, 0), abs=1e-3)
