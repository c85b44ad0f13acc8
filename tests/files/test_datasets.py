"""Datasets of a hero with a car ahead and one on each side, the left one higher, read back by the usual readers."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
from carla_recap import RecapError, RecapWarning, SensorRig, export
from carla_recap.files import nuscenes
from carla_recap.files.coco import encoded
from carla_recap.files.nuscenes import TABLES, VERSION
from carla_recap.sensors.ray_sensors import DETECTION
from carla_recap.sensors.sensing import Sample, SensedFrame, sense
from tests.files.readers import kitti_calibration, kitti_labels, size_of
from tests.samples import ROOT
from tests.sensors.cars import AHEAD, BOX, CAMERA_HEIGHT, CARS, GAP, LEFT, RAISED, RIGHT, SPEED, STEP, drive
from tests.waiting import PATIENCE

DEVKIT = ROOT / "build" / "nuscenes" / "bin" / "python"
PLACE = {"x": 2.0, "y": 0.0, "z": CAMERA_HEIGHT}
CAMERA = {**PLACE, "width": 800, "height": 600, "fov": 90.0}
EXACT = {"dropoff_general_rate": 0.0, "dropoff_zero_intensity": 0.0}
RAYS = {"range": 50.0, "channels": 64, "points_per_second": 1_000_000, "rotation_frequency": 10.0, "lower_fov": -20.0}
RIG = SensorRig.of(
    [
        {"type": "sensor.camera.rgb", "id": "front", **CAMERA},
        {"type": "sensor.camera.rgb", "id": "back", **CAMERA, "yaw": 180.0, "width": 400, "height": 300},
        {"type": "sensor.lidar.ray_cast", "id": "top", **PLACE, "yaw": 10.0, **RAYS, **EXACT},
        {"type": "sensor.other.radar", "id": "radar", **PLACE, "points_per_second": 20_000, "horizontal_fov": 90.0},
    ]
)
TRUTH = SensorRig.of([{"type": "sensor.camera.instance_segmentation", "id": "ids", **CAMERA}])
RATE = 1 / STEP
SIDES = {AHEAD: 0, LEFT: -1, RIGHT: 1}  # where in an image a car is: to the right of the middle is positive
WITHIN = 2.0  # pixels
MATRIX = np.array(((400.0, 0.0, 400.0), (0.0, 400.0, 300.0), (0.0, 0.0, 1.0)))  # of the camera: from m to pixels
NEAR = 0.05  # m


@pytest.fixture(scope="module")
def recording(driver: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("datasets") / "cars.mcap", raised=LEFT)


@pytest.fixture(scope="module")
def truth(recording: Path) -> list[SensedFrame]:
    """Return the pixels of the cars."""
    with carla_recap.open_recording(recording) as source:
        return list(sense(source, TRUTH, rate=RATE, quality="low"))


def written(recording: Path, to: str, **options: Any) -> Path:
    folder = recording.with_name(to)
    if not folder.exists():
        with carla_recap.open_recording(recording) as source:
            done = export(source, folder, to=to, rig=RIG, rate=RATE, quality="low", **options)
        assert done.frames == 3
        assert sorted(done.files or ()) == sorted(path for path in folder.rglob("*") if path.is_file())
    return folder


def pixels_of(frame: SensedFrame, id: int) -> np.ndarray:
    """Return the box of an actor's pixels: left, top, right, bottom."""
    rows, columns = np.nonzero(frame.samples["ids"].data == id)
    return np.array((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))


def gap(index: int) -> float:
    return GAP + SPEED * STEP * index


def side_of(box: np.ndarray) -> int:
    """Return on which side of the middle of an image a box is."""
    return 0 if box[0] < CAMERA["width"] / 2 < box[2] else int(np.sign(box[0] - CAMERA["width"] / 2))


# --- KITTI -----------------------------------------------------------------------------------------------------


def test_labels_of_kitti_are_where_pixels_and_points_are(recording: Path, truth: list[SensedFrame]) -> None:
    folder = written(recording, "kitti")
    assert (folder / "ImageSets" / "train.txt").read_text() == "000000\n000001\n000002\n"
    for index, frame in enumerate(truth):
        labels = kitti_labels(folder, index)
        assert [name for name, _ in labels] == ["Car", "Car", "Van"]  # the car ahead is an ambulance
        by_side = {side_of(numbers[3:7]): numbers for _, numbers in labels}
        matrices = kitti_calibration(folder, index)
        points = np.fromfile(folder / "training" / "velodyne" / f"{index:06}.bin", np.float32).reshape(-1, 4)
        assert points[:, 3].min() >= 0
        assert points[:, 3].max() <= 1
        camera = points[:, :3] @ matrices["Tr_velo_to_cam"][:, :3].T + matrices["Tr_velo_to_cam"][:, 3]
        for id, side in SIDES.items():
            truncated, occluded, alpha, *box = by_side[side][:7]
            height, width, length, x, y, z, rotation = by_side[side][7:]
            assert np.abs(np.array(box) - pixels_of(frame, id)).max() <= WITHIN
            assert (truncated, occluded) == (0, 0)
            assert (length, width, height) == pytest.approx((2 * BOX[3] / 100, 2 * BOX[4] / 100, 2 * BOX[5] / 100), abs=0.01)
            assert y == pytest.approx(CAMERA_HEIGHT - RAISED * (id == LEFT), abs=0.01)  # of the bottom, downwards
            assert np.sign(round(x, 1)) == side
            assert rotation == pytest.approx(-math.pi / 2, abs=0.01)  # heading away
            assert alpha == pytest.approx(rotation - math.atan2(x, z), abs=0.011)
            own = camera[
                (np.abs(camera - (x, y - height / 2, z)) < (width / 2 + 0.02, height / 2 - 0.02, length / 2 + 0.02)).all(1)
            ]
            assert len(own) > 20
            assert own[:, 1].min() == pytest.approx(y - height, abs=0.4)  # of a roof, whose slope few rays meet
            if id == AHEAD:
                assert (x, z - length / 2) == pytest.approx((0, gap(index)), abs=NEAR)
                assert own[:, 2].min() == pytest.approx(gap(index), abs=NEAR)
            pixels = own @ matrices["P2"][:, :3].T
            columns, rows = (pixels[:, :2] / pixels[:, 2:]).astype(int).T
            hit = frame.samples["ids"].data[rows, columns] == id
            assert hit.mean() > 0.9  # all but some at the edges


def test_images_of_kitti_are_those_of_the_camera(recording: Path) -> None:
    folder = written(recording, "kitti")
    assert size_of(folder / "training" / "image_2" / "000002.png") == (800, 600)
    rows = list(csv.DictReader((folder / "recordings.csv").read_text().splitlines()))
    assert [(row["frame"], row["recording"], float(row["time"])) for row in rows] == [
        (f"{index:06}", "cars", pytest.approx(index * STEP)) for index in range(3)
    ]


def test_another_camera_of_kitti(recording: Path, tmp_path: Path) -> None:
    with carla_recap.open_recording(recording) as source:
        with pytest.warns(RecapWarning, match=r"cars\.mcap: no other road user is seen in any image"):
            export(source, tmp_path / "out", to="kitti", rig=RIG, rate=RATE, duration=STEP, quality="low", camera="back")
        assert size_of(tmp_path / "out" / "training" / "image_2" / "000001.png") == (400, 300)
        assert kitti_labels(tmp_path / "out", 0) == []
        with pytest.raises(RecapError, match="rig: has no RGB camera 'side'; one of front, back was expected"):
            export(source, tmp_path / "other", to="kitti", rig=RIG, camera="side")
    assert not (tmp_path / "other").exists()


# --- COCO ------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
def test_boxes_and_masks_of_coco_are_those_of_the_pixels(recording: Path, truth: list[SensedFrame]) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    folder = written(recording, "coco")
    with contextlib.redirect_stdout(io.StringIO()):
        data = coco.COCO(folder / "annotations" / "instances_train.json")
    images = [image for image in data.imgs.values() if image["camera"] == "front"]
    assert [image["time"] for image in images] == pytest.approx([0, STEP, 2 * STEP])
    assert len(data.imgs) == 6
    for image, frame in zip(images, truth, strict=True):
        assert size_of(folder / "images" / image["file_name"]) == (image["width"], image["height"]) == (800, 600)
        annotations = {row["actor"]: row for row in data.loadAnns(data.getAnnIds(image["id"]))}
        assert annotations.keys() == CARS.keys()
        for id, row in annotations.items():
            assert data.cats[row["category_id"]]["name"] == "car"
            mask = data.annToMask(row).astype(bool)
            assert (mask == (frame.samples["ids"].data == id)).all()
            assert row["area"] == mask.sum()
            left, top, width, height = row["bbox"]
            box = np.array((left, top, left + width, top + height))
            assert (box == pixels_of(frame, id)).all()
            assert side_of(box) == SIDES[id]
        tops = {id: row["bbox"][1] for id, row in annotations.items()}
        assert tops[LEFT] < tops[RIGHT]  # rows are counted from above


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99, 1.0])
def test_masks_are_encoded_as_pycocotools_does(share: float) -> None:
    mask_of = pytest.importorskip("pycocotools.mask", reason="pycocotools is not installed")
    random = np.random.default_rng(1)
    for height, width in ((1, 1), (1, 90), (90, 1), (37, 53), (200, 160)):
        whole = random.random((height, width)) < share
        whole[height // 2, width // 2] = True
        rows, columns = np.flatnonzero(whole.any(axis=1)), np.flatnonzero(whole.any(axis=0))
        part = whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        expected = mask_of.encode(np.asfortranarray(whole.astype(np.uint8)))["counts"].decode()
        assert encoded(part, (int(columns[0]), int(rows[0])), height, width) == expected


# --- nuScenes --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def devkit(recording: Path) -> dict[str, Any]:
    """Return what nuscenes-devkit reads."""
    if not DEVKIT.exists():
        pytest.skip("nuscenes-devkit is not installed: `make nuscenes` does that")
    folder = written(recording, "nuscenes")
    command = [DEVKIT, Path(__file__).with_name("nuscenes_reader.py"), folder, VERSION, "front", "top", "radar"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    read: dict[str, Any] = json.loads(done.stdout)
    return read


def test_boxes_of_nuscenes_are_where_pixels_and_points_are(devkit: dict[str, Any], truth: list[SensedFrame]) -> None:
    assert devkit["scenes"] == {"train": ["cars"], "val": [], "test": []}
    for index, (sample, frame) in enumerate(zip(devkit["samples"], truth, strict=True)):
        categories = ["vehicle.car", "vehicle.car", "vehicle.emergency.ambulance"]
        assert [box["category"] for box in sample["boxes"]] == categories
        by_side = {side_of(np.array((*box["low"], *box["high"]))): box for box in sample["boxes"]}
        for id, side in SIDES.items():
            box = by_side[side]
            left, top, right, bottom = pixels_of(frame, id)
            # The corners of a box are outside of the rounded shape in it: all pixels are within them.
            assert (np.array(box["low"]) <= np.array((left, top)) + WITHIN).all()
            assert (np.array(box["high"]) >= np.array((right, bottom)) - WITHIN).all()
            assert box["size"] == pytest.approx([2 * BOX[4] / 100, 2 * BOX[3] / 100, 2 * BOX[5] / 100])
            assert box["points"] > 20
            assert box["visibility"] == "4"
            assert box["center"][1] == pytest.approx(CAMERA_HEIGHT - BOX[2] / 100 - RAISED * (id == LEFT), abs=NEAR)
            hits = np.array(box["hits"])
            assert np.abs(hits.mean(axis=0) - box["center"]).max() < BOX[3] / 100
            pixels = hits @ MATRIX.T
            columns, rows = (pixels[:, :2] / pixels[:, 2:]).astype(int).T
            assert (frame.samples["ids"].data[rows, columns] == id).mean() > 0.9  # all but some at the edges
        ahead = by_side[0]
        assert np.abs(np.array((*ahead["low"], *ahead["high"])) - pixels_of(frame, AHEAD)).max() <= WITHIN
        assert ahead["center"] == pytest.approx([0, CAMERA_HEIGHT - BOX[2] / 100, gap(index) + BOX[3] / 100], abs=NEAR)
        assert np.hypot(*ahead["center_of_lidar"][:2]) == pytest.approx(gap(index) + BOX[3] / 100, abs=NEAR)
        assert min(z for _, _, z in ahead["hits"]) == pytest.approx(gap(index), abs=NEAR)
        assert ahead["speed"] == pytest.approx(SPEED, abs=0.01)
        assert by_side[-1]["speed"] == pytest.approx(0, abs=0.01)
        assert sample["echoes"] > 100
        assert ahead["echoes"] > 0


def test_the_tables_of_nuscenes_refer_to_each_other(recording: Path) -> None:
    folder = written(recording, "nuscenes")
    tables = {name: json.loads((folder / VERSION / f"{name}.json").read_text()) for name in TABLES}
    tokens = {name: {row["token"] for row in rows} for name, rows in tables.items()}
    assert all(len(tokens[name]) == len(rows) for name, rows in tables.items())
    for rows in tables.values():
        for row in rows:
            for key, value in row.items():
                other = key.removesuffix("_token")
                if key.endswith("_token") and other in tokens:
                    assert value in tokens[other], key
    for name, chains in (("sample", 1), ("sample_annotation", len(CARS))):
        known = {row["token"]: row for row in tables[name]}
        assert all(known[row["next"]]["prev"] == token for token, row in known.items() if row["next"])
        assert [row["prev"] for row in known.values()].count("") == chains
    for table, form, many in (
        ("scene", "{}_sample_token", "sample"),
        ("instance", "{}_annotation_token", "sample_annotation"),
    ):
        for whole in tables[table]:
            own = [row["token"] for row in tables[many] if row[f"{table}_token"] == whole["token"]]
            ends = [whole[form.format(end)] for end in ("first", "last")]
            assert (*ends, whole[f"nbr_{many.removeprefix('sample_')}s"]) == (own[0], own[-1], len(own))
    assert len(tables["sample_data"]) == 3 * len(RIG)
    assert all((folder / row["filename"]).stat().st_size > 0 for row in [*tables["sample_data"], *tables["map"]])
    times = [row["timestamp"] for row in tables["sample"]]
    assert [after - before for before, after in pairwise(times)] == [STEP * 1e6] * 2
    points = np.fromfile(
        folder
        / next(row["filename"] for row in tables["sample_data"] if row["fileformat"] == "pcd" and "top" in row["filename"]),
        np.float32,
    )
    assert set(np.unique(points.reshape(-1, 5)[:, 4]).tolist()) <= set(range(64))


# --- bad input -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("to", ["kitti", "coco", "nuscenes"])
def test_what_is_no_dataset(recording: Path, tmp_path: Path, to: str) -> None:
    blind = SensorRig.of([{"type": "sensor.other.imu", "id": "imu"}])
    with carla_recap.open_recording(recording) as source:
        for options, message in (
            ({}, "a dataset needs a rig"),
            ({"rig": blind}, r"rig: has no sensor\.camera\.rgb; one at least was expected"),
            ({"rig": RIG, "rate": math.inf}, "a rate of inf per second"),
        ):
            with pytest.raises(RecapError, match=message):
                export(source, tmp_path / "out", to=to, **options)
    assert list(tmp_path.iterdir()) == []


def test_a_parked_car_does_not_move_in_the_compensated_velocities_of_a_radar():
    own, pose = np.array((0.0, 10.0, 0.0)), np.array((5.0, 0, 1, 0, 0, 90.0))  # it looks along its motion
    table = np.zeros(2, DETECTION)
    table["azimuth"], table["depth"] = (0.0, np.radians(60)), (20.0, 30.0)
    table["velocity"] = (-10.0, -5.0)  # the one ahead comes as fast as the radar drives, the one aside half as fast
    (spec,) = SensorRig.of([{"type": "sensor.other.radar", "id": "radar", **PLACE}])
    content = nuscenes._radar_file(Sample(spec, 0.0, pose, table, own))
    points = np.frombuffer(content[content.index(b"DATA binary\n") + 12 : -1], nuscenes._RADAR_POINT)
    assert points["vx"] == pytest.approx((-10.0, -5.0 * np.cos(np.radians(60))))
    for name in ("vx_comp", "vy_comp"):
        assert points[name] == pytest.approx((0, 0), abs=1e-5)
