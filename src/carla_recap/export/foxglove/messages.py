"""Messages of Foxglove's schemas, serialized for many moments at once.

Consecutive messages of a topic differ only in numbers of a fixed size: a `Template` has the other bytes, and the rows of
an array have the numbers. Integers of protobuf differ in size; those of a timestamp are written with as many bytes
as the largest needs, which every reader accepts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.formats.mcap.schema import MESSAGE, SECOND

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
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3 as Vector3
except ImportError:
    raise MissingExtra("an export to Foxglove", "foxglove") from None

if TYPE_CHECKING:
    from collections.abc import Iterable

    from google.protobuf.message import Message
    from numpy.typing import DTypeLike, NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]
    Stamps = NDArray[np.uint8]
    Times = NDArray[np.uint64]

WORLD: Final = "world"
"""The frame of all positions."""

_LENGTH_DELIMITED: Final = 2  # wire type
_FORMATS: Final = {1: (1, "<f8"), 2: (5, "<f4"), 7: (5, "<u4"), 8: (0, "u1"), 15: (5, "<i4")}
"""Wire type and format by protobuf's type: double, float, fixed32, bool, sfixed32."""
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_VARINT: Final = 5  # bytes of the integers of a timestamp
_TIMESTAMP: Final = 2 * (1 + _VARINT)


@dataclass(frozen=True)
class Part:
    """A part of a serialized message.

    Attributes:
        data: The bytes, zeros in place of the numbers.
        numbers: The name, the format and the offset of each number.
    """

    data: bytes = b""
    numbers: tuple[tuple[str, DTypeLike, int], ...] = ()

    def __add__(self, other: Part) -> Part:
        """Return this part followed by another one."""
        moved = tuple((name, format, len(self.data) + offset) for name, format, offset in other.numbers)
        return Part(self.data + other.data, self.numbers + moved)

    def within(self, field: int) -> Part:
        """Return the part as a nested message, with the number of its field."""
        return Part(_varint(field << 3 | _LENGTH_DELIMITED) + _varint(len(self.data))) + self

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The type of an array whose items are this part."""
        names, formats, offsets = zip(*self.numbers, strict=True) if self.numbers else ((), (), ())
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self.data)})


class Messages(NamedTuple):
    """Messages of a topic.

    Attributes:
        topic: The topic.
        rows: The position of the moment of each message in a batch of moments, ascending.
        data: The messages as bytes, (messages, size), each behind `MESSAGE.size` bytes for the header of its record.
    """

    topic: str
    rows: Indices
    data: NDArray[np.uint8]


def single(topic: str, row: int, message: Message | bytes) -> Messages:
    """Return the only message of a topic."""
    data = message if isinstance(message, bytes) else message.SerializeToString()
    return Messages(topic, np.array([row]), np.frombuffer(bytearray(MESSAGE.size) + data, np.uint8)[None])


class Template:
    """A message that differs from moment to moment only in the numbers of its parts."""

    def __init__(self, *parts: Part) -> None:
        message = sum(parts, Part(bytes(MESSAGE.size)))
        self._data = np.frombuffer(message.data, np.uint8)
        self._dtype = message.dtype

    def messages(self, topic: str, rows: Indices) -> tuple[Messages, NDArray[np.void]]:
        """Return a message for each of some moments, and the numbers in them, which are to be filled in."""
        data = np.empty((len(rows), len(self._data)), np.uint8)
        data[:] = self._data
        return Messages(topic, rows, data), data.view(self._dtype)[:, 0]


def numbers(message: type[Message], names: Iterable[str], prefix: str = "") -> Part:
    """Return the fields of a message that hold numbers of a fixed size, which get the names of the fields."""
    part = Part()
    for name in names:
        field = message.DESCRIPTOR.fields_by_name[name]
        wire_type, format = _FORMATS[field.type]
        key = _varint(field.number << 3 | wire_type)
        part += Part(key + bytes(np.dtype(format).itemsize), ((prefix + name, format, len(key)),))
    return part


@cache
def pose_numbers(position: int, orientation: int, prefix: str = "") -> Part:
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


def timestamp(field: int, prefix: str = "") -> Part:
    """Return a timestamp, in a field of some number; see `timestamps`."""
    return Part(bytes(_TIMESTAMP), ((f"{prefix}timestamp", ("u1", (_TIMESTAMP,)), 0),)).within(field)


def timestamps(times: Times) -> Stamps:
    """Return times in ns since 1970 as they are filled in for a `timestamp`, (times, bytes)."""
    data = np.empty((len(times), 2, 1 + _VARINT), np.uint8)
    data[..., 0] = (1 << 3, 2 << 3)  # seconds, nanoseconds
    parts = np.stack(np.divmod(times, np.uint64(SECOND)), axis=1)
    data[..., 1:] = parts[..., None] >> np.arange(0, 7 * _VARINT, 7, dtype=np.uint64) & np.uint64(0x7F)
    data[..., 1:-1] |= 0x80
    return data.reshape(len(times), _TIMESTAMP)


def _varint(value: int) -> bytes:
    data = bytearray()
    while value > 0x7F:
        data.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*data, value))
