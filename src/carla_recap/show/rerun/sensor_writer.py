"""The sensors of a recording: images on the pinholes of their cameras, points, and detections, in step with the scenes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import rerun as rr

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.sensors import kind_of
from carla_recap.scene.materials import TAG_COLORS, Tag
from carla_recap.sensors.decoding import H264, Calibration, EncodedImage, SensorDecoder
from carla_recap.sensors.encoding import jpeg, png
from carla_recap.sensors.rig import MOST_SENSORS
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.stream import TimeColumns, TimePoint, screen_radii

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader, TopicMessage
    from carla_recap.sensors.decoding import Decoded, SensorPose
    from carla_recap.show.rerun.stream import Stream

    Columns = Iterable[rr.ComponentColumn]

_NANOSECONDS: Final = 1e9
_POSE_SIZE: Final = 64  # bytes that a pose counts
_PLANE: Final = 2.0  # m from a camera to its image in the world
_METER: Final = 1000.0  # mm
_POINT: Final = 1.5  # points of the screen; the radius of a lidar's point
_DETECTION: Final = 4.0
_HEIGHTS: Final = (-3.0, 5.0)  # m below and above a lidar, between which colours change
_FASTEST: Final = 10.0  # m/s, towards a radar or away, from which on colours stay
_MOST_MOTION: Final = 20.0  # pixels, from which on the colours of optical flow are full
_RAMP: Final = np.array(((62, 70, 200), (40, 160, 230), (60, 200, 120), (240, 210, 70), (235, 80, 50)), np.float64)
_NEARING: Final = np.array((240.0, 80.0, 60.0))
_STEADY: Final = np.array((235.0, 235.0, 240.0))
_LEAVING: Final = np.array((80.0, 150.0, 255.0))


class SensorWriter:
    """Writes what the sensors of a recording measured between two moments, in elapsed seconds."""

    def __init__(self, stream: Stream, reader: Reader, start: float, stop: float) -> None:
        self._stream = stream
        self._decoder = SensorDecoder(reader)
        self._ids = {topic: id for id, sensor in self._decoder.sensors.items() for topic in sensor.topics}
        self._shown = set(list(self._decoder.sensors)[:MOST_SENSORS])
        self._messages: Iterator[TopicMessage] = self._decoder.messages(start, stop + 2 * SAME_TIME)
        self._next = next(self._messages, None)
        self._clock: TimeColumns | None = None
        self._begun: dict[str, object] = {}  # what was logged of an entity for all times

    def write(self, times: TimeColumns) -> None:
        """Write what was measured until the last scene of a batch."""
        self._clock = times if self._clock is None else TimeColumns.joined((self._clock.take(slice(-1, None)), times))
        last = self._clock.elapsed[-1] + SAME_TIME * _NANOSECONDS
        while self._next is not None and self._next.elapsed * _NANOSECONDS <= last:
            self._add(self._next)
            self._next = next(self._messages, None)

    def close(self) -> None:
        """Write what is held back."""
        self._stream.flush()

    def _add(self, message: TopicMessage) -> None:
        id, decoded = self._ids.get(message.topic), self._decoder.decoded(message)
        time = self._point(message.elapsed)
        if isinstance(decoded, dict):
            for name, pose in decoded.items():
                if name in self._shown:
                    self._stream.hold(entities.sensor(name), _transforms, time, pose, _POSE_SIZE)
        elif id in self._shown:
            assert id is not None
            self._add_data(id, kind_of(message.topic), time, decoded)

    def _add_data(self, id: str, kind: str, time: TimePoint, data: Decoded) -> None:
        path = entities.sensor(id, kind)
        if isinstance(data, Calibration):
            self._begin(entities.sensor(id), data, _pinhole)
        elif isinstance(data, EncodedImage):
            self._begin(path, data.format, _still_or_video)
            columns = _packets if data.format == H264 else _stills
            self._stream.hold(path, columns, time, data.data, len(data.data))
        elif isinstance(data, np.ndarray):
            if data.dtype.names is not None:
                self._begin(path, _DETECTION if "velocity" in data.dtype.names else _POINT, _points_of)
                points = _positions(data), _point_colors(data)
                self._stream.hold(path, _clouds, time, points, points[0].nbytes + points[1].nbytes)
            elif kind in ("semantic", "instance"):
                labels = data if data.ndim == 2 else np.ascontiguousarray(data[..., :2]).view("<u2")[..., 0]
                self._begin(path, (kind, labels.shape, labels.dtype.itemsize), _segmentation)
                self._stream.hold(path, _labels, time, labels.tobytes(), labels.nbytes)
            else:
                encoded = png(data) if data.dtype == np.uint16 else jpeg(_picture(data))
                self._begin(path, "depth" if data.dtype == np.uint16 else "jpeg", _still_or_video)
                self._stream.hold(path, _depths if data.dtype == np.uint16 else _stills, time, encoded, len(encoded))

    def _point(self, elapsed: float) -> TimePoint:
        """Return a time with the frame that was the latest then."""
        assert self._clock is not None
        nanoseconds = round(elapsed * _NANOSECONDS)
        row = int(np.searchsorted(self._clock.elapsed, nanoseconds + SAME_TIME * _NANOSECONDS, "right")) - 1
        return TimePoint(int(self._clock.frame[max(row, 0)]), nanoseconds)

    def _begin(self, path: str, key: Any, archetypes: Callable[[Any], Iterable[rr.AsComponents]]) -> None:
        """Log what an entity has at all times, if that is new."""
        if self._begun.get(path) != key:
            self._begun[path] = key
            self._stream.log_static(path, *archetypes(key))


def _pinhole(camera: Calibration) -> Iterable[rr.AsComponents]:
    pinhole = rr.Pinhole(
        resolution=(camera.width, camera.height), focal_length=camera.focal_length, image_plane_distance=_PLANE
    )
    return (pinhole,)


def _still_or_video(format: str) -> Iterable[rr.AsComponents]:
    if format == H264:
        return (rr.VideoStream(codec=rr.VideoCodec.H264),)
    if format == "depth":
        return (rr.EncodedDepthImage.from_fields(media_type="image/png", meter=_METER),)
    return (rr.EncodedImage.from_fields(media_type=f"image/{'jpeg' if format == 'jpg' else format}"),)


def _segmentation(key: tuple[str, tuple[int, int], int]) -> Iterable[rr.AsComponents]:
    kind, (height, width), size = key
    numbers = rr.ChannelDatatype.U8 if size == 1 else rr.ChannelDatatype.U16
    yield rr.SegmentationImage.from_fields(
        format=rr.components.ImageFormat(width, height, color_model="L", channel_datatype=numbers)
    )
    if kind == "semantic":
        yield rr.AnnotationContext([(tag.value, tag.name.lower().replace("_", " "), TAG_COLORS[tag]) for tag in Tag])
    else:
        yield rr.AnnotationContext([(0, "no actor", (0, 0, 0))])


def _points_of(radius: float) -> Iterable[rr.AsComponents]:
    return (rr.Points3D.from_fields(radii=screen_radii(radius)),)


def _transforms(poses: Sequence[SensorPose]) -> Columns:
    return rr.Transform3D.columns(
        translation=np.array([pose.location for pose in poses], np.float32),
        quaternion=np.array([pose.rotation for pose in poses], np.float32),
    )


def _blobs(archetype: Any, component: str, blobs: Sequence[bytes]) -> Columns:
    columns: Columns = archetype.columns(**{component: [np.frombuffer(blob, np.uint8) for blob in blobs]})
    return columns


_stills: Final = partial(_blobs, rr.EncodedImage, "blob")
_packets: Final = partial(_blobs, rr.VideoStream, "sample")
_depths: Final = partial(_blobs, rr.EncodedDepthImage, "blob")
_labels: Final = partial(_blobs, rr.SegmentationImage, "buffer")


def _clouds(clouds: Sequence[tuple[NDArray[np.float32], NDArray[np.uint8]]]) -> Columns:
    positions, colors = (np.concatenate(part) for part in zip(*clouds, strict=True))
    counts = [len(points) for points, _ in clouds]
    return [column.partition(counts) for column in rr.Points3D.columns(positions=positions, colors=colors)]


def _positions(points: NDArray[Any]) -> NDArray[np.float32]:
    found = np.stack([points[axis].astype(np.float32) for axis in "xyz"], axis=-1)
    return np.nan_to_num(found, copy=False, posinf=0.0, neginf=0.0)


def _point_colors(points: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the colours of points: by velocity, by tag, or by height; (n, 3)."""
    names = points.dtype.names or ()
    if "velocity" in names:
        share = np.clip(np.nan_to_num(points["velocity"].astype(np.float64)) / _FASTEST, -1.0, 1.0)[:, None]
        full = np.where(share < 0, _NEARING, _LEAVING)
        return np.asarray(_STEADY + np.abs(share) * (full - _STEADY), np.uint8)
    if "tag" in names:
        table = np.array(TAG_COLORS, np.uint8)
        return table[np.clip(points["tag"].astype(np.int64), 0, len(table) - 1)]
    low, high = _HEIGHTS
    steps = np.clip((np.nan_to_num(points["z"].astype(np.float64)) - low) / (high - low), 0.0, 1.0) * (len(_RAMP) - 1)
    places = np.arange(len(_RAMP))
    return np.stack([np.interp(steps, places, channel) for channel in _RAMP.T], axis=-1).astype(np.uint8)


def _picture(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a raw image as red, green and blue: normals as they are, motion by its direction and length."""
    if values.ndim == 3 and values.dtype == np.uint8:
        return np.ascontiguousarray(values[..., :3])
    if values.ndim == 2:  # grey, or a depth in m
        grey = values if values.dtype == np.uint8 else np.clip(np.nan_to_num(values), 0, 255).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    motion = np.nan_to_num(values.astype(np.float32))
    angle = np.arctan2(motion[..., 1], motion[..., 0])
    length = np.clip(np.hypot(motion[..., 0], motion[..., 1]) / _MOST_MOTION, 0.0, 1.0)
    waves = [0.5 + 0.5 * np.cos(angle - turn) for turn in (0.0, 2 * np.pi / 3, 4 * np.pi / 3)]
    return np.stack([255 * length * wave for wave in waves], axis=-1).astype(np.uint8)
