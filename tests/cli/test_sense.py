"""The command that writes what sensors would have measured: its output, and what it says about bad input."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.cli.command import CROSSING, run, run_on_full_disk, wrote
from tests.samples import names_in
from tests.waiting import PATIENCE

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
pytest.importorskip("embreex", reason="the extra cameras is not installed")

PLACE = {"x": 0.0, "y": 0.0, "z": 2.0}
LIDAR = {"type": "sensor.lidar.ray_cast", "id": "lidar", **PLACE, "points_per_second": 1000}
IMU = {"type": "sensor.other.imu", "id": "imu"}


@pytest.fixture
def rig(tmp_path: Path) -> Any:
    """Return a function that writes a rig."""

    def write(*sensors: Any) -> Path:
        (tmp_path / "rig.json").write_text(json.dumps(list(sensors)))
        return tmp_path / "rig.json"

    return write


def test_what_was_written_is_said(tmp_path: Path, rig: Any) -> None:
    target = tmp_path / "out.mcap"
    done = run("sense", CROSSING, target, "--rig", rig(IMU), "--start", "10", "--duration", "1", "--json")
    assert json.loads(done.stdout)["written"][0]["samples"] == {"imu": 11}
    assert wrote(done.stderr) == [f"{target}: 11 frames, 1 s, 1 sensor, 11 samples"]
    layout = tmp_path / "out.foxglove.json"
    assert done.stderr.decode().startswith(f"the layout for Foxglove: {layout}\n")
    assert layout.exists()
    assert "Sensor data: imu (sensor.other.imu)" in run("summary", target).stdout.decode()


def test_a_full_disk_is_an_error_of_one_line(tmp_path: Path, rig: Any) -> None:
    target = tmp_path / "out.mcap"
    done = run_on_full_disk(20_000, "sense", CROSSING, target, "--rig", rig(IMU))
    assert done.returncode == 2
    assert f"{target}: cannot be written: File too large" in done.stderr.decode().splitlines()[-1]
    assert b"Traceback" not in done.stderr
    assert names_in(tmp_path) == ["rig.json"]


def test_one_error_names_all_extras_that_are_missing(tmp_path: Path, rig: Any) -> None:
    missing = "import sys; sys.modules |= dict.fromkeys(['foxglove_schemas_protobuf', 'moderngl', 'av'])"
    code = f"{missing}; from carla_recap.cli import main; main()"
    path = rig({"type": "sensor.camera.rgb", "id": "front", **PLACE})
    command = [sys.executable, "-c", code, "sense", CROSSING, tmp_path / "out.mcap", "--rig", path, "--video"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    assert "pip install '.[cameras,foxglove,video]'" in done.stderr
