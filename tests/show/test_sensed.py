"""Recordings with sensors, read back with the libraries of MCAP, protobuf and Foxglove."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
from carla_recap import RecapError, RecapWarning, export_sensed, open_recording
from carla_recap.editing.convert import convert
from carla_recap.replay.recorded_map import load_map_of
from carla_recap.sensors.ray_sensors import SEMANTIC_POINT
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import sense
from carla_recap.show.foxglove import export_foxglove
from carla_recap.show.foxglove.layouts import write_layouts
from tests.replay.scripts import write
from tests.scene.accidents import CAR, WALKER, accident
from tests.sensors import cars
from tests.sensors.cars import (
    AHEAD,
    CAMERA,
    HERO,
    HERO_POSE,
    LEFT,
    MOTION,
    RIGHT,
    STEP,
    car_pose,
    drive,
    spawn,
)
from tests.show.foxglove_reader import panels, raw, read
from tests.waiting import PATIENCE

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")

from carla_recap.sensors.messages import SensorMessages
from tests.samples import CRASH, ROOT

NODE = ROOT / "tests" / "node"
FRAMES = 3

RIG = SensorRig(tuple(cars.RIG[id] for id in ("front", "depth", "tags", "ids", "lidar", "imu", "speed")))
SCHEMAS = {
    "/sensors/front/image": "foxglove.CompressedImage",
    "/sensors/depth/depth": "foxglove.RawImage",
    "/sensors/tags/semantic": "foxglove.RawImage",
    "/sensors/ids/instance": "foxglove.RawImage",
    **{f"/sensors/{id}/calibration": "foxglove.CameraCalibration" for id in ("front", "depth", "tags", "ids")},
    "/sensors/lidar/points": "foxglove.PointCloud",
    "/sensors/imu/imu": "carla_recap.v1.ImuReading",
    "/sensors/speed/speed": "carla_recap.v1.SpeedReading",
    "/tf/sensors": "foxglove.FrameTransforms",
}


def export(source: Path, destination: Path, rig: SensorRig = MOTION, **options: Any) -> Any:
    with open_recording(source) as recording:
        return export_sensed(recording, destination, rig, **options)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a hero at rest with a car ahead and one on each side."""
    return drive(tmp_path_factory.mktemp("source") / "cars.mcap", FRAMES, raised=LEFT)


@pytest.fixture(scope="module")
def path(driver: None, source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That recording with the data of a rig."""
    path = tmp_path_factory.mktemp("sensed") / "sensed.mcap"
    done = export(source, path, RIG, quality="low")
    assert (done.frames, done.seconds) == (FRAMES, pytest.approx((FRAMES - 1) * STEP))
    assert done.samples == {spec.id: FRAMES for spec in RIG}
    return path


@pytest.fixture(scope="module")
def topics(path: Path) -> dict[str, list[tuple[int, Any]]]:
    return read(path)


# --- the file ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not shutil.which("node"), reason="node is not installed")
def test_foxgloves_own_libraries_read_it(path: Path) -> None:
    if not (NODE / "node_modules").is_dir():
        pytest.skip("the libraries of the independent reader are not installed: npm ci --prefix tests/node")
    command = ["node", NODE / "read.mjs", path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["topics"]
    for topic, schema in SCHEMAS.items():
        assert (found[topic]["schema"], found[topic]["count"]) == (schema, FRAMES), topic
    assert found["/scene/vehicles"]["schema"] == "foxglove.SceneUpdate"
    assert [entry["id"] for entry in found["/sensors/actors"]["last"]["actors"]] == [HERO, AHEAD, LEFT, RIGHT]


def contents(recording: carla_recap.Recording) -> list[Any]:
    """Return all frames of a recording as they are stored."""
    return [
        (frame.id, frame.elapsed, frame.duration, [(packet.id, bytes(packet.payload)) for packet in frame.packets])
        for frame in recording.frames()
    ]


def test_answers_about_a_crash_are_those_of_its_recording(tmp_path: Path) -> None:
    crash, converted = tmp_path / "crash.mcap", tmp_path / "converted.log"
    carla_recap.clip(CRASH, crash, start=9.0, duration=6.0)
    export(crash, tmp_path / "sensed.mcap")
    with open_recording(crash) as one, open_recording(tmp_path / "sensed.mcap") as other:
        assert one.collisions().contacts > 0
        for name in ("collisions", "blocked", "incidents", "measures"):
            assert list(getattr(other, name)()) == list(getattr(one, name)()), name
        assert other.info == one.info
        assert {sensor.id: sensor.type for sensor in other.sensors} == {spec.id: spec.type for spec in MOTION}
    with pytest.warns(RecapWarning, match="left out"):
        convert(tmp_path / "sensed.mcap", converted)
    convert(crash, tmp_path / "plain.log")
    assert converted.read_bytes() == (tmp_path / "plain.log").read_bytes()


@pytest.mark.filterwarnings("ignore:.*the map Town01 is not found:carla_recap.RecapWarning")
def test_a_walker_that_was_knocked_down_before_lies(tmp_path: Path) -> None:
    """It falls from 0.2 s to 0.8 s, although its recorded pose stays upright."""
    pytest.importorskip("embreex", reason="embreex is not installed")
    source = write(tmp_path / "accident.log", accident(40), tick=0.1)
    rays = {"range": 50.0, "channels": 64, "points_per_second": 1_000_000, "upper_fov": 20.0, "lower_fov": -80.0}
    rig = SensorRig.of([{"type": "sensor.lidar.ray_cast_semantic", "id": "lidar", "x": 0.0, "y": 0.0, "z": 2.2, **rays}])
    part = {"start": 0.4, "duration": 0.5}
    export(source, tmp_path / "sensed.mcap", rig, actor=CAR, **part)
    with open_recording(source) as recording:
        expected = [walker_of(frame.samples["lidar"].data) for frame in sense(recording, rig, actor=CAR, **part)]
        export_foxglove(recording, tmp_path / "scene.mcap", follow=CAR, **part)
    found, scene = read(tmp_path / "sensed.mcap"), read(tmp_path / "scene.mcap")
    clouds = [walker_of(np.frombuffer(cloud.data, SEMANTIC_POINT)) for _, cloud in found["/sensors/lidar/points"]]
    for points, cloud in zip(expected, clouds, strict=True):
        np.testing.assert_allclose(cloud["z"], points["z"], atol=1 / 256)
    assert 0.1 < clouds[-1]["z"].max() + 2.2 < 0.7  # m above the ground; upright, it is 1.86 m high
    shown = [[timeless(message) for _, message in topics["/scene/walkers"]] for topics in (found, scene)]
    assert shown[0] == shown[1]


def walker_of(points: np.ndarray) -> np.ndarray:
    """Return the points of a semantic lidar on the walker."""
    return points[points["actor"] == WALKER]


def timeless(message: Any) -> bytes:
    """Return a message about entities without its times."""
    for entity in message.entities:
        entity.ClearField("timestamp")
    for deletion in message.deletions:
        deletion.ClearField("timestamp")
    return bytes(message.SerializeToString())


def test_the_scene_is_that_of_an_export_to_foxglove(source: Path, path: Path, tmp_path: Path) -> None:
    with open_recording(source) as recording:
        roads = load_map_of(recording, None, carla_recap.load_map, lambda corridors: corridors)
        export_foxglove(recording, tmp_path / "scene.mcap", follow=HERO, road_map=roads)
    expected, found = raw(tmp_path / "scene.mcap"), raw(path)
    assert "/scene/vehicles" in expected
    assert {name: found[name] for name in expected} == expected


def test_log_times_are_those_of_the_frames(topics: Any) -> None:
    times = [time for time, _ in topics["/frames"]]
    for topic in SCHEMAS:
        assert [time for time, _ in topics[topic]] == times
    begin = topics["/sensors/front/image"][0][1].timestamp.ToNanoseconds()
    for time, image in topics["/sensors/front/image"]:
        assert image.timestamp.ToNanoseconds() - begin == round(time * 1e9)


# --- geometry ------------------------------------------------------------------------------------------------------


def test_the_messages_are_those_of_what_is_measured(source: Path, path: Path) -> None:
    found = raw(path)
    with open_recording(source) as recording:
        maker = SensorMessages(RIG, recording.header)
        for index, frame in enumerate(sense(recording, RIG, quality="low")):
            for message in maker.of(frame.samples.values()):
                assert found[message.topic][index][1] == message.data, message.topic


# --- a part, other rates, other actors ---------------------------------------------------------------------------------


def test_a_part_is_that_of_a_clip(tmp_path: Path) -> None:
    done = export(CRASH, tmp_path / "sensed.mcap", start=11.0, duration=1.0, rate=10.0)
    carla_recap.clip(CRASH, tmp_path / "clip.mcap", start=11.0, duration=1.0)
    assert done.samples == {"imu": 11, "speed": 11}
    with open_recording(tmp_path / "clip.mcap") as one, open_recording(tmp_path / "sensed.mcap") as other:
        assert other.header == one.header
        assert contents(other) == contents(one)
        seconds = [message.elapsed for message in other.sensor_messages("imu")]
    assert seconds == pytest.approx(np.arange(11) / 10)


def test_an_actor_that_is_absent_is_said(tmp_path: Path) -> None:
    path = tmp_path / "cars.mcap"
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        for frame in range(4):
            present = [id for id in (HERO, LEFT) if id != HERO or frame < 2]
            poses = {id: car_pose(id, 0.0) if id != HERO else HERO_POSE for id in present}
            records: dict[str, Any] = {"destroyed": [HERO]} if frame == 2 else {}
            if not frame:
                records["spawned"] = [spawn(id, pose) for id, pose in poses.items()]
            recorder.add_frame(frame * STEP, transforms=[(id, *pose) for id, pose in poses.items()], **records)
    with pytest.warns(RecapWarning, match=r"the hero is absent, or has no pose, at 2 of 4 moments, first at 0\.1 s"):
        done = export(path, tmp_path / "sensed.mcap")
    assert done.samples == {"imu": 2, "speed": 2}
    with pytest.raises(RecapError, match=r"expected a pose of the hero, to carry the rig, found none at any of 2 moments"):
        export(path, tmp_path / "later.mcap", start=2 * STEP)
    assert not (tmp_path / "later.mcap").exists()


def test_a_clip_of_it_has_the_lights_from_its_start(path: Path, tmp_path: Path) -> None:
    carla_recap.clip(path, tmp_path / "clip.mcap", start=1.5 * STEP)
    with open_recording(tmp_path / "clip.mcap") as recording:
        topics = recording.reader.further_topics()
    assert [topics[name].first for name in ("/lights", "/map")] == [0.0, 0.0]


def test_a_recording_with_sensors_gets_those_of_another_rig(source: Path, tmp_path: Path) -> None:
    export(source, tmp_path / "one.mcap")
    for name, message in (("two.mcap", "has data of a sensor 'imu' already"), ("two.log", "does not end in .mcap")):
        with pytest.raises(RecapError, match=message):
            export(tmp_path / "one.mcap", tmp_path / name)
    export(tmp_path / "one.mcap", tmp_path / "two.mcap", SensorRig.of([{"type": "sensor.other.imu", "id": "second"}]))
    with open_recording(tmp_path / "two.mcap") as recording:
        assert {sensor.id: sensor.count for sensor in recording.sensors} == {"imu": 3, "speed": 3, "second": 3}
    one, two = raw(tmp_path / "one.mcap"), raw(tmp_path / "two.mcap")
    assert two["/scene/vehicles"] == one["/scene/vehicles"]
    assert len(two["/tf/sensors"]) == 2 * FRAMES


# --- layouts -----------------------------------------------------------------------------------------------------------


def test_layouts_have_a_panel_for_each_image_and_the_points(tmp_path: Path) -> None:
    names = ["/sensors/front/image", "/sensors/depth/depth", "/sensors/tags/semantic", "/sensors/ids/instance"]
    with open_recording(CRASH) as recording:
        messages = SensorMessages(RIG, recording.header)
    layouts = write_layouts(tmp_path / "run.mcap", messages.topics)
    assert [path.name for path in layouts.values()] == ["run.foxglove.json", "run.lichtblick.json"]
    both = [json.loads(path.read_text()) for path in layouts.values()]
    for layout in both:
        shown = [config["imageMode"] for kind, config in panels(layout) if kind == "Image"]
        assert [mode["imageTopic"] for mode in shown] == names
        assert [mode["calibrationTopic"] for mode in shown] == [f"{name.rpartition('/')[0]}/calibration" for name in names]
        worlds = [config["topics"] for kind, config in panels(layout) if kind in ("3D", "ThreeDee")]
        assert len(worlds) == 2
        for name in ("/sensors/lidar/points", "/scene/vehicles"):
            assert [world[name]["visible"] for world in worlds] == [True, True]
    assert len(panels(both[1])) == len(both[1]["configById"])


@pytest.mark.parametrize("count", [0, 5, 100])
def test_layouts_of_any_number_of_cameras_are_whole(tmp_path: Path, count: int) -> None:
    cameras = [{"type": "sensor.camera.depth", "id": f"c{n}", **CAMERA} for n in range(count)]
    rig = SensorRig.of(cameras) if cameras else MOTION
    with open_recording(CRASH) as recording:
        layouts = write_layouts(tmp_path / "run.mcap", SensorMessages(rig, recording.header).topics)
    for path in layouts.values():
        assert [kind for kind, _ in panels(json.loads(path.read_text()))].count("Image") == min(count, 12)
