"""Bags of ROS 2, read back with rosbags and with MCAP's own library."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.sensors.rig import SensorRig
from tests.replay.scripts import matrix_of
from tests.sensed import HEADER, filmed
from tests.sensors.cars import AHEAD, GAP, LEFT, RAISED, RIG, RIGHT, SPEED, STEP, drive, spawn

pytest.importorskip("rosbags")

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

Messages = dict[str, list[tuple[int, Any]]]

IMAGES = {"depth": "16UC1", "tags": "mono8", "ids": "rgba8", "normals": "rgb8", "flow": "32FC2"}


def read(folder: Path) -> Messages:
    """Return the times and messages of each topic."""
    found: Messages = {}
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return found


def exported(source: Path, folder: Path, **options: Any) -> Messages:
    with carla_recap.open_recording(source) as recording:
        carla_recap.export(recording, folder, to="rosbag2", **options)
    return read(folder)


@pytest.fixture(scope="module")
def bag(driver: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rosbag")
    with carla_recap.open_recording(drive(folder / "cars.mcap", raised=LEFT)) as recording:
        carla_recap.export(recording, folder / "bag", to="rosbag2", rig=RIG)
    return folder / "bag"


@pytest.fixture(scope="module")
def messages(bag: Path) -> Messages:
    return read(bag)


def matrix(transform: Any) -> np.ndarray:
    """Return a transform as a matrix (4, 4)."""
    turn, place = transform.rotation, transform.translation
    found = np.eye(4)
    found[:3, :3] = matrix_of((turn.x, turn.y, turn.z, turn.w))
    found[:3, 3] = place.x, place.y, place.z
    return found


def to_frame(messages: Messages, sensor: str = "") -> np.ndarray:
    """Return what turns points of the map into those of the hero's frame, or of a sensor's, at the beginning."""
    (base,) = messages["/tf"][0][1].transforms
    assert (base.header.frame_id, base.child_frame_id) == ("map", "hero/base_link")
    found = np.linalg.inv(matrix(base.transform))
    if sensor:
        mounts = {each.child_frame_id: each for each in messages["/tf_static"][0][1].transforms}
        assert mounts[sensor].header.frame_id == "hero/base_link"
        found = np.linalg.inv(matrix(mounts[sensor].transform)) @ found
    return found


def corners(messages: Messages, id: int, frame: np.ndarray) -> np.ndarray:
    """Return the corners of the box of an actor in a frame, (8, 3), at the beginning."""
    (box,) = (each for each in messages["/markers"][0][1].markers if each.id == id)
    turn, place, size = box.pose.orientation, box.pose.position, box.scale
    pose = matrix(type("Transform", (), {"rotation": turn, "translation": place}))
    own = np.array([(*signs, 1.0) for signs in product((-0.5, 0.5), repeat=3)]) * (size.x, size.y, size.z, 1.0)
    return (own @ pose.T @ frame.T)[:, :3]


def cloud(message: Any) -> np.ndarray:
    assert all(field.datatype in (6, 7) for field in message.fields)
    types = [("<f4" if field.datatype == 7 else "<u4") for field in message.fields]
    dtype = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": types,
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    return np.frombuffer(message.data.tobytes(), dtype)


def test_a_car_ahead_is_ahead_in_markers_and_the_others_left_and_right(messages: Messages) -> None:
    frame = to_frame(messages)
    assert corners(messages, AHEAD, frame)[:, 0].min() == pytest.approx(GAP + 2.0, abs=0.01)
    assert corners(messages, LEFT, frame).mean(axis=0) == pytest.approx((18.0, 7.0, 0.75 + RAISED), abs=0.01)
    assert corners(messages, RIGHT, frame).mean(axis=0) == pytest.approx((18.0, -5.0, 0.75), abs=0.01)


def test_a_car_ahead_has_its_distance_in_points(messages: Messages) -> None:
    for index, (_, message) in enumerate(messages["/sensors/lidar/points"]):
        assert [field.name for field in message.fields] == ["x", "y", "z", "intensity"]
        points = cloud(message)
        ahead = points[(np.abs(points["y"]) < 0.5) & (points["z"] > -0.8) & (points["x"] > 5)]
        assert ahead["x"].min() == pytest.approx(GAP + SPEED * STEP * index, abs=0.05)
    left = cloud(messages["/sensors/semantic_lidar/points"][0][1])
    assert left[left["actor"] == LEFT]["y"].min() > 5


def test_boxes_are_projected_onto_the_pixels_of_their_cars(messages: Messages) -> None:
    image = messages["/sensors/ids/image"][0][1]
    ids = image.data.reshape(image.height, image.width, 4).copy().view("<u4")[..., 0] & 0xFFFFFF
    info = messages["/sensors/ids/camera_info"][0][1]
    inside = corners(messages, AHEAD, to_frame(messages, "ids"))
    pixels = (inside @ info.k.reshape(3, 3).T)[:, :2] / inside[:, 2:]
    rows, columns = np.nonzero(ids == AHEAD)
    assert pixels[:, 0].min() == pytest.approx(columns.min(), abs=2)
    assert pixels[:, 0].max() == pytest.approx(columns.max() + 1, abs=2)
    assert pixels[:, 1].min() == pytest.approx(rows.min(), abs=2)
    assert pixels[:, 1].max() == pytest.approx(rows.max() + 1, abs=2)


def test_images_are_those_of_their_encodings(messages: Messages) -> None:
    for id, encoding in IMAGES.items():
        image = messages[f"/sensors/{id}/image"][0][1]
        assert (image.encoding, image.width, image.height, image.header.frame_id) == (encoding, 800, 600, id)
        assert len(image.data) == image.step * image.height
    depth = messages["/sensors/depth/image"][0][1]
    assert depth.data.view("<u2").reshape(600, 800)[300, 400] == pytest.approx(GAP * 1000, abs=50)
    jpeg = messages["/sensors/front/image/compressed"][0][1]
    assert jpeg.format == "jpeg"
    assert jpeg.data[:2].tobytes() == b"\xff\xd8"


def test_what_else_is_measured(messages: Messages) -> None:
    imu = messages["/sensors/imu/imu"][0][1]
    assert imu.linear_acceleration.z == pytest.approx(9.81, abs=0.05)
    assert imu.orientation_covariance[0] == -1
    assert messages["/sensors/speed/speed"][0][1].data == pytest.approx(0, abs=1e-6)
    assert len(messages["/sensors/gnss/fix"]) == 2
    radar = cloud(messages["/sensors/radar/points"][0][1])
    assert np.hypot(radar["x"], radar["y"]).max() > GAP
    assert [round(time / 1e9, 3) for time, _ in messages["/clock"]] == [0.0, STEP, 2 * STEP]
    stamps = [(time, found.header.stamp) for each in messages.values() for time, found in each if hasattr(found, "header")]
    assert all(stamp.sec * 10**9 + stamp.nanosec == time for time, stamp in stamps)
    odometry = messages["/odom"][0][1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "hero/base_link")
    assert (odometry.pose.pose.position.x, odometry.pose.pose.position.y) == pytest.approx((20.0, -30.0))


def test_the_mcap_library_reads_it_and_static_topics_are_latched(bag: Path, messages: Messages) -> None:
    assert sorted(path.name for path in bag.iterdir()) == ["bag.mcap", "metadata.yaml"]
    with (bag / "bag.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        counts: dict[str, int] = {}
        for schema, channel, _ in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts == {topic: len(found) for topic, found in messages.items()}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as opened:
        qos = {each.topic: each.ext.offered_qos_profiles[0].durability.name for each in opened.connections}
    assert {topic for topic, name in qos.items() if name == "TRANSIENT_LOCAL"} >= {"/tf_static"}
    assert qos["/odom"] == "VOLATILE"


def test_sensors_of_a_recording_are_in_its_bag(tmp_path: Path) -> None:
    path = filmed(tmp_path / "filmed.mcap", {"own": (0.0, {1.0: (200, 0, 0), 2.5: (0, 0, 200)})})
    with pytest.warns(RecapWarning, match=r"the hero has no pose: the bag has no /odom"):
        messages = exported(path, tmp_path / "bag")
    images = messages["/sensors/own/image/compressed"]
    assert [time / 1e9 - HEADER.date for time, _ in images] == [1.0, 2.5]
    assert {image.format for _, image in images} == {"jpeg"}
    frames = {each.child_frame_id: each for _, found in messages["/tf"] for each in found.transforms}
    assert frames["own"].header.frame_id == "map"
    assert matrix(frames["own"].transform)[:3] == pytest.approx(np.array(((0, 0, 1, 0), (-1, 0, 0, 0), (0, -1, 0, 0.0))))
    rig = SensorRig.of([{"type": "sensor.other.imu", "id": "own"}])
    with carla_recap.open_recording(path) as recording, pytest.raises(RecapError, match="has data of a sensor 'own'"):
        carla_recap.export(recording, tmp_path / "again", to="rosbag2", rig=rig)


def test_actors_that_are_gone_are_deleted(tmp_path: Path) -> None:
    path = tmp_path / "gone.mcap"
    with carla_recap.create_recording(path, map_name="Nowhere", date=0) as recorder:
        for frame in range(3):
            gone = {"destroyed": [LEFT]} if frame == 2 else {}
            spawned = {"spawned": [spawn(LEFT, np.zeros(6))]} if not frame else {}
            poses = [] if frame == 2 else [(LEFT, 0, 0, 0, 0, 0, 0)]
            recorder.add_frame(frame * STEP, transforms=poses, **spawned, **gone)
    with pytest.warns(RecapWarning, match=r"the hero has no pose: the bag has no /odom"):
        messages = exported(path, tmp_path / "bag")
    actions = [[(each.id, each.action) for each in found.markers] for _, found in messages["/markers"]]
    assert actions == [[(0, 3), (LEFT, 0)], [(LEFT, 0)], [(LEFT, 2)]]
    assert "/odom" not in messages
    assert "/tf" not in messages
