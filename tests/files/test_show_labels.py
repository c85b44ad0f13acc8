"""Labels of a dataset drawn on its images, and what docs/datasets.md says of a recording that CARLA itself has made."""

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
from carla_recap import SensorRig, export
from tests.files.readers import kitti_labels, size_of
from tests.roads.towns import town
from tests.samples import ROOT, carla_log
from tests.waiting import PATIENCE

SCRIPT = ROOT / "samples" / "show_labels.py"
KITTI = ROOT / "samples" / "rigs" / "kitti.json"
PART = {"duration": 1, "rate": 1, "quality": "low"}

pytestmark = pytest.mark.usefixtures("driver")


def show_labels(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the script that draws labels."""
    command = [sys.executable, SCRIPT, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def pixels_in(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_boxes_are_drawn_around_road_users_and_nowhere_else(tmp_path: Path) -> None:
    with carla_recap.open_recording(ROOT / "samples" / "crash.mcap") as recording:
        export(recording, tmp_path / "set", to="kitti", rig=KITTI, start=14, **PART)
    image, picture = tmp_path / "set" / "training" / "image_2" / "000001.png", tmp_path / "labels.png"
    done = show_labels(tmp_path / "set", "000001", picture)
    assert (done.returncode, done.stdout) == (0, f"wrote {picture}\n"), done.stderr
    assert size_of(image) == size_of(picture) == (1242, 375)
    changed = (pixels_in(image) != pixels_in(picture)).any(axis=2)
    (van,) = (numbers[3:7] for kind, numbers in kitti_labels(tmp_path / "set", 1) if kind == "Van")
    left, top, right, bottom = np.round(van).astype(int)
    for side in (left, right):  # to the pixel
        assert changed[top:bottom, side - 1 : side + 2].any(axis=1).mean() > 0.9
    assert not changed[:, : left - (right - left)].any()
    assert not changed[bottom + (bottom - top) :].any()


def test_labels_of_a_frame_that_is_not_there_are_an_error(tmp_path: Path) -> None:
    done = show_labels(tmp_path, "000000")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("show_labels.py: ")
    assert "000000.png" in line


def test_the_rig_beside_the_road_sees_the_hero_come(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "datasets.md").read_text("utf-8")
    (block,) = re.findall(r"^```json\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    options = PART | {"start": 6, "duration": 4, "road_map": town("Town01"), "actor": 237}
    with carla_recap.open_recording(carla_log("carla-0.9.13-lane-center.log")) as recording:
        export(recording, tmp_path / "set", to="kitti", rig=SensorRig.of(json.loads(block)), **options)
    labels = [kitti_labels(tmp_path / "set", index) for index in range(5)]
    assert [[kind for kind, _ in found] for found in labels] == [["Car"]] * 5
    distances = [found[0][1][12] for found in labels]
    assert np.diff(distances).max() < -5
    assert distances[-1] < 30
