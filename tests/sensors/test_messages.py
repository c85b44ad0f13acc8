"""Samples as messages, and messages of a recording as arrays again."""

from __future__ import annotations

import json
import struct
import zlib
from contextlib import contextmanager
from io import BytesIO
from threading import active_count
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("foxglove_schemas_protobuf")

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from carla_recap import open_recording
from carla_recap.errors import FormatError, RecapError
from carla_recap.formats.base import TopicMessage
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.sensors.decoding import Calibration, SensorDecoder, StoredImages
from carla_recap.sensors.encoding import bgrx, png
from carla_recap.sensors.kinds import LARGEST_SIDE
from carla_recap.sensors.messages import TRANSFORMS, SensorMessages
from carla_recap.sensors.ray_sensors import DETECTION, POINT, SEMANTIC_POINT
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import FIX, INERTIA, Sample, SensedFrame
from carla_recap.v1.sensors_pb2 import ImuReading, SpeedReading
from tests.replay.scripts import matrix_of
from tests.samples import drive
from tests.sensors.made import HEADER, HEIGHT, POSE, WIDTH, picture, sample

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from google.protobuf.message import Message

CAMERA = sample("sensor.camera.rgb", picture()).spec


def message(some: Sample, topic: str, schema: type[Message], **options: Any) -> Any:
    """Return the message of a sample on one of the sensor's topics."""
    maker = SensorMessages(SensorRig((some.spec,)), HEADER, **options)
    found = {message.topic: message for message in maker.of([some])}
    names = {each.name: each.message for each in maker.topics}
    assert names.keys() == found.keys()
    name = topic if topic.startswith("/tf") else f"/sensors/own/{topic}"
    assert names[name] == schema.DESCRIPTOR.full_name
    assert found[name].elapsed == some.time
    return schema.FromString(found[name].data)


def record(path: Path, rig: SensorRig, messages: Iterable[tuple[str, float, bytes]], **options: Any) -> Path:
    """Write a recording with messages of a rig."""
    with McapWriter(path, HEADER) as writer:
        for topic in SensorMessages(rig, HEADER, **options).topics:
            writer.add_topic(topic)
        for frame in drive(3.0):
            writer.write(frame)
        for each in messages:
            writer.write_message(*each)
    return path


@contextmanager
def decoder_of(path: Path, some: Sample) -> Iterator[SensorDecoder]:
    """Open a recording of a sample."""
    rig = SensorRig((some.spec,))
    with open_recording(record(path / "own.mcap", rig, SensorMessages(rig, HEADER).of([some]))) as recording:
        yield SensorDecoder(recording.reader)


def decoded(path: Path, some: Sample) -> dict[str, Any]:
    """Return what the messages of a sample in a recording say, by the last part of the topic."""
    with decoder_of(path, some) as decoder:
        return {each.topic.rpartition("/")[2]: decoder.decoded(each) for each in decoder.messages(0, 10)}


# --- images -------------------------------------------------------------------------------------------------------------


def test_rgb_images_are_jpegs() -> None:
    from PIL import Image

    found = message(sample("sensor.camera.rgb", picture()), "image", CompressedImage)
    assert (found.format, found.frame_id) == ("jpeg", "own")
    assert (found.timestamp.seconds, found.timestamp.nanos) == (1_600_000_001, 500_000_000)
    image = np.asarray(Image.open(BytesIO(found.data))).astype(int)
    assert np.abs(image[4:20, 4:28] - (200, 0, 0)).max() < 12
    assert np.abs(image[4:20, 36:60] - (0, 0, 200)).max() < 12
    assert np.abs(image[28:44, 4:28] - (50, 0, 0)).max() < 12


def test_views_of_drawn_images_are_not_copied() -> None:
    drawn = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 4), np.uint8)
    assert bgrx(drawn[..., 2::-1]) is drawn
    for copied in (drawn[..., :3], drawn[:, ::-1, 2::-1], drawn[..., 2::-1].copy()):
        assert np.array_equal(bgrx(copied)[..., 2::-1], copied)


def test_pngs_are_read_again() -> None:
    from PIL import Image

    for image in (picture(), picture()[..., 0], np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000):
        assert np.array_equal(np.asarray(Image.open(BytesIO(png(image)))), image)


def filled(value: Any, dtype: Any = np.float32) -> np.ndarray:
    """Return an image of which each pixel is the same but the first ones, which have the numbers from 0 on."""
    return np.full((HEIGHT, WIDTH, *np.shape(value)), value, dtype)


DEPTHS, MILLIMETRES = filled(65.535), filled(65535, np.uint16)
DEPTHS[0, :5], MILLIMETRES[0, :5] = (1.2345, 0.0, 65.54, np.inf, np.nan), (1234, 0, 0, 0, 0)
IDS = np.arange(HEIGHT * WIDTH, dtype=np.uint32).reshape(HEIGHT, WIDTH) * 5000


@pytest.mark.parametrize(
    ("kind", "data", "topic", "encoding", "expected"),
    [
        ("depth", DEPTHS, "depth", "16UC1", MILLIMETRES),
        ("semantic_segmentation", IDS.astype(np.uint8), "semantic", "mono8", IDS.astype(np.uint8)),
        ("instance_segmentation", IDS, "instance", "rgba8", (IDS | 0xFF00_0000).view(np.uint8).reshape(HEIGHT, WIDTH, 4)),
        ("normals", filled((0.0, -1.0, 1.0)), "normals", "rgb8", filled((128, 0, 255), np.uint8)),
        ("optical_flow", filled((-1.5, 20.25)), "flow", "32FC2", filled((-1.5, 20.25))),
    ],
)
def test_images_of_numbers_come_back(
    tmp_path: Path, kind: str, data: np.ndarray, topic: str, encoding: str, expected: np.ndarray
) -> None:
    some = sample(f"sensor.camera.{kind}", data)
    found = message(some, topic, RawImage)
    assert (found.encoding, found.width, found.height) == (encoding, WIDTH, HEIGHT)
    own = decoded(tmp_path, some)
    assert own[topic].dtype == expected.dtype
    assert np.array_equal(own[topic], expected)
    assert own["calibration"] == Calibration(WIDTH, HEIGHT, pytest.approx(WIDTH / 2))
    assert own["sensors"]["own"].location == tuple(POSE[:3])


def test_calibrations_project_as_the_camera_does() -> None:
    some = sample("sensor.camera.rgb", picture())
    found = message(some, "calibration", CameraCalibration)
    transforms = message(some, TRANSFORMS, FrameTransforms).transforms
    assert [(each.parent_frame_id, each.child_frame_id) for each in transforms] == [("world", "own")]
    place, turn = transforms[0].translation, transforms[0].rotation
    axes = matrix_of((turn.x, turn.y, turn.z, turn.w))
    point = np.array((8.0, 30.0, 5.0))  # ahead along y, to the left, and above
    optical = axes.T @ (point - (place.x, place.y, place.z))
    pixel = np.array(found.P).reshape(3, 4)[:, :3] @ optical
    assert pixel[:2] / pixel[2] == pytest.approx(some.camera.project(point[None])[0, :2])
    assert pixel[0] / pixel[2] < WIDTH / 2
    assert pixel[1] / pixel[2] < HEIGHT / 2


@pytest.mark.parametrize("video", [False, True])
def test_the_latest_image_at_a_time(tmp_path: Path, video: bool) -> None:
    pytest.importorskip("av")
    samples = [Sample(CAMERA, 0.5 + index * 0.1, POSE, np.roll(picture(), 4 * index, axis=1)) for index in range(15)]
    rig = SensorRig((CAMERA,))
    maker = SensorMessages(rig, HEADER, video=video)
    path = record(tmp_path / "own.mcap", rig, (each for some in samples for each in maker.of([some])), video=video)
    with open_recording(path) as recording:
        images, later = StoredImages(recording.reader, "own"), StoredImages(recording.reader, "own", 1.74)
        earlier = StoredImages(recording.reader, "own", stop=0.9)
        assert images.at(0.4) is None
        for stored, time, index in (
            *((images, time, index) for time, index in ((0.5, 0), (0.55, 0), (1.0, 5), (1.71, 12), (9.0, 14))),
            (later, 1.74, 12),
            (earlier, 9.0, 4),
        ):
            image = stored.at(time)
            assert image is not None
            assert np.median(np.abs(image[8:16].astype(int) - samples[index].data[8:16])) < 12
            assert stored.time == pytest.approx(0.5 + index * 0.1)
        with pytest.raises(RecapError, match=r"has no images of a sensor 'other'"):
            StoredImages(recording.reader, "other")


# --- videos -------------------------------------------------------------------------------------------------------------


def test_videos_have_a_packet_for_each_image_and_a_key_frame_each_second() -> None:
    av = pytest.importorskip("av")
    maker = SensorMessages(SensorRig((CAMERA,)), HEADER, video=True)
    images, units = [], []
    decoder = av.CodecContext.create("h264", "r")
    for index in range(25):
        one = Sample(CAMERA, index * 0.1, POSE, np.roll(picture(), index, axis=1))
        (data,) = (each.data for each in maker.of([one]) if each.topic.endswith("/video"))
        found = CompressedVideo.FromString(data)
        assert found.format == "h264"
        units.append([part[0] & 31 for part in found.data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]])
        images += decoder.decode(av.Packet(found.data))
    images += decoder.decode(None)
    assert len(images) == 25
    assert [index for index, types in enumerate(units) if 5 in types] == [0, 10, 20]
    assert all({7, 8} <= set(types) for types in units[::10])


def test_videos_of_odd_sizes_are_refused() -> None:
    pytest.importorskip("av")
    some = sample("sensor.camera.rgb", np.zeros((1, 1, 3), np.uint8), width=63)
    with pytest.raises(RecapError, match=r"sensor 'own': 63 x 48: the sides of a video are even"):
        SensorMessages(SensorRig((some.spec,)), HEADER, video=True)


def test_a_video_begins_with_its_first_key_frame_and_goes_on_after_an_empty_packet(tmp_path: Path) -> None:
    pytest.importorskip("av")
    rig = SensorRig((CAMERA,))
    maker = SensorMessages(rig, HEADER, video=True)
    packets = [each.data for _ in range(3) for each in maker.of_sample(Sample(CAMERA, 0.0, POSE, picture()))][1::2]
    cut, empty = (CompressedVideo(format="h264", data=data).SerializeToString() for data in (b"\0\0\1", b""))
    packets = [packets[1], cut, packets[0], empty, *packets[1:]]
    messages = (("/sensors/own/video", 0.1 * index, packet) for index, packet in enumerate(packets))
    with open_recording(record(tmp_path / "empty.mcap", rig, messages, video=True)) as recording:
        images = StoredImages(recording.reader, "own")
        assert images.at(0.15) is None
        assert images.at(0.9) is not None
        assert images.time == pytest.approx(0.5)


# --- other sensors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("type", "dtype"), [("ray_cast", POINT), ("ray_cast_semantic", SEMANTIC_POINT)])
def test_points_come_back_to_the_nearest_4_mm(tmp_path: Path, type: str, dtype: np.dtype[np.void]) -> None:
    points = np.zeros(2, dtype)
    points["x"], points["y"], points["z"] = (10.001, -3.3), (1.0, 2.0), (-0.5, 0.25)
    points[dtype.names[3]] = 0.75  # type: ignore[index]
    if "actor" in (dtype.names or ()):
        points["actor"] = 70_001, 7
    some = sample(f"sensor.lidar.{type}", points)
    assert message(some, "points", PointCloud).pose.orientation.w == 1
    found = decoded(tmp_path, some)["points"]
    assert found.dtype == dtype
    for name in dtype.names or ():
        assert np.abs(found[name].astype(float) - points[name]).max() <= 1 / 512


def test_detections_are_points_with_what_the_radar_measures(tmp_path: Path) -> None:
    measured = np.array([(-3.0, np.pi / 6, 0.0, 10.0), (1.25, 0.0, np.pi / 2, 4.0)], DETECTION)
    found = decoded(tmp_path, sample("sensor.other.radar", measured))["detections"]
    rows = np.array(found.tolist())
    assert found.dtype.names == ("x", "y", "z", *DETECTION.names)  # type: ignore[misc]
    assert rows[0, :3] == pytest.approx((10 * np.cos(np.pi / 6), 5.0, 0.0), abs=1 / 256)
    assert rows[1, :3] == pytest.approx((0.0, 0.0, 4.0), abs=1 / 256)
    assert rows[:, 3:].tolist() == np.array(measured.tolist(), np.float32).tolist()


def test_positions_and_motion() -> None:
    fix = message(sample("sensor.other.gnss", np.array((49.0, 8.4, 115.0), FIX)), "fix", LocationFix)
    assert (fix.latitude, fix.longitude, fix.altitude, fix.frame_id) == (49.0, 8.4, 115.0, "own")
    inertia = np.array(((1.0, 2.0, 9.81), (0.1, 0.2, 0.3), 1.5), INERTIA)
    imu = message(sample("sensor.other.imu", inertia), "imu", ImuReading)
    assert (imu.acceleration_x, imu.acceleration_y, imu.acceleration_z) == (1.0, 2.0, 9.81)
    assert (imu.angular_velocity_x, imu.angular_velocity_y, imu.angular_velocity_z) == (0.1, 0.2, 0.3)
    assert (imu.compass, imu.elapsed) == (1.5, 1.5)
    speed = message(sample("sensor.speedometer", np.array(-10.0)), "speed", SpeedReading)
    assert (speed.speed, speed.speed_kmh) == (-10.0, -36.0)


def test_topics_have_the_specification_of_the_sensor() -> None:
    rig = SensorRig((CAMERA,))
    *topics, transforms = SensorMessages(rig, HEADER).topics
    assert [topic.name for topic in topics] == ["/sensors/own/calibration", "/sensors/own/image"]
    for topic in topics:
        assert SensorRig.of([json.loads(topic.metadata["sensor"])]) == rig
        assert b"foxglove" in topic.schema()
    assert (transforms.name, transforms.metadata) == (TRANSFORMS, {})


# --- many messages ------------------------------------------------------------------------------------------------------


def moments() -> list[SensedFrame]:
    images = [np.roll(picture(), 4 * index, 1) for index in range(30)]
    samples = [Sample(CAMERA, index * 0.1, POSE, image) for index, image in enumerate(images)]
    return [SensedFrame(own.time, None, None, 1, POSE, {"own": own}) for own in samples]  # type: ignore[arg-type]


@pytest.mark.parametrize("video", [False, True])
def test_messages_made_in_threads_are_those_made_one_after_the_other(video: bool) -> None:
    frames = moments()
    one, other = (SensorMessages(SensorRig((CAMERA,)), HEADER, video=video) for _ in range(2))
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
    threads = active_count()
    with pytest.raises(RecapError, match="cannot be encoded"):
        list(SensorMessages(SensorRig((CAMERA,)), HEADER).encoded(moments()))
    assert active_count() == threads


def test_a_kind_of_messages_that_there_is_not_is_named(tmp_path: Path) -> None:
    with decoder_of(tmp_path, sample("sensor.camera.rgb", picture())) as decoder:
        reader = decoder._reader
        assert SensorDecoder(reader, ["image", "points"]).topics == ["/sensors/own/image"]
        for kind, expected in (("pics", "points"), ("imu", "image"), ("", "one of calibration, image, ")):
            with pytest.raises(RecapError, match=rf"own\.mcap: expected {expected}.*, found the kind '{kind}'"):
                SensorDecoder(reader, [kind])


# --- messages that contradict their schemas -----------------------------------------------------------------------------

TAGS = sample("sensor.camera.semantic_segmentation", np.zeros((HEIGHT, WIDTH), np.uint8))
POINTS = sample("sensor.lidar.ray_cast", np.zeros(1, POINT))


def cloud(stride: int, offset: int, axes: str = "xyz") -> bytes:
    found = PointCloud(point_stride=stride, data=bytes(64))
    for name in axes:
        found.fields.add(name=name, offset=offset, type=7)
    return bytes(found.SerializeToString())


def raw(**values: Any) -> bytes:
    return bytes(RawImage(**{"encoding": "mono8", "data": bytes(64), **values}).SerializeToString())


@pytest.mark.parametrize(
    ("some", "topic", "data"),
    [
        (TAGS, "semantic", b"\xff"),
        (TAGS, "semantic", raw(width=1 << 30, height=1 << 30, step=1 << 31)),
        (TAGS, "semantic", raw(width=8, height=8, step=4)),
        (TAGS, "semantic", raw(width=8, height=8, step=8, encoding="bayer")),
        (TAGS, "semantic", raw(width=8, height=9, step=8)),
        (TAGS, "semantic", raw(width=0, height=8, step=8)),
        *((POINTS, "points", cloud(*values)) for values in ((16, 1 << 30), (0, 0), (1 << 31, 0), (8, 8), (16, 0, ""))),
    ],
)
def test_what_contradicts_a_schema_is_an_error(tmp_path: Path, some: Sample, topic: str, data: bytes) -> None:
    with decoder_of(tmp_path, some) as decoder, pytest.raises(FormatError) as caught:
        decoder.decoded(TopicMessage(f"/sensors/own/{topic}", 1.5, data))
    assert f"a message of /sensors/own/{topic} at 1.5 s" in str(caught.value)


@pytest.mark.parametrize("size", [(1, 1), (1, LARGEST_SIDE), (LARGEST_SIDE, 1)])
def test_images_of_the_smallest_and_the_largest_size_are_decoded(tmp_path: Path, size: tuple[int, int]) -> None:
    data = raw(width=size[1], height=size[0], step=size[1], data=bytes(size[0] * size[1]))
    with decoder_of(tmp_path, TAGS) as decoder:
        assert decoder.decoded(TopicMessage("/sensors/own/semantic", 1.5, data)).shape == size  # type: ignore[union-attr]


def short_png(width: int, height: int) -> bytes:
    """Return a PNG whose header has a size, with hardly any pixels."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    found = b"\x89PNG\r\n\x1a\n"
    for name, data in ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(100)))):
        found += struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return found


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"no image", "is neither a JPEG nor a PNG or WebP"),
        (short_png(65_000, 65_000), "far too many pixels; 4096 pixels a side at most were expected"),
        (short_png(10_000, 9_500), "far too many pixels; 4096 pixels a side at most were expected"),
        (short_png(5_000, 10), "5000 x 10 pixels; 4096 pixels a side at most were expected"),
        (short_png(64, 48), "image file is truncated"),
        (short_png(64, 48) + bytes((0, 0, 0, 4)) + b"\xff" * 12, "broken PNG file"),
    ],
    ids=["none", "bomb", "large", "wide", "cut", "broken"],
)
def test_an_image_that_is_none_is_an_error(tmp_path: Path, data: bytes, why: str) -> None:
    body = CompressedImage(data=data, format="jpeg", frame_id="own").SerializeToString()
    path = record(tmp_path / "bad.mcap", SensorRig((CAMERA,)), [("/sensors/own/image", 0.5, body)])
    with open_recording(path) as recording:
        images = StoredImages(recording.reader, "own")
        with pytest.raises(FormatError, match=rf"an image of /sensors/own/image at 0.5 s: {why}"):
            images.at(0.6)
