"""Samples as messages, decoded again."""

from __future__ import annotations

import json
from io import BytesIO
from threading import active_count
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.sensors.encoding import bgrx, millimetres, png
from carla_recap.sensors.ray_sensors import DETECTION, POINT, SEMANTIC_POINT
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import FIX, INERTIA, Sample, SensedFrame
from carla_recap.v1.sensors_pb2 import ImuReading, SpeedReading

pytest.importorskip("foxglove_schemas_protobuf")

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from carla_recap.sensors.messages import TRANSFORMS, SensorMessages
from tests.replay.scripts import matrix_of
from tests.sensors.made import HEADER, HEIGHT, POSE, WIDTH, picture, sample

if TYPE_CHECKING:
    from google.protobuf.message import Message


def decoded(some: Sample, topic: str, schema: type[Message], **options: Any) -> Any:
    """Return the message of a sample on one of the sensor's topics."""
    maker = SensorMessages(SensorRig((some.spec,)), HEADER, **options)
    found = {message.topic: message for message in maker.of([some])}
    names = {each.name: each.message for each in maker.topics}
    assert names.keys() == found.keys()
    name = topic if topic.startswith("/tf") else f"/sensors/own/{topic}"
    assert names[name] == schema.DESCRIPTOR.full_name
    assert found[name].elapsed == some.time
    return schema.FromString(found[name].data)


def test_rgb_images_are_jpegs() -> None:
    from PIL import Image

    message = decoded(sample("sensor.camera.rgb", picture()), "image", CompressedImage)
    assert (message.format, message.frame_id) == ("jpeg", "own")
    assert (message.timestamp.seconds, message.timestamp.nanos) == (1_600_000_001, 500_000_000)
    image = np.asarray(Image.open(BytesIO(message.data))).astype(int)
    assert np.abs(image[4:20, 4:28] - (200, 0, 0)).max() < 12
    assert np.abs(image[4:20, 36:60] - (0, 0, 200)).max() < 12
    assert np.abs(image[28:44, 4:28] - (50, 0, 0)).max() < 12


def test_views_of_drawn_images_are_not_copied() -> None:
    drawn = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 4), np.uint8)
    assert bgrx(drawn[..., 2::-1]) is drawn
    for copied in (drawn[..., :3], drawn[:, ::-1, 2::-1], drawn[..., 2::-1].copy()):
        assert np.array_equal(bgrx(copied)[..., 2::-1], copied)


def test_videos_have_a_packet_for_each_image_and_a_key_frame_each_second() -> None:
    av = pytest.importorskip("av")
    some = sample("sensor.camera.rgb", picture())
    maker = SensorMessages(SensorRig((some.spec,)), HEADER, video=True)
    images, units = [], []
    decoder = av.CodecContext.create("h264", "r")
    for index in range(25):
        image = np.roll(picture(), index, axis=1)
        one = Sample(some.spec, index * 0.1, POSE, image)
        (data,) = (message.data for message in maker.of([one]) if message.topic.endswith("/video"))
        message = CompressedVideo.FromString(data)
        assert message.format == "h264"
        units.append([part[0] & 31 for part in message.data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]])
        images += decoder.decode(av.Packet(message.data))
    images += decoder.decode(None)
    assert len(images) == 25
    assert [index for index, types in enumerate(units) if 5 in types] == [0, 10, 20]
    assert all({7, 8} <= set(types) for types in units[::10])
    shown = images[24].to_ndarray(format="rgb24").astype(int)
    assert np.abs(shown[8:16, 36:44] - np.roll(picture(), 24, axis=1)[8:16, 36:44]).mean() < 12


def test_videos_of_odd_sizes_are_refused() -> None:
    pytest.importorskip("av")
    some = sample("sensor.camera.rgb", np.zeros((1, 1, 3), np.uint8), width=63)
    with pytest.raises(RecapError, match=r"sensor 'own': 63 x 48: the sides of a video are even"):
        SensorMessages(SensorRig((some.spec,)), HEADER, video=True)


def test_depth_is_in_millimetres() -> None:
    depth = np.full((HEIGHT, WIDTH), 65.535, np.float32)
    depth[0, :4] = 1.2345, 0.0, 65.54, np.inf
    message = decoded(sample("sensor.camera.depth", depth), "depth", RawImage)
    assert (message.encoding, message.width, message.height, message.step) == ("16UC1", WIDTH, HEIGHT, 2 * WIDTH)
    image = np.frombuffer(message.data, "<u2").reshape(HEIGHT, WIDTH)
    assert image[0, :5].tolist() == [1234, 0, 0, 0, 65535]
    assert millimetres(np.array([np.nan])).tolist() == [0]


def test_tags_and_ids_are_kept() -> None:
    tags = np.arange(HEIGHT * WIDTH, dtype=np.uint8).reshape(HEIGHT, WIDTH)
    message = decoded(sample("sensor.camera.semantic_segmentation", tags), "semantic", RawImage)
    assert (message.encoding, message.data) == ("mono8", tags.tobytes())
    ids = np.arange(HEIGHT * WIDTH, dtype=np.uint32).reshape(HEIGHT, WIDTH) * 5000
    message = decoded(sample("sensor.camera.instance_segmentation", ids), "instance", RawImage)
    red, green, blue, alpha = np.frombuffer(message.data, np.uint8).reshape(HEIGHT, WIDTH, 4).astype(int).transpose(2, 0, 1)
    assert (message.encoding, message.step) == ("rgba8", 4 * WIDTH)
    assert np.array_equal(red + 256 * green + 65536 * blue, ids)
    assert (alpha == 255).all()


def test_normals_and_motion_are_kept() -> None:
    normals = np.tile(np.array((0.0, -1.0, 1.0), np.float32), (HEIGHT, WIDTH, 1))
    message = decoded(sample("sensor.camera.normals", normals), "normals", RawImage)
    assert (message.encoding, message.data[:3]) == ("rgb8", bytes((128, 0, 255)))
    motion = np.tile(np.array((-1.5, 20.25), np.float32), (HEIGHT, WIDTH, 1))
    message = decoded(sample("sensor.camera.optical_flow", motion), "flow", RawImage)
    assert (message.encoding, message.data) == ("32FC2", motion.tobytes())


def test_calibrations_project_as_the_camera_does() -> None:
    some = sample("sensor.camera.rgb", picture())
    message = decoded(some, "calibration", CameraCalibration)
    transforms = decoded(some, TRANSFORMS, FrameTransforms).transforms
    assert [(each.parent_frame_id, each.child_frame_id) for each in transforms] == [("world", "own")]
    place, turn = transforms[0].translation, transforms[0].rotation
    axes = matrix_of((turn.x, turn.y, turn.z, turn.w))
    point = np.array((8.0, 30.0, 5.0))  # ahead along y, to the left, and above
    optical = axes.T @ (point - (place.x, place.y, place.z))
    pixel = np.array(message.P).reshape(3, 4)[:, :3] @ optical
    assert pixel[:2] / pixel[2] == pytest.approx(some.camera.project(point[None])[0, :2])
    assert pixel[0] / pixel[2] < WIDTH / 2
    assert pixel[1] / pixel[2] < HEIGHT / 2
    assert message.K[0] == pytest.approx(WIDTH / 2)


@pytest.mark.parametrize(("type", "dtype"), [("ray_cast", POINT), ("ray_cast_semantic", SEMANTIC_POINT)])
def test_points_are_kept_to_the_nearest_4_mm(type: str, dtype: np.dtype[np.void]) -> None:
    points = np.zeros(2, dtype)
    points["x"], points["y"], points["z"] = (10.001, -3.3), (1.0, 2.0), (-0.5, 0.25)
    points[dtype.names[3]] = 0.75  # type: ignore[index]
    if "actor" in (dtype.names or ()):
        points["actor"] = 70_001, 7
    message = decoded(sample(f"sensor.lidar.{type}", points), "points", PointCloud)
    fields = {field.name: (field.offset, field.type) for field in message.fields}
    assert list(fields) == list(dtype.names or ())
    assert message.pose.orientation.w == 1
    read = np.frombuffer(message.data, dtype)
    assert message.point_stride == dtype.itemsize
    for name in dtype.names or ():
        assert fields[name] == (dtype.fields[name][1], 5 if dtype[name].kind == "u" else 7)  # type: ignore[index]
        assert np.abs(read[name].astype(float) - points[name]).max() <= 1 / 512


def test_detections_are_points_with_what_the_radar_measures() -> None:
    found = np.array([(-3.0, np.pi / 6, 0.0, 10.0), (1.25, 0.0, np.pi / 2, 4.0)], DETECTION)
    message = decoded(sample("sensor.other.radar", found), "detections", PointCloud)
    names = [field.name for field in message.fields]
    read = np.frombuffer(message.data, "<f4").reshape(2, len(names))
    assert names == ["x", "y", "z", *DETECTION.names]  # type: ignore[misc]
    assert read[0, :3] == pytest.approx((10 * np.cos(np.pi / 6), 5.0, 0.0), abs=1 / 256)
    assert read[1, :3] == pytest.approx((0.0, 0.0, 4.0), abs=1 / 256)
    assert read[:, 3:].tolist() == [row.tolist() for row in np.array(found.tolist(), np.float32)]


def test_positions_and_motion() -> None:
    fix = decoded(sample("sensor.other.gnss", np.array((49.0, 8.4, 115.0), FIX)), "fix", LocationFix)
    assert (fix.latitude, fix.longitude, fix.altitude, fix.frame_id) == (49.0, 8.4, 115.0, "own")
    inertia = np.array(((1.0, 2.0, 9.81), (0.1, 0.2, 0.3), 1.5), INERTIA)
    imu = decoded(sample("sensor.other.imu", inertia), "imu", ImuReading)
    assert (imu.acceleration_x, imu.acceleration_y, imu.acceleration_z) == (1.0, 2.0, 9.81)
    assert (imu.angular_velocity_x, imu.angular_velocity_y, imu.angular_velocity_z) == (0.1, 0.2, 0.3)
    assert (imu.compass, imu.elapsed) == (1.5, 1.5)
    speed = decoded(sample("sensor.speedometer", np.array(-10.0)), "speed", SpeedReading)
    assert (speed.speed, speed.speed_kmh) == (-10.0, -36.0)


def test_topics_have_the_specification_of_the_sensor() -> None:
    rig = SensorRig.of([{"type": "sensor.camera.rgb", "id": "own", "x": 1.0, "y": 0.0, "z": 2.0, "fov": 70.0}])
    *topics, transforms = SensorMessages(rig, HEADER).topics
    assert [topic.name for topic in topics] == ["/sensors/own/calibration", "/sensors/own/image"]
    for topic in topics:
        assert SensorRig.of([json.loads(topic.metadata["sensor"])]) == rig
        assert b"foxglove" in topic.schema()
    assert (transforms.name, transforms.metadata) == (TRANSFORMS, {})


def moments() -> tuple[SensorRig, list[SensedFrame]]:
    some = sample("sensor.camera.rgb", picture())
    images = [np.roll(picture(), 4 * index, 1) for index in range(30)]
    samples = [Sample(some.spec, index * 0.1, POSE, image) for index, image in enumerate(images)]
    return SensorRig((some.spec,)), [
        SensedFrame(own.time, None, None, 1, POSE, {"own": own})  # type: ignore[arg-type]
        for own in samples
    ]


@pytest.mark.parametrize("video", [False, True])
def test_messages_made_in_threads_are_those_made_one_after_the_other(video: bool) -> None:
    rig, frames = moments()
    one, other = (SensorMessages(rig, HEADER, video=video) for _ in range(2))
    taken: list[SensedFrame] = []
    encoded = one.encoded(taken.append(frame) or frame for frame in frames)  # type: ignore[func-returns-value]
    made = [next(encoded)]
    assert len(taken) < 5  # no more than a few are held up
    made += encoded
    assert [frame for frame, _ in made] == frames
    assert [messages for _, messages in made] == [list(other.of(frame.samples.values())) for frame in frames]


def test_an_error_while_messages_are_made_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> bytes:
        raise RecapError("cannot be encoded")

    monkeypatch.setattr("carla_recap.sensors.messages.jpeg", fail)
    rig, frames = moments()
    threads = active_count()
    with pytest.raises(RecapError, match="cannot be encoded"):
        list(SensorMessages(rig, HEADER).encoded(frames))
    assert active_count() == threads


def test_pngs_are_read_again() -> None:
    from PIL import Image

    for image in (picture(), picture()[..., 0], np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000):
        assert np.array_equal(np.asarray(Image.open(BytesIO(png(image)))), image)
