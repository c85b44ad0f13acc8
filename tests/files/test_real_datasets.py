"""Labelled datasets of recordings of CARLA itself, in Town01, by roadside sensors on a prop and on a stationary sensor."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

import carla_recap
from carla_recap import SensorRig, export
from carla_recap.files.nuscenes import VERSION
from carla_recap.replay.pose import right_handed, rotations
from carla_recap.sensors.sensing import sense
from tests.files.test_datasets import DEVKIT, EXACT, NEAR, WITHIN, kitti_calibration, kitti_labels
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

DATA = Path(__file__).parents[3] / "shared" / "data"
if not DATA.is_dir():
    pytest.skip("the recordings of CARLA are not here", allow_module_level=True)

SIZE = {"width": 800, "height": 600, "fov": 90.0}
RAYS = {"range": 50.0, "channels": 64, "points_per_second": 1_000_000, "rotation_frequency": 10.0, "lower_fov": -20.0}
PARTS = {"duration": 0.5, "rate": 2.0, "quality": "low", "road_map": DATA / "maps"}
MIDDLE = 400.0  # pixels: half of the width, and the focal length of a field of view of 90 degrees


class Scene(NamedTuple):
    """A part of a recording in which an actor has the only vehicle of the recording in view."""

    name: str
    actor: int
    yaw: float
    start: float
    hero: int

    @property
    def rig(self) -> list[dict[str, Any]]:
        place = {"x": 0.0, "y": 0.0, "z": 1.6, "yaw": self.yaw}
        return [
            {"type": "sensor.camera.rgb", "id": "front", **place, **SIZE},
            {"type": "sensor.lidar.ray_cast", "id": "top", **place, **RAYS, **EXACT},
            {"type": "sensor.other.radar", "id": "radar", **place, "points_per_second": 20_000},
        ]


SCENES = [Scene("carla-0.9.13-lane-center", 235, -90.0, 5.5, 234), Scene("carla-0.9.10-lane-center", 263, 0.0, 9.0, 259)]


class Truth(NamedTuple):
    """What an image shows of the vehicle at a moment.

    Attributes:
        pixels: The pixels of the vehicle.
        depths: The depth of all pixels, in m.
        center: The middle of its recorded box in the optical axes of the camera, in m.
        size: The length, the width and the height of that box in m.
    """

    pixels: NDArray[np.bool_]
    depths: NDArray[np.float32]
    center: NDArray[np.float64]
    size: NDArray[np.float64]

    @property
    def box(self) -> NDArray[np.int64]:
        rows, columns = np.nonzero(self.pixels)
        return np.array((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))


@pytest.fixture(scope="module", params=SCENES, ids=lambda scene: scene.name)
def scene(driver: None, request: pytest.FixtureRequest) -> Scene:
    found: Scene = request.param
    return found


@pytest.fixture(scope="module")
def truth(scene: Scene) -> list[Truth]:
    camera = {**scene.rig[0], "id": "ids", "type": "sensor.camera.instance_segmentation"}
    rig = SensorRig.of([camera, {**camera, "id": "depth", "type": "sensor.camera.depth"}])
    found = []
    with carla_recap.open_recording(DATA / "carla-logs" / f"{scene.name}.log") as recording:
        for frame in sense(recording, rig, actor=scene.actor, start=scene.start, **PARTS):
            pose, box = frame.scene.pose_of(scene.hero), frame.scene.actors[scene.hero].bounding_box
            assert pose is not None
            assert box is not None
            place = right_handed(np.array(pose))
            middle = place[:3] + rotations(place) @ (box.x, -box.y, box.z)
            camera_at = frame.samples["ids"].camera
            forward, left, up = (middle - camera_at.location) @ camera_at.rotation
            found.append(
                Truth(
                    frame.samples["ids"].data == scene.hero,
                    frame.samples["depth"].data,
                    np.array((-left, -up, forward)),
                    2 * np.array((box.extent_x, box.extent_y, box.extent_z)),
                )
            )
    assert len(found) == 2
    assert all(each.pixels.sum() > 500 for each in found)
    return found


def written(scene: Scene, folder: Path, to: str) -> Path:
    with carla_recap.open_recording(DATA / "carla-logs" / f"{scene.name}.log") as recording:
        export(recording, folder / to, to=to, rig=SensorRig.of(scene.rig), actor=scene.actor, start=scene.start, **PARTS)
    return folder / to


def check_points(points: NDArray[np.float64], truth: Truth) -> None:
    """Check that the points of a lidar on the vehicle, in the optical axes of the camera, are what the images show."""
    pixels = points[:, :2] / points[:, 2:] * MIDDLE + (MIDDLE, SIZE["height"] / 2)
    columns, rows = pixels.astype(int).T
    inside = (points[:, 2] > 0) & (columns >= 0) & (columns < SIZE["width"]) & (rows >= 0) & (rows < SIZE["height"])
    points, columns, rows = points[inside], columns[inside], rows[inside]
    own = truth.pixels[rows, columns]
    assert own.sum() > 50
    differences = points[own, 2] - truth.depths[rows[own], columns[own]]
    assert abs(np.median(differences)) < NEAR
    assert points[own, 2].min() == pytest.approx(truth.depths[truth.pixels].min(), abs=NEAR)


def test_kitti(scene: Scene, truth: list[Truth], tmp_path: Path) -> None:
    folder = written(scene, tmp_path, "kitti")
    for index, expected in enumerate(truth):
        ((name, numbers),) = kitti_labels(folder, index)
        assert name == "Car"
        assert np.abs(numbers[3:7] - expected.box).max() <= WITHIN
        height, width, length, x, y, z, _ = numbers[7:]
        assert (x, y - height / 2, z) == pytest.approx(expected.center, abs=NEAR)
        assert (length, width, height) == pytest.approx(expected.size, abs=0.01)
        matrix = kitti_calibration(folder, index)["Tr_velo_to_cam"]
        points = np.fromfile(folder / "training" / "velodyne" / f"{index:06}.bin", np.float32).reshape(-1, 4)
        check_points(points[:, :3] @ matrix[:, :3].T + matrix[:, 3], expected)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
def test_coco(scene: Scene, truth: list[Truth], tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    with contextlib.redirect_stdout(io.StringIO()):
        data = coco.COCO(written(scene, tmp_path, "coco") / "annotations" / "instances_train.json")
    assert len(data.imgs) == len(truth)
    for image, expected in zip(data.imgs, truth, strict=True):
        (row,) = data.loadAnns(data.getAnnIds(image))
        assert (row["actor"], data.cats[row["category_id"]]["name"]) == (scene.hero, "car")
        assert (data.annToMask(row).astype(bool) == expected.pixels).all()
        left, top, width, height = row["bbox"]
        assert (np.array((left, top, left + width, top + height)) == expected.box).all()


def test_nuscenes(scene: Scene, truth: list[Truth], tmp_path: Path) -> None:
    if not DEVKIT.exists():
        pytest.skip("nuscenes-devkit is not installed: `make nuscenes` does that")
    folder = written(scene, tmp_path, "nuscenes")
    command = [DEVKIT, Path(__file__).with_name("nuscenes_reader.py"), folder, VERSION, "front", "top", "radar"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    for sample, expected in zip(json.loads(done.stdout)["samples"], truth, strict=True):
        (box,) = sample["boxes"]
        assert box["category"] == "vehicle.car"
        assert box["center"] == pytest.approx(expected.center, abs=NEAR)
        assert box["size"] == pytest.approx(expected.size[[1, 0, 2]], abs=0.01)
        left, top, right, bottom = expected.box
        assert (np.array(box["low"]) <= np.array((left, top)) + WITHIN).all()
        assert (np.array(box["high"]) >= np.array((right, bottom)) - WITHIN).all()
        check_points(np.array(box["hits"]), expected)
