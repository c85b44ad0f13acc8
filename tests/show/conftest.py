"""Fixtures for tests of exports: a recording for the viewer, and checks of temporary files."""

from __future__ import annotations

import subprocess
import sys
import tempfile

import pytest

from carla_recap.errors import RecapError
from tests.samples import CROSSING
from tests.waiting import PATIENCE


@pytest.fixture(scope="session")
def crossing_rrd(tmp_path_factory):
    """Six seconds of the crossing, around the collision of the hero; skips the test if the viewer cannot draw."""
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    from carla_recap import export_rerun, open_recording
    from tests.screenshots import ScreenshotTaker

    path = tmp_path_factory.mktemp("rerun") / "crossing.rrd"
    with open_recording(CROSSING) as recording:
        export_rerun(recording, path, start=20, duration=6)
    try:
        with ScreenshotTaker(path):
            pass
    except RecapError as error:
        pytest.skip(str(error))
    return path


PLACE = {"x": 1.5, "y": 0.0, "z": 1.6}
SENSORS = [
    {"type": "sensor.camera.rgb", "id": "front", **PLACE, "width": 160, "height": 120, "fov": 90.0},
    {"type": "sensor.camera.rgb", "id": "back", "x": -2.0, "y": 0.0, "z": 1.6, "yaw": 180.0, "width": 160, "height": 120},
    {"type": "sensor.camera.depth", "id": "depth", **PLACE, "width": 160, "height": 120, "fov": 90.0},
    {"type": "sensor.camera.semantic_segmentation", "id": "tags", **PLACE, "width": 160, "height": 120, "fov": 90.0},
    {"type": "sensor.camera.instance_segmentation", "id": "ids", **PLACE, "width": 160, "height": 120, "fov": 90.0},
    {
        "type": "sensor.lidar.ray_cast",
        "id": "lidar",
        "x": 0.0,
        "y": 0.0,
        "z": 2.5,
        "range": 50.0,
        "rotation_frequency": 20.0,
    },
    {"type": "sensor.other.radar", "id": "radar", "x": 2.4, "y": 0.0, "z": 1.0},
    {"type": "sensor.other.gnss", "id": "gnss"},
    {"type": "sensor.other.imu", "id": "imu"},
]
SENSED = 11.0, 12.5
"""The elapsed seconds between which the recording of `sensed_recording` has data of sensors."""


@pytest.fixture(scope="session")
def sensed_recording(tmp_path_factory):
    """A recording around a crash with what two cameras and others on the hero see; skips the test where none can draw."""
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra `foxglove` is not installed")
    pytest.importorskip("embreex", reason="the extra `cameras` is not installed")
    from tests.sensed import sensed_crash

    try:
        return sensed_crash(tmp_path_factory.mktemp("sensed") / "sensed.mcap", SENSORS, *SENSED)
    except RecapError as error:
        pytest.skip(str(error))


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """An empty folder for temporary files, in which the test must leave none."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    yield folder
    assert list(folder.iterdir()) == []


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
code, *sizes = sys.argv[1:]
for size in map(int, sizes):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        exec(code)
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
"""


def limited(code, *sizes):
    """Run code in a process whose files are limited to a number of bytes, as on a full disk, and then to others.

    Returns:
        The error that it raises with each limit.
    """
    command = [sys.executable, "-B", "-c", LIMITED, code, *map(str, sizes)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()
