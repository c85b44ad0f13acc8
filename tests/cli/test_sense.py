"""The command that writes what sensors would have measured: its output, and what it says about bad input."""

from __future__ import annotations

import json
import math
import resource
import signal
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

import carla_recap
from carla_recap import open_recording
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, before_others, error, on_terminal, run, wrote
from tests.samples import names_in
from tests.sensors.test_sensing import HERO, HERO_POSE, LEFT, car_pose, drive, spawn
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from pathlib import Path

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
pytest.importorskip("embreex", reason="the extra cameras is not installed")

PLACE = {"x": 0.0, "y": 0.0, "z": 2.0}
CAMERA = {"type": "sensor.camera.rgb", "id": "front", **PLACE, "width": 64, "height": 48, "fov": 90}
LIDAR = {"type": "sensor.lidar.ray_cast", "id": "lidar", **PLACE, "points_per_second": 1000}
IMU = {"type": "sensor.other.imu", "id": "imu"}
WITHOUT_EGL = "def create_context(**_): raise Exception('libEGL.so.1 not loaded')"


@pytest.fixture
def rig(tmp_path: Path) -> Any:
    """Return a function that writes a rig."""

    def write(*sensors: Any) -> Path:
        (tmp_path / "rig.json").write_text(json.dumps(list(sensors)))
        return tmp_path / "rig.json"

    return write


def test_what_was_written_is_said(tmp_path: Path, rig: Any) -> None:
    target = tmp_path / "out.mcap"
    done = run("sense", CROSSING, target, "--rig", rig(IMU), "--start", "10", "--duration", "1")
    assert (done.returncode, done.stdout) == (0, b""), done.stderr
    assert wrote(done.stderr) == [f"{target}: 11 frames, 1 s, 1 sensor, 11 samples"]
    layout = tmp_path / "out.foxglove.json"
    assert done.stderr.decode().startswith(f"the layout for Foxglove: {layout}\n")
    assert layout.exists()
    assert "Sensor data: imu (sensor.other.imu)" in run("summary", target).stdout.decode()


def test_json_has_the_samples_of_each_sensor(tmp_path: Path, rig: Any) -> None:
    done = run("sense", CROSSING, tmp_path / "out.mcap", "--rig", rig(IMU), "--duration", "1", "--rate", "2", "--json")
    (written,) = json.loads(done.stdout)["written"]
    assert written["samples"] == {"imu": 3}


def test_many_recordings_go_to_a_folder(tmp_path: Path, rig: Any) -> None:
    drive(tmp_path / "cars.mcap")
    done = run("sense", CROSSING, tmp_path / "cars.mcap", f"{tmp_path}/out", "--rig", rig(IMU), "--duration", "0.1")
    assert done.returncode == 0, done.stderr
    for name in ("crossing", "cars"):
        with open_recording(tmp_path / "out" / f"{name}.mcap") as recording:
            assert [sensor.id for sensor in recording.sensors] == ["imu"]


def test_progress_is_shown_on_a_terminal(tmp_path: Path, rig: Any) -> None:
    code, shown, _ = on_terminal("sense", CROSSING, tmp_path / "out.mcap", "--rig", rig(IMU), stream="stderr")
    assert code == 0
    assert "sensing" in shown


# --- rigs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ([{**CAMERA, "fov": 0}], "sensor 'front': fov: 0"),
        ([{**CAMERA, "fov": 180}], "sensor 'front': fov: 180"),
        ([{**CAMERA, "fov": "wide"}], "sensor 'front': fov: \"wide\""),
        ([{**CAMERA, "width": 0}], "sensor 'front': width: 0"),
        ([{**CAMERA, "height": 100_000}], "sensor 'front': height: 100000"),
        ([{**CAMERA, "x": None}], "sensor 'front': x: null"),
        ([{**CAMERA, "x": math.nan}], "sensor 'front': x: nan"),
        ([{key: value for key, value in CAMERA.items() if key != "z"}], "sensor 'front': z"),
        ([{key: value for key, value in CAMERA.items() if key != "type"}], "sensor 'front': type"),
        ([{**CAMERA, "type": "sensor.camera.xray"}], "sensor 'front': type: \"sensor.camera.xray\""),
        ([{**CAMERA, "id": "../evil"}], 'sensor 1: id: "../evil"'),
        ([{**LIDAR, "channels": 10**6}], "sensor 'lidar': channels: 1000000"),
        ([CAMERA, CAMERA], "id"),
        ([{**IMU, "id": f"imu{n}"} for n in range(101)], "101 sensors"),
        ([7], "7"),
        ([], "no sensor"),
    ],
)
def test_a_bad_rig_is_an_error_that_names_the_sensor_and_the_key(
    tmp_path: Path, rig: Any, sensors: Any, message: str
) -> None:
    path = rig(*sensors)
    said = error("sense", CROSSING, tmp_path / "out.mcap", "--rig", path)
    assert said.startswith(f"{path}: ")
    assert message in said
    assert names_in(tmp_path) == ["rig.json"]


def test_a_rig_of_100_sensors_is_sensed(tmp_path: Path, rig: Any) -> None:
    path = rig(*({**IMU, "id": f"imu{n}"} for n in range(100)))
    done = run("sense", CROSSING, tmp_path / "out.mcap", "--rig", path, "--duration", "0.2")
    assert "100 sensors, 300 samples" in done.stderr.decode()


def test_a_missing_rig_is_an_error(tmp_path: Path) -> None:
    said = error("sense", CROSSING, tmp_path / "out.mcap", "--rig", tmp_path / "none.json")
    assert said.startswith(f"{tmp_path / 'none.json'}: ")


# --- recordings ------------------------------------------------------------------------------------------------------


def record(path: Path, *heroes: Any) -> Path:
    """Write a recording with a car, and in each frame a pose of the hero; None: it is destroyed."""
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        there = False
        for frame, pose in enumerate(heroes):
            poses = {LEFT: car_pose(LEFT, 0.0), **({} if pose is None else {HERO: pose})}
            records: dict[str, Any] = {"destroyed": [HERO]} if there and pose is None else {}
            new = [id for id in poses if not frame or (id == HERO and not there)]
            records["spawned"] = [spawn(id, poses[id] if id != HERO else HERO_POSE) for id in new]
            there = pose is not None
            recorder.add_frame(frame * 0.1, transforms=[(id, *each) for id, each in poses.items()], **records)
    return path


def test_a_recording_without_the_hero_is_an_error(tmp_path: Path, rig: Any) -> None:
    source, target = record(tmp_path / "a.mcap", None, None), tmp_path / "out.mcap"
    assert "hero" in error("sense", source, target, "--rig", rig(IMU))
    assert "99" in error("sense", source, target, "--rig", rig(IMU), "--actor", "99")
    assert names_in(tmp_path) == ["a.mcap", "rig.json"]
    assert run("sense", source, target, "--rig", rig(IMU), "--actor", str(LEFT)).returncode == 0


@pytest.mark.parametrize("missing", [None, [math.nan] * 6, [math.inf, 0, 0, 0, 0, 0]])
def test_a_hero_that_dies_or_has_no_pose_is_a_warning(tmp_path: Path, rig: Any, missing: Any) -> None:
    source = record(tmp_path / "a.mcap", HERO_POSE, HERO_POSE, missing, missing)
    target = tmp_path / "out.mcap"
    done = run("sense", source, target, "--rig", rig(IMU, LIDAR))
    assert done.returncode == 0, done.stderr
    said = "the hero is absent, or has no pose, at 2 of 4 moments, first at 0.2 s: nothing is measured then"
    assert f"{source}: {said}" in done.stderr.decode()
    with open_recording(target) as recording:
        assert [sensor.count for sensor in recording.sensors] == [2, 2]


def test_a_map_that_is_not_found_is_a_warning(tmp_path: Path, rig: Any) -> None:
    done = run("sense", CROSSING, tmp_path / "out.mcap", "--rig", rig(LIDAR), "--duration", "0.2")
    assert done.returncode == 0
    assert f"{CROSSING}: the map " in done.stderr.decode()
    assert " is not found: " in done.stderr.decode()


# --- the machine -----------------------------------------------------------------------------------------------------


def sense_without_driver(tmp_path: Path, *sensors: Any) -> subprocess.CompletedProcess[str]:
    folder = tmp_path / "modules"
    folder.mkdir(exist_ok=True)
    (folder / "moderngl.py").write_text(WITHOUT_EGL)
    (tmp_path / "rig.json").write_text(json.dumps(sensors))
    command = [COMMAND, "sense", CROSSING, tmp_path / "out.mcap", "--rig", tmp_path / "rig.json", "--duration", "0.2"]
    environment = {**ENVIRONMENT, "PYTHONPATH": before_others(folder)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False)


def test_without_a_driver_lidars_go_on(tmp_path: Path) -> None:
    done = sense_without_driver(tmp_path, CAMERA, LIDAR)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if "cameras measure nothing: " in line]
    assert len(lines) == 1
    assert "libegl1" in lines[0]
    with open_recording(tmp_path / "out.mcap") as recording:
        assert {sensor.id: sensor.count for sensor in recording.sensors} == {"front": 0, "lidar": 3}


def test_without_a_driver_a_rig_of_cameras_is_an_error(tmp_path: Path) -> None:
    done = sense_without_driver(tmp_path, CAMERA)
    assert done.returncode == 2
    assert "libegl1" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert names_in(tmp_path) == ["modules", "rig.json"]


def test_a_full_disk_is_an_error_of_one_line(tmp_path: Path, rig: Any) -> None:
    """As on a full disk, the file cannot grow."""
    size = 20_000
    path, target = rig(IMU), tmp_path / "out.mcap"

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    done = run("sense", CROSSING, target, "--rig", path, preexec_fn=limited)
    assert done.returncode == 2
    assert f"{target}: cannot be written: File too large" in done.stderr.decode().splitlines()[-1]
    assert b"Traceback" not in done.stderr
    assert names_in(tmp_path) == ["rig.json"]


def test_ctrl_c_leaves_nothing(tmp_path: Path, rig: Any) -> None:
    source = drive(tmp_path / "long.mcap", 3000)
    path, target = rig({**LIDAR, "points_per_second": 2_000_000, "channels": 64}), tmp_path / "out.mcap"
    command = [COMMAND, "sense", source, target, "--rig", path]
    with subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: any(path.name.endswith(".partial") for path in tmp_path.iterdir()))
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "Traceback" not in said
    assert names_in(tmp_path) == ["long.mcap", "rig.json"]
