"""Datasets of many recordings from Python."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import carla_recap
from carla_recap import RecapError, SensorRig, export_dataset
from carla_recap.fleet.datasets import splits_of
from tests.sensors.cars import STEP, drive

if TYPE_CHECKING:
    from pathlib import Path

RIG = SensorRig.of(
    [{"type": "sensor.camera.rgb", "id": "front", "x": 2, "y": 0, "z": 1.5, "width": 64, "height": 48, "fov": 90}]
)


def test_recordings_become_one_dataset_but_for_those_that_fail(driver: None, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    for name in ("a", "b"):
        drive(tmp_path / "runs" / f"{name}.mcap", 2)
    (tmp_path / "runs" / "broken.log").write_bytes(b"no recording")
    options = {"to": "coco", "rig": RIG, "rate": 1 / STEP, "quality": "low", "split": {"val": 1.0}, "jobs": 2}
    done = export_dataset(tmp_path / "runs", tmp_path / "out", **options)
    assert (done.frames, done.seconds) == (4, pytest.approx(2 * STEP))
    assert done.recordings == tuple(str(tmp_path / "runs" / f"{name}.mcap") for name in ("a", "b"))
    assert list(done.failed) == [str(tmp_path / "runs" / "broken.log")]
    assert "is not a recording" in done.failed[str(tmp_path / "runs" / "broken.log")]
    images = json.loads((tmp_path / "out" / "annotations" / "instances_val.json").read_text())["images"]
    assert [image["recording"] for image in images] == ["a", "a", "b", "b"]
    with pytest.raises(RecapError, match="out: is not empty"):
        export_dataset(tmp_path / "runs", tmp_path / "out", **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"to": "csv"}, "'csv' is no format of datasets; one of kitti, coco, nuscenes was expected"),
        ({"to": "kitti", "camera": "side"}, "rig: has no RGB camera 'side'; one of front was expected"),
        ({"to": "kitti", "split": {"best": 1.0}}, "split 'best': is unknown; one of train, val, test was expected"),
        ({"to": "kitti", "split": {"train": 0.5}}, "the shares of the splits add up to 0.5; 1 was expected"),
        ({"to": "kitti", "rate": -1.0}, "a rate of -1 per second; a number above 0 was expected"),
        ({"to": "kitti", "rig": "missing.json"}, "missing.json: cannot be read: No such file or directory"),
    ],
)
def test_what_is_no_dataset(tmp_path: Path, options: dict[str, object], message: str) -> None:
    drive(tmp_path / "a.mcap", 2)
    with pytest.raises(RecapError, match=message):
        carla_recap.export_dataset(tmp_path / "a.mcap", tmp_path / "out", **{"rig": RIG, **options})
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_splits_depend_on_names_alone() -> None:
    names = [f"run{number}" for number in range(20)]
    splits = splits_of(names, {"train": 0.7, "val": 0.2, "test": 0.1})
    assert splits == splits_of(reversed(names), {"train": 0.7, "val": 0.2, "test": 0.1})
    assert sorted(splits) == sorted(names)
    assert [list(splits.values()).count(name) for name in ("train", "val", "test")] == [14, 4, 2]
    with pytest.raises(RecapError, match=r"split 'val': a share of -1; one from 0 to 1 was expected"):
        splits_of(names, {"train": 2 - 1, "val": -1})
