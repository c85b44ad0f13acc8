"""The process that casts the rays of lidars and radars."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import MissingExtra, RecapWarning
from carla_recap.sensors.ray_process import RayMoment, RayProcess, RaySetup
from carla_recap.sensors.ray_sensors import RaySensors
from carla_recap.sensors.rig import SensorRig
from carla_recap.util.child import ChildEnded
from tests.rendering.shapes import PLANE, boxes
from tests.sensors.cars import drive

if TYPE_CHECKING:
    from pathlib import Path

BOXES = boxes((10, 0, 2), (15, 4, 1))
PLACE = {"x": 0.0, "y": 0.0, "z": 2.0}
RIG = SensorRig.of(
    [
        {"type": "sensor.lidar.ray_cast", "id": "lidar", **PLACE, "points_per_second": 20_000, "range": 50.0},
        {"type": "sensor.lidar.ray_cast_semantic", "id": "tags", **PLACE, "points_per_second": 20_000, "range": 50.0},
        {"type": "sensor.other.radar", "id": "radar", **PLACE},
    ]
)
VELOCITY = np.array((5.0, 1.0, 0.0))  # m/s


def moment() -> RayMoment:
    """Return a moment 2 m above a plane, with two boxes ahead, that moves."""
    pose = np.array((0.0, 0.0, 2.0, 0.0, 0.0, 0.0))
    due = [(spec.id, pose) for spec in RIG]
    return RayMoment(due, 0.05, BOXES, BOXES.ids, np.zeros((len(BOXES), 3)), VELOCITY)


def measured(count: int = 3) -> list[dict[str, bytes]]:
    """Return what the sensors measure in this process at some moments."""
    sensors = RaySensors(RaySetup(PLANE.tiles, (), tuple(RIG)))
    return [{id: points.tobytes() for id, points in sensors.begin(moment())()[0].items()} for _ in range(count)]


def test_the_process_measures_as_the_sensors_do() -> None:
    pytest.importorskip("embreex")
    process = RayProcess(PLANE.tiles, tuple(RIG))
    process.wait()
    for _ in range(3):
        process.begin(moment())
    found = [process.points() for _ in range(3)]  # stays as it is when others come
    process.close()
    assert [{id: points.tobytes() for id, points in each.items()} for each in found] == measured()
    assert all(len(points) > 10 for each in found for points in each.values())
    radar = found[0]["radar"]
    rays = np.stack((np.cos(radar["azimuth"]), np.sin(radar["azimuth"])), axis=1) * np.cos(radar["altitude"])[:, None]
    assert radar["velocity"] == pytest.approx(-rays @ VELOCITY[:2], abs=1e-4)  # what stands still comes nearer


@pytest.mark.parametrize("rays", [7, 1000])
def test_rays_that_are_cast_in_parts_hit_the_same(monkeypatch: pytest.MonkeyPatch, rays: int) -> None:
    pytest.importorskip("embreex")
    whole = measured()
    monkeypatch.setattr("carla_recap.sensors.ray_sensors._RAYS_OF_A_PART", rays)
    assert measured() == whole


def test_a_process_that_is_killed_is_an_error() -> None:
    pytest.importorskip("embreex")
    process = RayProcess(PLANE.tiles, tuple(RIG))
    process.wait()
    os.kill(process.pid, signal.SIGKILL)
    process.begin(moment())
    with pytest.raises(ChildEnded, match="casts rays has ended with exit code -9"):
        process.points()
    process.close()


def test_missing_embree_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "embreex.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(str(tmp_path))
    process = RayProcess(PLANE.tiles, tuple(RIG))
    with pytest.raises(MissingExtra, match="cameras"):
        process.wait()
    process.close()


def test_too_many_rays_are_a_warning_of_the_caller(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    rig = SensorRig.of([{"type": "sensor.lidar.ray_cast", "id": "top", **PLACE, "points_per_second": 10_000_000}])
    said = pytest.warns(RecapWarning, match=r"sensor 'top': points_per_second is 10000000: of \d+ rays in a frame, 200000")
    with carla_recap.open_recording(drive(tmp_path / "cars.mcap", 1)) as recording, said:
        (frame,) = carla_recap.sense(recording, rig)
    assert len(frame.samples["top"].data)
