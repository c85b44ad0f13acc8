"""Messages of Foxglove's schemas, serialized for many moments at once.

Consecutive messages of a topic differ only in numbers of a fixed size: a `MessageTemplate` has the other bytes, and the
rows of an array have the numbers. Integers of protobuf differ in size; those of a timestamp are written with as many bytes
as the largest needs, which every reader accepts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor

from carla_recap.errors import MissingExtra
from carla_recap.formats.mcap.codec import FIXED32, FIXED64, LEN, VARINT, tag, varint
from carla_recap.formats.mcap.schema import SECOND

try:
    from foxglove_schemas_protobuf.Color_pb2 import Color as Color
    from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive as CubePrimitive
    from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive as CylinderPrimitive
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform as FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms as FrameTransforms
    from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair as KeyValuePair
    from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive as LinePrimitive
    from foxglove_schemas_protobuf.Log_pb2 import Log as Log
    from foxglove_schemas_protobuf.Point3_pb2 import Point3 as Point3
    from foxglove_schemas_protobuf.Pose_pb2 import Pose as Pose
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion as Quaternion
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity as SceneEntity
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion as SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate as SceneUpdate
    from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive as SpherePrimitive
    from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive as TextPrimitive
    from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive as TriangleListPrimitive
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3 as Vector3
except ImportError:
    raise MissingExtra("an export to Foxglove", "foxglove") from None

if TYPE_CHECKING:
    from collections.abc import Iterable

    from google.protobuf.message import Message
    from numpy.typing import DTypeLike, NDArray

    from carla_recap.scene.description import SceneDescription
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.util.arrays import Indices

    Stamps = NDArray[np.uint8]
    Times = NDArray[np.uint64]

WORLD: Final = "world"
"""The frame of all positions."""

ALL_DELETED: Final = SceneUpdate(deletions=[SceneEntityDeletion(type=SceneEntityDeletion.ALL)])
"""A message after which a topic shows nothing."""

_FORMATS: Final = {
    FieldDescriptor.TYPE_DOUBLE: (FIXED64, "<f8"),
    FieldDescriptor.TYPE_FLOAT: (FIXED32, "<f4"),
    FieldDescriptor.TYPE_FIXED32: (FIXED32, "<u4"),
    FieldDescriptor.TYPE_SFIXED32: (FIXED32, "<i4"),
    FieldDescriptor.TYPE_BOOL: (VARINT, "u1"),
}
"""Wire type and format of the numbers whose size is fixed."""
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_INTEGER: Final = 5  # bytes of the integers of a timestamp
_TIMESTAMP: Final = 2 * (1 + _INTEGER)


@dataclass(frozen=True)
class MessagePart:
    """A part of a serialized message."""

    data: bytes = b""  # the bytes, zeros in place of the numbers
    numbers: tuple[tuple[str, DTypeLike, int], ...] = ()  # the name, the format and the offset of each number

    def __add__(self, other: MessagePart) -> MessagePart:
        """Return this part followed by another one."""
        moved = tuple((name, format, len(self.data) + offset) for name, format, offset in other.numbers)
        return MessagePart(self.data + other.data, self.numbers + moved)

    def within(self, field: int) -> MessagePart:
        """Return the part as a nested message, with the number of its field."""
        return MessagePart(tag(field, LEN) + varint(len(self.data))) + self

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The type of an array whose items are this part."""
        names, formats, offsets = zip(*self.numbers, strict=True) if self.numbers else ((), (), ())
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self.data)})


class TopicMessages(NamedTuple):
    """Messages of a topic."""

    topic: str
    rows: Indices  # the position of the moment of each message in a batch of moments, ascending
    data: NDArray[np.uint8]  # the messages as bytes, (messages, size)
    change: bytes | None = None  # what the only one of them adds to the message before it; None: all of it


class ShownScenes(NamedTuple):
    """The scenes of a batch that are shown."""

    description: SceneDescription  # all scenes of the batch
    rows: Indices  # the positions of those that are shown, at least one
    stamps: Stamps  # the timestamp of each of these
    series: FollowedSeries  # the followed actor in these


def single(topic: str, row: int, message: Message | bytes) -> TopicMessages:
    """Return the only message of a topic."""
    data = message if isinstance(message, bytes) else message.SerializeToString()
    return TopicMessages(topic, np.array([row]), np.frombuffer(data, np.uint8)[None])


class MessageTemplate:
    """A message that differs from moment to moment only in the numbers of its parts."""

    def __init__(self, *parts: MessagePart) -> None:
        message = sum(parts, MessagePart())
        self._data = np.frombuffer(message.data, np.uint8)
        self._dtype = message.dtype

    def messages(self, topic: str, rows: Indices) -> tuple[TopicMessages, NDArray[np.void]]:
        """Return a message for each of some moments, and the numbers in them, which are to be filled in."""
        data = np.empty((len(rows), len(self._data)), np.uint8)
        data[:] = self._data
        return TopicMessages(topic, rows, data), np.ndarray(len(rows), self._dtype, data)


def numbers(message: type[Message], names: Iterable[str], prefix: str = "") -> MessagePart:
    """Return the fields of a message that hold numbers of a fixed size, which get the names of the fields."""
    part = MessagePart()
    for name in names:
        field = message.DESCRIPTOR.fields_by_name[name]
        wire_type, format = _FORMATS[field.type]
        start = tag(field.number, wire_type)
        part += MessagePart(start + bytes(np.dtype(format).itemsize), ((prefix + name, format, len(start)),))
    return part


@cache
def pose_numbers(position: int, orientation: int, prefix: str = "") -> MessagePart:
    """Return a position and an orientation, in fields of some numbers; see `fill_pose`."""
    xyz = numbers(Vector3, "xyz", prefix)
    return xyz.within(position) + numbers(Quaternion, "xyzw", f"{prefix}q").within(orientation)


def fill_pose(
    rows: NDArray[np.void], positions: NDArray[np.floating], quaternions: NDArray[np.floating], prefix: str = ""
) -> None:
    """Fill in the numbers of `pose_numbers`: x, y, z in m, and x, y, z, w."""
    for names, values in ((_POSE[:3], positions), (_POSE[3:], quaternions)):
        for column, name in enumerate(names):
            rows[prefix + name] = values[..., column]


def timestamp(field: int, prefix: str = "") -> MessagePart:
    """Return a timestamp, in a field of some number; see `timestamps`."""
    return MessagePart(bytes(_TIMESTAMP), ((f"{prefix}timestamp", ("u1", (_TIMESTAMP,)), 0),)).within(field)


def timestamps(times: Times) -> Stamps:
    """Return times in ns since 1970 as they are filled in for a `timestamp`, (times, bytes)."""
    data = np.empty((len(times), 2, 1 + _INTEGER), np.uint8)
    data[..., 0] = (1 << 3, 2 << 3)  # seconds, nanoseconds
    parts = np.stack(np.divmod(times, np.uint64(SECOND)), axis=1)
    data[..., 1:] = parts[..., None] >> np.arange(0, 7 * _INTEGER, 7, dtype=np.uint64) & np.uint64(0x7F)
    data[..., 1:-1] |= 0x80
    return data.reshape(len(times), _TIMESTAMP)
