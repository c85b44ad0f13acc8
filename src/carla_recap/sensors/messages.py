"""Samples of sensors as messages of Foxglove's schemas, for topics of a recording.

The frame of reference of a sensor has its id. That of a camera is its optical one, as Foxglove and ROS have it: x to the
right in the image, y down, z along the axis of view; all others have x forward, y left, z up.
"""

from __future__ import annotations

import json
import os
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.formats.mcap.container import message_topic
from carla_recap.formats.mcap.schema import SECOND, LogClock
from carla_recap.replay.pose import LOCATION, quaternions
from carla_recap.sensors.cameras import camera_of
from carla_recap.sensors.encoding import QUALITY, VideoStream, jpeg, millimetres
from carla_recap.v1.sensors_pb2 import ImuReading, SpeedReading

try:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
except ImportError:
    raise MissingExtra("a recording of sensors", "foxglove") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable, Iterator
    from concurrent.futures import Future

    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.formats.base import Topic
    from carla_recap.model.frame import Header
    from carla_recap.rendering.camera import Camera
    from carla_recap.sensors.rig import SensorRig, SensorSpec
    from carla_recap.sensors.sensing import Sample, SensedFrame

    Stamp = Any  # of google.protobuf.timestamp_pb2, which has no types

TRANSFORMS: Final = "/tf/sensors"
"""The topic of the poses of all sensors in the world."""
WORLD: Final = "world"
"""The frame of all positions."""

_AHEAD: Final = 2  # moments whose messages are made while one is used
_MOST_THREADS: Final = 8  # that make messages
_OPTICAL: Final = np.array([(1, 1, 1, 1), (-1, 1, 1, -1), (-1, -1, 1, 1), (-1, 1, -1, 1)]) / 2
"""What turns a rotation as a quaternion x, y, z, w from forward, left, up to right, down, forward."""
_STEPS: Final = 256.0  # in 1, of the numbers of points that are rounded: m, or without a unit
_FLOW_STEPS: Final = 64.0  # in a pixel
_ROUNDED: Final = ("x", "y", "z", "intensity", "cosine")
_KEY_INTERVAL: Final = 1.0  # s between two key frames of a video
_KMH: Final = 3.6
_NO_DISTORTION: Final = "plumb_bob"
_NUMERIC: Final = {"f4": PackedElementField.FLOAT32, "u4": PackedElementField.UINT32}


class SensorMessage(NamedTuple):
    """A message of a sensor."""

    topic: str  # the name of the topic
    elapsed: float  # its time in elapsed seconds
    data: bytes  # the message, serialized


class SensorMessages:
    """Makes the messages of the sensors of a rig, whose samples have to come in order of time.

    Args:
        rig: The rig.
        header: The header of the recording, which has the date.
        video: Whether RGB images are encoded as H.264, instead of each as a JPEG.
        quality: The quality of JPEGs.

    Attributes:
        topics: The topics of all sensors; those of a sensor have its specification in their metadata.

    Raises:
        RecapError: The images of a camera are too odd for a video.
        MissingExtra: An optional dependency is not installed.
    """

    def __init__(self, rig: SensorRig, header: Header, *, video: bool = False, quality: int = QUALITY) -> None:
        self._clock = LogClock(header)
        self._makers = {spec.id: _Maker(spec, video=video, quality=quality) for spec in rig}
        self.topics = [topic for maker in self._makers.values() for topic in maker.topics]
        self.topics.append(message_topic(TRANSFORMS, FrameTransforms))

    def of(self, samples: Iterable[Sample]) -> Iterator[SensorMessage]:
        """Yield the messages of samples of one moment: of each sensor, and of the poses of all."""
        samples = list(samples)
        for sample in samples:
            yield from self.of_sample(sample)
        yield from self.poses(samples)

    def of_sample(self, sample: Sample) -> Iterator[SensorMessage]:
        """Yield the messages of a sample, without that of its pose."""
        return self._makers[sample.spec.id].messages(sample, self._stamp(sample.time))

    def poses(self, samples: Collection[Sample]) -> Iterator[SensorMessage]:
        """Yield the message of the poses of samples of one moment, of which there is none without samples."""
        transforms, elapsed = FrameTransforms(), 0.0
        turns = quaternions(np.array([sample.pose for sample in samples]).reshape(-1, 6))
        for sample, turn in zip(samples, turns, strict=True):
            elapsed = sample.time
            found = transforms.transforms.add(
                timestamp=self._stamp(elapsed), parent_frame_id=WORLD, child_frame_id=sample.spec.id
            )
            found.translation.x, found.translation.y, found.translation.z = sample.pose[LOCATION].tolist()
            x, y, z, w = (turn if sample.spec.image is None else turn @ _OPTICAL).tolist()
            found.rotation.CopyFrom(Quaternion(x=x, y=y, z=z, w=w))
        if transforms.transforms:
            yield SensorMessage(TRANSFORMS, elapsed, transforms.SerializeToString())

    def encoded(self, frames: Iterable[SensedFrame]) -> Generator[tuple[SensedFrame, list[SensorMessage]]]:
        """Yield moments with their messages, which threads make while later moments are sensed."""
        waiting: deque[tuple[SensedFrame, list[Future[list[SensorMessage]]]]] = deque()
        threads = ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST_THREADS), "carla-recap-encoding")
        try:
            for frame in frames:
                waiting.append((frame, [self._begun(threads, sample) for sample in frame.samples.values()]))
                if len(waiting) > _AHEAD:
                    yield self._finished(*waiting.popleft())
            while waiting:
                yield self._finished(*waiting.popleft())
        finally:
            threads.shutdown(cancel_futures=True)

    def _begun(self, threads: ThreadPoolExecutor, sample: Sample) -> Future[list[SensorMessage]]:
        """Have the messages of a sample made, after those of the one before if they depend on it."""
        maker = self._makers[sample.spec.id]
        before = maker.before

        def messages() -> list[SensorMessage]:
            if before is not None:
                before.result()
            return list(self.of_sample(sample))

        found = threads.submit(messages)
        if maker.depends:
            maker.before = found
        return found

    def _finished(
        self, frame: SensedFrame, made: list[Future[list[SensorMessage]]]
    ) -> tuple[SensedFrame, list[SensorMessage]]:
        messages = [message for each in made for message in each.result()]
        return frame, [*messages, *self.poses(frame.samples.values())]

    def _stamp(self, elapsed: float) -> Stamp:
        from google.protobuf.timestamp_pb2 import Timestamp

        seconds, nanoseconds = divmod(self._clock.at(elapsed) or 0, SECOND)
        return Timestamp(seconds=seconds, nanos=nanoseconds)


class _Maker:
    """Makes the messages of a sensor."""

    def __init__(self, spec: SensorSpec, *, video: bool, quality: int) -> None:
        self._id = spec.id
        self._metadata = {"sensor": json.dumps(spec.to_dict())}
        self._quality = quality
        self._next_key = -np.inf
        self.before: Future[list[SensorMessage]] | None = None  # the messages that the next ones depend on
        self.topics: list[Topic] = []
        makers: dict[str, tuple[str, type[Message], Callable[[Any, Stamp, float], Message]]] = {
            "depth": ("depth", RawImage, self._depth),
            "semantic_segmentation": ("semantic", RawImage, self._semantic),
            "instance_segmentation": ("instance", RawImage, self._instance),
            "normals": ("normals", RawImage, self._normals),
            "optical_flow": ("flow", RawImage, self._flow),
            "lidar": ("points", PointCloud, self._points),
            "semantic_lidar": ("points", PointCloud, self._points),
            "radar": ("detections", PointCloud, self._detections),
            "gnss": ("fix", LocationFix, self._fix),
            "imu": ("imu", ImuReading, self._imu),
            "speedometer": ("speed", SpeedReading, self._speed),
            "rgb": ("image", CompressedImage, self._image),
        }
        name, schema, self._make = makers[spec.image or spec.kind]
        self._camera: Camera | None = None
        self._stream: VideoStream | None = None
        if spec.image is not None:
            self._camera = camera_of(spec, np.zeros(6))
            if video and spec.image == "rgb":
                name, schema, self._make = "video", CompressedVideo, self._video
                try:
                    self._stream = VideoStream(self._camera.width, self._camera.height)
                except MissingExtra:
                    raise
                except RecapError as error:
                    raise RecapError(f"sensor {spec.id!r}: {error}") from None
            self._calibration = self._add("calibration", CameraCalibration)
            self._calibrated = _calibration(self._id, self._camera)  # without a time
        self._topic = self._add(name, schema)

    @property
    def depends(self) -> bool:
        """Whether a message depends on the one before, as in a video."""
        return self._stream is not None

    def messages(self, sample: Sample, stamp: Stamp) -> Iterator[SensorMessage]:
        """Yield the messages of a sample."""
        if self._camera is not None:
            calibration = CameraCalibration(timestamp=stamp)
            calibration.MergeFrom(self._calibrated)
            yield SensorMessage(self._calibration, sample.time, calibration.SerializeToString())
        message = self._make(sample.data, stamp, sample.time)
        yield SensorMessage(self._topic, sample.time, message.SerializeToString())

    def _add(self, name: str, schema: type[Message]) -> str:
        """Add a topic, and return its name."""
        topic = message_topic(f"/sensors/{self._id}/{name}", schema, self._metadata)
        self.topics.append(topic)
        return topic.name

    def _image(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        data = jpeg(image, self._quality)
        return CompressedImage(timestamp=stamp, frame_id=self._id, data=data, format="jpeg")

    def _video(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        assert self._stream is not None
        is_key = time >= self._next_key
        if is_key:
            self._next_key = time + _KEY_INTERVAL
        data = self._stream.encode(image, is_key=is_key)
        return CompressedVideo(timestamp=stamp, frame_id=self._id, data=data, format="h264")

    def _depth(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        return self._raw(millimetres(image), "16UC1", stamp)

    def _semantic(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        return self._raw(image, "mono8", stamp)

    def _instance(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        opaque = np.uint32(0xFF00_0000)
        return self._raw((image | opaque).astype("<u4", copy=False), "rgba8", stamp)

    def _normals(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        return self._raw(np.rint(image * 127.5 + 127.5).astype(np.uint8), "rgb8", stamp)

    def _flow(self, image: NDArray[Any], stamp: Stamp, time: float) -> Message:
        rounded = np.rint(image * np.float32(_FLOW_STEPS)) / np.float32(_FLOW_STEPS)
        return self._raw(rounded.astype("<f4", copy=False), "32FC2", stamp)

    def _raw(self, image: NDArray[Any], encoding: str, stamp: Stamp) -> Message:
        height, width = image.shape[:2]
        step, data = image.nbytes // height, image.tobytes()
        return RawImage(
            timestamp=stamp, frame_id=self._id, width=width, height=height, encoding=encoding, step=step, data=data
        )

    def _detections(self, found: NDArray[Any], stamp: Stamp, time: float) -> Message:
        names = "x", "y", "z", *(found.dtype.names or ())
        points = np.zeros(len(found), [(name, "<f4") for name in names])
        for name in found.dtype.names or ():
            points[name] = found[name]
        level = found["depth"] * np.cos(found["altitude"])
        points["x"], points["y"] = level * np.cos(found["azimuth"]), level * np.sin(found["azimuth"])
        points["z"] = found["depth"] * np.sin(found["altitude"])
        return self._points(points, stamp, time)

    def _points(self, points: NDArray[Any], stamp: Stamp, time: float) -> Message:
        """Return a message of points; their coordinates are rounded to 1/256 m, by which they compress well."""
        rounded, fields = points.copy(), []
        for name, (dtype, offset, *_) in (points.dtype.fields or {}).items():
            fields.append(PackedElementField(name=name, offset=offset, type=_NUMERIC[dtype.str[1:]]))
            if name in _ROUNDED:
                rounded[name] = np.rint(points[name] * np.float32(_STEPS)) / np.float32(_STEPS)
        cloud = PointCloud(
            timestamp=stamp,
            frame_id=self._id,
            point_stride=points.dtype.itemsize,
            fields=fields,
            data=rounded.tobytes(),
        )
        cloud.pose.orientation.w = 1.0
        return cloud

    def _fix(self, fix: NDArray[Any], stamp: Stamp, time: float) -> Message:
        latitude, longitude, altitude = fix.item()
        return LocationFix(timestamp=stamp, frame_id=self._id, latitude=latitude, longitude=longitude, altitude=altitude)

    def _imu(self, inertia: NDArray[Any], stamp: Stamp, time: float) -> Message:
        found = ImuReading(elapsed=time, compass=float(inertia["compass"]))
        for name in ("acceleration", "angular_velocity"):
            for axis, value in zip("xyz", inertia[name].tolist(), strict=True):
                setattr(found, f"{name}_{axis}", value)
        return found

    def _speed(self, speed: NDArray[Any], stamp: Stamp, time: float) -> Message:
        return SpeedReading(elapsed=time, speed=float(speed), speed_kmh=float(speed) * _KMH)


def _calibration(id: str, camera: Camera) -> CameraCalibration:
    focal, across, down = camera.focal_length, camera.width / 2, camera.height / 2
    return CameraCalibration(
        frame_id=id,
        width=camera.width,
        height=camera.height,
        distortion_model=_NO_DISTORTION,
        D=(0.0,) * 5,
        K=(focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0),
        R=np.eye(3).ravel().tolist(),
        P=(focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0),
    )


def frame_rotation(spec: SensorSpec, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a sensor's frame as a quaternion x, y, z, w."""
    turn = quaternions(pose)
    return turn if spec.image is None else turn @ _OPTICAL
