"""Messages of sensors, made of samples, and decoded."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("foxglove_schemas_protobuf")

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from carla_recap import open_recording
from carla_recap.errors import FormatError, RecapError
from carla_recap.formats.base import TopicMessage
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.sensors.decoding import Calibration, SensorDecoder, StoredImages
from carla_recap.sensors.kinds import LARGEST_SIDE
from carla_recap.sensors.messages import TRANSFORMS, SensorMessages
from carla_recap.sensors.ray_sensors import POINT
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import Sample
from tests.samples import drive
from tests.sensors.made import HEADER, HEIGHT, POSE, WIDTH, picture, sample

if TYPE_CHECKING:
    from pathlib import Path


def recorded(path: Path, samples: list[Sample], **options: Any) -> Path:
    """Write a recording with samples of one sensor."""
    with McapWriter(path, HEADER) as writer:
        messages = SensorMessages(SensorRig((samples[0].spec,)), HEADER, **options)
        for topic in messages.topics:
            writer.add_topic(topic)
        for frame in drive(3.0):
            writer.write(frame)
        for one in samples:
            for message in messages.of([one]):
                writer.write_message(*message)
    return path


def decoded(path: Path, topic: str) -> list[Any]:
    with open_recording(path) as recording:
        decoder = SensorDecoder(recording.reader)
        return [decoder.decoded(each) for each in decoder.messages(0, 10) if each.topic == topic]


def test_arrays_come_back(tmp_path: Path) -> None:
    depth = np.full((HEIGHT, WIDTH), 3.25, np.float32)
    path = recorded(tmp_path / "depth.mcap", [sample("sensor.camera.depth", depth)])
    assert (decoded(path, "/sensors/own/depth")[0] == 3250).all()
    assert decoded(path, "/sensors/own/calibration") == [pytest.approx(Calibration(WIDTH, HEIGHT, WIDTH / 2))]
    pose = decoded(path, TRANSFORMS)[0]["own"]
    assert pose.location == tuple(POSE[:3])
    motion = np.tile(np.array((-1.5, 20.25), np.float32), (HEIGHT, WIDTH, 1))
    path = recorded(tmp_path / "flow.mcap", [sample("sensor.camera.optical_flow", motion)])
    assert np.array_equal(decoded(path, "/sensors/own/flow")[0], motion)
    points = np.array([(1.0, -2.0, 0.5, 0.25), (3.0, 4.0, 5.0, 1.0)], POINT)
    path = recorded(tmp_path / "points.mcap", [sample("sensor.lidar.ray_cast", points)])
    assert decoded(path, "/sensors/own/points")[0].tolist() == points.tolist()


@pytest.mark.parametrize("video", [False, True])
def test_the_latest_image_at_a_time(tmp_path: Path, video: bool) -> None:
    pytest.importorskip("av")
    spec = sample("sensor.camera.rgb", picture()).spec
    samples = [Sample(spec, 0.5 + index * 0.1, POSE, np.roll(picture(), 4 * index, axis=1)) for index in range(15)]
    path = recorded(tmp_path / "images.mcap", samples, video=video)
    with open_recording(path) as recording:
        images = StoredImages(recording.reader, "own")
        assert images.at(0.4) is None
        for time, index in ((0.5, 0), (0.55, 0), (1.0, 5), (1.71, 12), (9.0, 14)):
            image = images.at(time)
            assert image is not None
            difference = np.abs(image[8:16].astype(int) - samples[index].data[8:16])
            assert np.median(difference) < 12
        later = StoredImages(recording.reader, "own", 1.74)
        image = later.at(1.74)
        assert image is not None
        assert np.median(np.abs(image[8:16].astype(int) - samples[12].data[8:16])) < 12
        with pytest.raises(RecapError, match=r"has no images of a sensor 'other'"):
            StoredImages(recording.reader, "other")


def damaged(path: Path, topic: str, data: bytes) -> FormatError:
    """Return the error of a message."""
    with open_recording(path) as recording:
        decoder = SensorDecoder(recording.reader)
        with pytest.raises(FormatError) as caught:
            decoder.decoded(TopicMessage(topic, 1.5, data))
    return caught.value


def test_what_contradicts_a_schema_is_an_error(tmp_path: Path) -> None:
    tags = np.zeros((HEIGHT, WIDTH), np.uint8)
    path = recorded(tmp_path / "tags.mcap", [sample("sensor.camera.semantic_segmentation", tags)])
    topic = "/sensors/own/semantic"
    assert "a message of /sensors/own/semantic at 1.5 s" in str(damaged(path, topic, b"\xff"))
    for values in (
        {"width": 1 << 30, "height": 1 << 30, "step": 1 << 31},
        {"width": 8, "height": 8, "step": 4},
        {"width": 8, "height": 8, "step": 8, "encoding": "bayer"},
        {"width": 8, "height": 9, "step": 8},
        {"width": 0, "height": 8, "step": 8},
    ):
        fields: dict[str, Any] = {"encoding": "mono8", "data": bytes(64), **values}
        assert "an image" in str(damaged(path, topic, RawImage(**fields).SerializeToString()))


@pytest.mark.parametrize("size", [(1, 1), (1, LARGEST_SIDE), (LARGEST_SIDE, 1)])
def test_images_of_the_smallest_and_the_largest_size_are_decoded(tmp_path: Path, size: tuple[int, int]) -> None:
    height, width = size
    image = RawImage(encoding="mono8", width=width, height=height, step=width, data=bytes(width * height))
    tags = np.zeros((HEIGHT, WIDTH), np.uint8)
    path = recorded(tmp_path / "tags.mcap", [sample("sensor.camera.semantic_segmentation", tags)])
    with open_recording(path) as recording:
        message = TopicMessage("/sensors/own/semantic", 1.5, image.SerializeToString())
        assert SensorDecoder(recording.reader).decoded(message).shape == size


def test_points_beyond_their_data_are_an_error(tmp_path: Path) -> None:
    path = recorded(tmp_path / "points.mcap", [sample("sensor.lidar.ray_cast", np.zeros(1, POINT))])
    for stride, offset in ((16, 1 << 30), (0, 0), (1 << 31, 0), (8, 8)):
        cloud = PointCloud(point_stride=stride, data=bytes(64))
        for name in "xyz":
            cloud.fields.add(name=name, offset=offset, type=7)
        damaged(path, "/sensors/own/points", cloud.SerializeToString())
    damaged(path, "/sensors/own/points", PointCloud(point_stride=16, data=bytes(64)).SerializeToString())


def short_png(width: int, height: int) -> bytes:
    """Return a PNG whose header has a size, with hardly any pixels."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    found = b"\x89PNG\r\n\x1a\n"
    for name, data in ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(100)))):
        found += struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return found


@pytest.mark.parametrize(
    ("data", "message"),
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
def test_an_image_that_is_none_is_an_error(tmp_path: Path, data: bytes, message: str) -> None:
    spec = sample("sensor.camera.rgb", picture()).spec
    with McapWriter(tmp_path / "bad.mcap", HEADER) as writer:
        messages = SensorMessages(SensorRig((spec,)), HEADER)
        for topic in messages.topics:
            writer.add_topic(topic)
        for frame in drive(1.0):
            writer.write(frame)
        body = CompressedImage(data=data, format="jpeg", frame_id="own").SerializeToString()
        writer.write_message("/sensors/own/image", 0.5, body)
    with open_recording(tmp_path / "bad.mcap") as recording:
        images = StoredImages(recording.reader, "own")
        with pytest.raises(FormatError, match=rf"an image of /sensors/own/image at 0.5 s: {message}"):
            images.at(0.6)


def test_a_video_with_an_empty_packet_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("av")
    spec = sample("sensor.camera.rgb", picture()).spec
    source = recorded(
        tmp_path / "video.mcap", [Sample(spec, 0.1 * index, POSE, picture()) for index in range(3)], video=True
    )
    with open_recording(source) as recording:
        packets = [each.data for each in recording.reader.further_messages(["/sensors/own/video"])]
    packets.insert(1, CompressedVideo(format="h264", frame_id="own").SerializeToString())
    with McapWriter(tmp_path / "empty.mcap", HEADER) as writer:
        for topic in SensorMessages(SensorRig((spec,)), HEADER, video=True).topics:
            writer.add_topic(topic)
        for frame in drive(1.0):
            writer.write(frame)
        for index, packet in enumerate(packets):
            writer.write_message("/sensors/own/video", 0.1 * index, packet)
    with open_recording(tmp_path / "empty.mcap") as recording:
        images = StoredImages(recording.reader, "own")
        assert images.at(0.9) is not None
        assert images.time == pytest.approx(0.3)
