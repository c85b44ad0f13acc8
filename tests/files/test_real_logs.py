"""A dataset of recordings that CARLA itself has made, and its labels drawn on its images."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the extra `cameras` is not installed")

from PIL import Image

import carla_recap
from carla_recap import RecapError, RecapWarning, SensorRig, export, sense
from tests.files.test_datasets import kitti_calibration, kitti_labels, pixels_of, size_of
from tests.rendering.test_renderer import create
from tests.roads.towns import town
from tests.samples import carla_log
from tests.waiting import PATIENCE

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "samples" / "show_labels.py"
LOGS = {"carla-0.9.13-lane-center": (237, 6.0), "carla-0.9.10-lane-center": (262, 9.0)}
"""The debris by which a rig stands beside the road, and a time at which the hero comes, in s."""
FRAMES = 4
SIZE = (1242, 375)


@pytest.fixture(scope="module")
def roadside() -> SensorRig:
    """The rig of docs/datasets.md."""
    text = (ROOT / "docs" / "datasets.md").read_text("utf-8")
    (block,) = re.findall(r"^```json\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return SensorRig.of(json.loads(block))


@pytest.fixture
def road_map() -> Path:
    """Return the map of the logs; skips the test where it is absent, or nothing can draw."""
    path = town("Town01")
    try:
        create(None).close()
    except RecapError as error:
        pytest.skip(str(error))
    return path


@pytest.mark.parametrize("name", LOGS)
def test_a_rig_beside_the_road_labels_the_hero_of_a_real_log(
    name: str, roadside: SensorRig, road_map: Path, tmp_path: Path
) -> None:
    actor, start = LOGS[name]
    options = {"actor": actor, "start": start, "duration": FRAMES - 1, "rate": 1, "quality": "low", "road_map": road_map}
    camera = roadside["image_2"]
    seen = {"type": "sensor.camera.instance_segmentation", "id": "ids", "yaw": camera.yaw, "fov": camera.number("fov")}
    seen |= {"x": camera.x, "y": camera.y, "z": camera.z, "width": SIZE[0], "height": SIZE[1]}
    with carla_recap.open_recording(carla_log(f"{name}.log")) as recording:
        hero = recording.heroes[0].id
        export(recording, tmp_path / "set", to="kitti", rig=roadside, **options)
        truth = list(sense(recording, SensorRig.of([seen]), **options))
    depths = []
    for index, frame in enumerate(truth):
        ((kind, numbers),) = kitti_labels(tmp_path / "set", index)
        assert kind == "Car"
        assert numbers[3:7] == pytest.approx(pixels_of(frame, hero), abs=2)
        center = kitti_calibration(tmp_path / "set", index)["P2"] @ (*(numbers[10:13] - (0, numbers[7] / 2, 0)), 1)
        assert numbers[3] < center[0] / center[2] < numbers[5]
        assert numbers[4] < center[1] / center[2] < numbers[6]
        depths.append(numbers[12])
    assert len(depths) == FRAMES
    assert np.diff(depths).max() < -1  # it comes
    folder = tmp_path / "set" / "training"
    assert size_of(folder / "image_2" / "000000.png") == SIZE
    assert (folder / "velodyne" / "000000.bin").stat().st_size > 1000
    look_at(tmp_path / "set", f"{FRAMES - 1:06}")


def show_labels(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the script that draws labels."""
    command = [sys.executable, SCRIPT, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def pixels_in(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def look_at(folder: Path, frame: str) -> None:
    """Draw the labels of a frame, and check that the box in the image is white and the image else as it was."""
    picture = folder.with_name(f"{frame}.png")
    done = show_labels(folder, frame, picture)
    assert done.stdout == f"wrote {picture}\n"
    drawn, plain = (pixels_in(path) for path in (picture, folder / "training" / "image_2" / picture.name))
    ((_, numbers),) = kitti_labels(folder, int(frame))
    left, top, right, bottom = np.round(numbers[3:7]).astype(int)
    changed = (drawn != plain).any(axis=2)
    assert changed[top : bottom + 1, left].mean() > 0.9
    rows, columns = np.nonzero(changed)
    size = max(right - left, bottom - top)
    assert columns.min() > left - size - 60
    assert columns.max() < right + size + 60
    assert rows.max() < bottom + size


def test_a_rig_on_the_hero_of_a_real_log_sees_nobody_which_a_warning_says(road_map: Path, tmp_path: Path) -> None:
    rig = SensorRig.load(ROOT / "samples" / "rigs" / "kitti.json")
    options = {"start": 9, "duration": 1, "rate": 1, "quality": "low", "road_map": road_map}
    said = r"0\.9\.13-lane-center\.log: no other road user is seen in any image"
    with (
        carla_recap.open_recording(carla_log("carla-0.9.13-lane-center.log")) as recording,
        pytest.warns(RecapWarning, match=said),
    ):
        export(recording, tmp_path / "set", to="kitti", rig=rig, **options)
    assert kitti_labels(tmp_path / "set", 0) == []


def test_labels_of_a_frame_that_is_not_there_are_an_error(tmp_path: Path) -> None:
    done = show_labels(tmp_path, "000000")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("show_labels.py: ")
    assert "000000.png" in line
