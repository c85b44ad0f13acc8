"""Datasets of many recordings from Python."""

from __future__ import annotations

from pathlib import Path

import pytest

import carla_recap
from carla_recap import RecapError, SensorRig
from carla_recap.fleet.datasets import splits_of
from tests.sensors.cars import drive

RIG = SensorRig.of(
    [{"type": "sensor.camera.rgb", "id": "front", "x": 2, "y": 0, "z": 1.5, "width": 64, "height": 48, "fov": 90}]
)


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
