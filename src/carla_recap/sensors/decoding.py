"""Messages of sensors in a recording, decoded: images as they are stored or as arrays, points, and poses.

A recording may come from anybody: what contradicts a schema is a `FormatError`, and no message needs more memory than a few
times its own size, or that of the largest image.
"""

from __future__ import annotations

import warnings
from io import BytesIO
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import FormatError, MissingExtra, RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.sensors import IMAGES, RecordedSensor, kind_of, sensors
from carla_recap.sensors.encoding import load_pillow
from carla_recap.sensors.kinds import LARGEST_SIDE
from carla_recap.util.text import nearest, single_line

try:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
    from google.protobuf.message import DecodeError

    from carla_recap.sensors.messages import TRANSFORMS
except ImportError:
    raise MissingExtra("a recording of sensors", "foxglove") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader, TopicMessage

    Image = NDArray[np.uint8]

JPEG: Final = "jpeg"
H264: Final = "h264"

_STILL: Final = (JPEG, "jpg", "png", "webp")
_RAW: Final = {
    "16UC1": ("<u2", 1),
    "mono16": ("<u2", 1),
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "rgba8": ("u1", 4),
    "rgb8": ("u1", 3),
    "32FC1": ("<f4", 1),
    "32FC2": ("<f4", 2),
}
"""The types and numbers of the values of a pixel, by encoding."""
_NUMERIC: Final = {
    PackedElementField.UINT8: "u1",
    PackedElementField.INT8: "i1",
    PackedElementField.UINT16: "<u2",
    PackedElementField.INT16: "<i2",
    PackedElementField.UINT32: "<u4",
    PackedElementField.INT32: "<i4",
    PackedElementField.FLOAT32: "<f4",
    PackedElementField.FLOAT64: "<f8",
}
_KINDS: Final = (*IMAGES, "calibration", "points", "detections", kind_of(TRANSFORMS))
"""The kinds of messages that are decoded, of recordings that `sense` and `capture` write."""
_MOST_FIELDS: Final = 64  # of a point
_KEY_UNITS: Final = (5, 7)  # the types of H.264 units with which decoding can begin: an image, parameters
_LONGEST_GROUP: Final = 10.0  # s before a moment, in which the image before it, or the key frame of a video, is looked for


class EncodedImage(NamedTuple):
    """An image as it is stored, in the format `jpeg`, `jpg`, `png` or `webp`, or a packet of a video: `h264`."""

    data: bytes
    format: str


class Calibration(NamedTuple):
    """The width, the height and the focal length of a camera in pixels."""

    width: int
    height: int
    focal_length: float


class SensorPose(NamedTuple):
    """Where a sensor is in the world, in m, right-handed: (x, y, z), and the rotation as a quaternion (x, y, z, w).

    The axes of a camera are those of its image: to the right, down, forward; others are forward, left, up.
    """

    location: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


Decoded = EncodedImage | Calibration | dict[str, SensorPose] | np.ndarray[Any, Any]
"""An image as it is stored; what a camera is; the poses of sensors; or an array: raw images (height, width) or (height,
width, channels), and points as a structured array (n,) whose fields have the names of the message."""


class SensorDecoder:
    """Decodes the messages of the sensors of a recording.

    Args:
        reader: The recording.
        kinds: The last part of the names of the topics that count, such as `image`; None: all that can be decoded.

    Attributes:
        sensors: The sensors by their ids, in the order of the file.
        topics: The topics that are decoded.

    Raises:
        RecapError: There are no messages of such a kind that can be decoded, in this recording or another one.
    """

    def __init__(self, reader: Reader, kinds: Iterable[str] | None = None) -> None:
        wanted = None if kinds is None else frozenset(kinds)
        further = reader.further_topics()
        self._reader = reader
        self.sensors: dict[str, RecordedSensor] = {sensor.id: sensor for sensor in sensors(reader)}
        names = [name for sensor in self.sensors.values() for name in sensor.topics]
        known = {
            name: _DECODERS[further[name].topic.message]
            for name in (*names, *((TRANSFORMS,) if TRANSFORMS in further else ()))
            if further[name].topic.message in _DECODERS
        }
        there = dict.fromkeys((*map(kind_of, known), *_KINDS))
        for kind in wanted or ():
            if kind not in there:
                raise RecapError(f"{reader.location}: expected {nearest(kind, there)}, found the kind {kind!r:.200}")
        self._decoders = {name: decode for name, decode in known.items() if wanted is None or kind_of(name) in wanted}
        self.topics = list(self._decoders)

    def messages(self, start: float, stop: float) -> Iterator[TopicMessage]:
        """Yield the messages of all topics that are decoded, in order of time, in elapsed seconds.

        The first ones are the latest of before the start, as of then, but for packets of videos, which need those before.
        """
        earlier = (each for each in self._reader.latest_messages(self.topics, start) if kind_of(each.topic) != "video")
        shown = (each._replace(elapsed=start) for each in earlier if each.elapsed < start - SAME_TIME)
        return chain(shown, self._reader.further_messages(self.topics, start, stop))

    def decoded(self, message: TopicMessage) -> Decoded:
        """Return what a message says."""
        try:
            return self._decoders[message.topic](message.data)
        except (DecodeError, ValueError) as error:
            text = f"a message of {message.topic:.200} at {message.elapsed:g} s: {single_line(error):.200}"
            raise FormatError(self._reader.location, None, text) from None


def _image(data: bytes) -> EncodedImage:
    message = CompressedImage.FromString(data)
    if message.format not in _STILL:
        raise ValueError(f"an image in the format {message.format!r:.40}; one of {', '.join(_STILL)} was expected")
    return EncodedImage(message.data, message.format)


def _video(data: bytes) -> EncodedImage:
    message = CompressedVideo.FromString(data)
    if message.format != H264:
        raise ValueError(f"a video in the format {message.format!r:.40}; {H264} was expected")
    return EncodedImage(message.data, H264)


def _calibration(data: bytes) -> Calibration:
    message = CameraCalibration.FromString(data)
    width, height, focal = message.width, message.height, message.K[0] if len(message.K) == 9 else 0.0
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE and 0 < focal < np.inf):
        raise ValueError(f"a camera of {width} x {height} with a focal length of {focal:g}")
    return Calibration(width, height, float(focal))


def _transforms(data: bytes) -> dict[str, SensorPose]:
    found = {}
    for each in FrameTransforms.FromString(data).transforms:
        place, turn = each.translation, each.rotation
        pose = SensorPose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        if np.isfinite((*pose.location, *pose.rotation)).all():
            found[each.child_frame_id] = pose
    return found


def _raw_image(data: bytes) -> NDArray[Any]:
    message = RawImage.FromString(data)
    if message.encoding not in _RAW:
        raise ValueError(f"an image in the encoding {message.encoding!r:.40}")
    (dtype, channels), width, height = _RAW[message.encoding], message.width, message.height
    row = width * channels * np.dtype(dtype).itemsize
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE and row <= message.step <= len(message.data)):
        raise ValueError(f"an image of {width} x {height} with {message.step} bytes in a row")
    if len(message.data) < message.step * height:
        raise ValueError(f"{len(message.data)} bytes; {message.step * height} of an image were expected")
    rows = np.frombuffer(message.data, np.uint8, message.step * height).reshape(height, message.step)[:, :row]
    image = np.ascontiguousarray(rows).view(dtype)
    return image if channels == 1 else image.reshape(height, width, channels)


def _points(data: bytes) -> NDArray[Any]:
    message = PointCloud.FromString(data)
    fields = {each.name: each for each in message.fields[:_MOST_FIELDS] if each.type in _NUMERIC}
    stride = message.point_stride
    if not {"x", "y", "z"} <= fields.keys() or not 1 <= stride <= max(len(message.data), 1 << 16):
        raise ValueError(f"points with the fields {', '.join(fields) or 'none'} and {stride} bytes each")
    # With an offset beyond the stride, numpy raises `ValueError`.
    names, types = list(fields), [_NUMERIC[each.type] for each in fields.values()]
    offsets = [each.offset for each in fields.values()]
    dtype = np.dtype({"names": names, "formats": types, "offsets": offsets, "itemsize": stride})
    return np.frombuffer(message.data, dtype, len(message.data) // stride)


_DECODERS: Final[dict[str, Callable[[bytes], Decoded]]] = {
    schema.DESCRIPTOR.full_name: decode
    for schema, decode in (
        (CompressedImage, _image),
        (CompressedVideo, _video),
        (CameraCalibration, _calibration),
        (FrameTransforms, _transforms),
        (RawImage, _raw_image),
        (PointCloud, _points),
    )
}


class StoredImages:
    """The RGB images of a camera in a recording, as arrays; those that are not asked for are not decoded.

    Args:
        reader: The recording.
        id: The sensor.
        start: The first elapsed time that is asked for, in s.
        stop: The last one.

    Attributes:
        time: The elapsed time of the image that `at` has returned last, in s; None before the first one.

    Raises:
        RecapError: There are no images of such a sensor.
        MissingExtra: An optional dependency is not installed.
    """

    def __init__(self, reader: Reader, id: str, start: float = 0.0, stop: float = np.inf) -> None:
        self._decoder = SensorDecoder(reader, ("image", "video"))
        self._location = reader.location
        sensor = self._decoder.sensors.get(id)
        names = [name for name in self._decoder.topics if sensor is not None and name in sensor.topics]
        if not names:
            raise RecapError(f"{reader.location}: has no images of a sensor {id!r:.200}")
        begin = start - _LONGEST_GROUP
        self._messages = reader.further_messages(names[:1], begin, stop + 2 * SAME_TIME)
        self._next = next(self._messages, None)
        self._video = _Video() if kind_of(names[0]) == "video" else None
        self._latest: TopicMessage | None = None
        self._image: Image | None = None
        self.time: float | None = None

    @property
    def next_time(self) -> float | None:
        """The elapsed time of the image after the one that `at` has returned last, in s; None if there is none."""
        return None if self._next is None else self._next.elapsed

    def at(self, time: float) -> Image | None:
        """Return the latest image at a time; times have to ascend.

        Args:
            time: The time in elapsed seconds.

        Returns:
            Red, green, blue, (height, width, 3) of uint8; None before the first image.

        Raises:
            FormatError: It cannot be decoded.
        """
        while self._next is not None and self._next.elapsed <= time + SAME_TIME:
            self._latest, self._next = self._next, next(self._messages, None)
            if self._video is not None:
                self._decode(self._latest, self._video.decode)
        if self._video is None and self._latest is not None:
            self._decode(self._latest, _picture)
            self._latest = None
        return self._image

    def _decode(self, message: TopicMessage, decode: Callable[[bytes], Image | None]) -> None:
        """Decode a message; what is shown stays if it gives no image."""
        stored = self._decoder.decoded(message)
        assert isinstance(stored, EncodedImage)
        try:
            image = decode(stored.data)
        except (OSError, ValueError, EOFError) as error:
            text = f"an image of {message.topic:.200} at {message.elapsed:g} s: {single_line(error):.200}"
            raise FormatError(self._location, None, text) from None
        if image is not None:
            self._image, self.time = image, message.elapsed


def _picture(data: bytes) -> Image:
    """Return a JPEG, PNG or WebP as an array."""
    pillow = load_pillow()
    from PIL import UnidentifiedImageError

    too_large = f"{LARGEST_SIDE} pixels a side at most were expected"
    try:
        with (
            warnings.catch_warnings(action="error", category=pillow.DecompressionBombWarning),
            pillow.open(BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as image,
        ):
            if max(image.size) > LARGEST_SIDE:
                raise ValueError(f"{image.size[0]} x {image.size[1]} pixels; {too_large}")
            return np.asarray(image.convert("RGB"))
    except (pillow.DecompressionBombError, pillow.DecompressionBombWarning):
        raise ValueError(f"far too many pixels; {too_large}") from None
    except UnidentifiedImageError:
        raise ValueError("is neither a JPEG nor a PNG or WebP") from None
    except SyntaxError as error:  # of a PNG
        raise ValueError(str(error)) from None


class _Video:
    """Decodes the packets of a video from its first key frame on."""

    def __init__(self) -> None:
        try:
            import av
        except ImportError:
            raise MissingExtra("the video of a camera", "video") from None
        self._packet = av.Packet
        self._context: Any = av.CodecContext.create("h264", "r")
        self._context.thread_count = 1
        self._context.flags |= av.codec.context.Flags.low_delay
        self._has_begun = False

    def decode(self, data: bytes) -> Image | None:
        """Return the image of a packet; None before the first key frame, and of an empty one, which would end the video."""
        self._has_begun = self._has_begun or _begins(data)
        if not data or not self._has_begun:
            return None
        image = None
        for frame in self._context.decode(self._packet(data)):
            if max(frame.width, frame.height) > LARGEST_SIDE:
                raise ValueError(f"{frame.width} x {frame.height} pixels; {LARGEST_SIDE} a side at most were expected")
            image = frame.to_ndarray(format="rgb24")
        return image


def _begins(data: bytes) -> bool:
    """Return whether decoding can begin with a packet: its first units are parameters, or an image of its own."""
    start = data.find(b"\0\0\1", 0, 16)
    return start >= 0 and start + 3 < len(data) and data[start + 3] & 31 in _KEY_UNITS
