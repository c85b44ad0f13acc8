"""Datasets of many recordings, in worker processes."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest

import carla_recap
from carla_recap.model.records import ActorKind, Spawn
from tests.cli.command import error, run
from tests.sensors.cars import drive

SHORT = ("--rate", "20", "--quality", "low")


@pytest.fixture
def runs(driver: None, tmp_path: Path) -> Path:
    """Return a folder with a recording, the same in a folder below, and one without a hero."""
    folder = tmp_path / "runs"
    (folder / "deep").mkdir(parents=True)
    drive(folder / "a.mcap", 2)
    shutil.copy(folder / "a.mcap", folder / "deep" / "a.mcap")
    with carla_recap.create_recording(folder / "without.mcap", map_name="Brickfield", date=0) as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(1, ActorKind.VEHICLE, type_id="vehicle.audi.tt")])
    camera = {"type": "sensor.camera.rgb", "id": "front", "x": 2, "y": 0, "z": 1.5, "width": 200, "height": 150, "fov": 90}
    (tmp_path / "rig.json").write_text(json.dumps([camera]))
    return folder


def test_recordings_become_one_dataset_but_for_those_that_fail(runs: Path) -> None:
    out = runs.parent / "out"
    options = ("--to", "kitti", "--rig", runs.parent / "rig.json", "--split", "train=0.5,val=0.5", "--jobs", "2", *SHORT)
    done = run("export", runs, out, *options)
    assert done.returncode == 2
    lines = done.stderr.decode().splitlines()
    assert [line for line in lines if "without.mcap" in line and "hero" in line] != []
    assert any(line.startswith(f"wrote {out}: 4 frames, 0.1 s, 2 recordings, ") for line in lines)
    assert lines[-1] == "recordings: 2 done, 0 skipped, 1 failed"
    rows = list(csv.DictReader((out / "recordings.csv").read_text().splitlines()))
    assert [(row["frame"], row["recording"]) for row in rows] == [
        ("000000", "a"),
        ("000001", "a"),
        ("000002", "deep/a"),
        ("000003", "deep/a"),
    ]
    sets = {path.stem: path.read_text().split() for path in (out / "ImageSets").iterdir()}
    assert sorted(sets) == ["train", "val"]
    assert sorted(sets["train"] + sets["val"]) == [row["frame"] for row in rows]
    assert {row["frame"] for row in rows if row["split"] == "val"} == set(sets["val"])
    assert sorted(path.name for path in out.iterdir()) == ["ImageSets", "recordings.csv", "training"]
    assert len(list((out / "training" / "image_2").iterdir())) == 4
    assert [path.name for path in runs.parent.iterdir() if "partial" in path.name] == []
    assert "is not empty" in error("export", runs, out, *options)


@pytest.mark.parametrize("to", ["coco", "nuscenes"])
def test_ids_of_recordings_do_not_meet(runs: Path, to: str) -> None:
    out, sources = runs.parent / "out", (runs / "a.mcap", runs / "deep")
    done = run("export", *sources, out, "--to", to, "--rig", runs.parent / "rig.json", "--jobs", "1", *SHORT)
    assert done.returncode == 2  # both have the name a
    assert f"{runs}/deep/a.mcap: has the same name as {runs}/a.mcap" in done.stderr.decode()
    done = run("export", f"{runs}/**/a.mcap", runs.parent / "both", "--to", to, "--rig", runs.parent / "rig.json", *SHORT)
    assert done.returncode == 0, done.stderr
    files = [*(runs.parent / "both").glob("annotations/*.json"), *(runs.parent / "both").glob("v1.0-carla/sample*.json")]
    for path in files:
        table = json.loads(path.read_text())
        for rows in [table["images"], table["annotations"]] if to == "coco" else [table]:
            ids = [row["id" if to == "coco" else "token"] for row in rows]
            assert len(ids) == len(set(ids)) > 3
    assert len(files) == (1 if to == "coco" else 3)


def test_without_any_part_there_is_no_dataset(runs: Path) -> None:
    done = run("export", "runs/a.mcap", "out", "--to", "coco", "--rig", "rig.json", "--start", "2", cwd=runs.parent)
    assert done.returncode == 2
    assert "no recording could be" in done.stderr.decode()
    assert sorted(path.name for path in runs.parent.iterdir()) == ["rig.json", "runs"]
