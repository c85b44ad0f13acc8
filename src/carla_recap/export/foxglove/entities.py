"""Entities of a 3D scene, serialized without an object for each of them in each frame.

Of an entity only its pose and its time change from frame to frame, and these have a fixed size on the wire: they come last,
behind a head that is made once. Protobuf's integers differ in length, so all are written with as many bytes as the largest
needs, which every reader takes.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.foxglove.schemas import (
    Color,
    CubePrimitive,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    Vector3,
)
from carla_recap.formats.mcap.schema import SECOND

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.export.style import Color as Rgb

    Floats = NDArray[np.float64]

WORLD: Final = "world"
CUBES: Final = SceneEntity.CUBES_FIELD_NUMBER
SPHERES: Final = SceneEntity.SPHERES_FIELD_NUMBER

# The end of an entity: pose, the last field of its primitive, with a tag before each number; and timestamp.
_NUMBERS: Final = {
    "x": b"\x0a\x43\x0a\x1b\x09",
    "y": b"\x11",
    "z": b"\x19",
    "qx": b"\x12\x24\x09",
    "qy": b"\x11",
    "qz": b"\x19",
    "qw": b"\x21",
}
_POSE: Final = b"".join(tag + bytes(8) for tag in _NUMBERS.values())
_TIMESTAMP: Final = b"\x0a\x0c"  # and 12 bytes
_TAIL: Final = np.dtype(
    {
        "names": list(_NUMBERS),
        "formats": ["<f8"] * len(_NUMBERS),
        "offsets": [end - 8 for end in accumulate(len(tag) + 8 for tag in _NUMBERS.values())],
        "itemsize": len(_POSE) + len(_TIMESTAMP) + 12,
    }
)
_LEN: Final = 2  # wire type


def color(rgb: Rgb, opacity: float = 1.0) -> Color:
    """A colour of Foxglove's."""
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=opacity)


def head(entity: SceneEntity, primitive: int, size: tuple[float, float, float], shade: Color) -> bytes:
    """An entity of a `SceneUpdate` with a primitive that moves, but for its end; see `Heads`.

    Args:
        entity: What else there is of it, without a timestamp.
        primitive: `CUBES` or `SPHERES`, which have the same fields.
        size: Of the primitive, along each of its axes, in m.
        shade: Its colour.
    """
    start = entity.SerializeToString()
    shape = CubePrimitive(size=Vector3(x=size[0], y=size[1], z=size[2]), color=shade).SerializeToString()
    start += _prefix(primitive, len(shape) + len(_POSE)) + shape
    return _prefix(SceneUpdate.ENTITIES_FIELD_NUMBER, len(start) + _TAIL.itemsize) + start


class Heads:
    """The heads of the entities of a message, and where their ends go.

    Args:
        heads: Of each entity its `head`.
    """

    def __init__(self, heads: Iterable[bytes]) -> None:
        parts = [start + bytes(_TAIL.itemsize) for start in heads]
        self._template = np.frombuffer(b"".join(parts), np.uint8)
        self._ends = list(accumulate(map(len, parts)))

    def updates(self, positions: Floats, quaternions: Floats, times: Sequence[int]) -> list[bytes]:
        """Return a `SceneUpdate` for each of some times.

        Args:
            positions: x, y, z in m, (times, entities, 3).
            quaternions: x, y, z, w, (times, entities, 4).
            times: Nanoseconds since 1970.
        """
        tails = self._tails(positions, quaternions, times)
        messages = np.empty((len(times), len(self._template)), np.uint8)
        messages[:] = self._template
        for number, end in enumerate(self._ends):
            messages[:, end - _TAIL.itemsize : end] = tails[:, number]
        return [message.tobytes() for message in messages]

    def _tails(self, positions: Floats, quaternions: Floats, times: Sequence[int]) -> NDArray[np.uint8]:
        """Return the ends of the entities as bytes, (times, entities, bytes)."""
        shape = (len(times), len(self._ends))
        tails = np.empty((*shape, _TAIL.itemsize), np.uint8)
        stamped = [_POSE + _TIMESTAMP + _timestamp(time) for time in times]
        tails[:] = np.frombuffer(b"".join(stamped), np.uint8).reshape(len(times), 1, _TAIL.itemsize)
        rows = tails.view(_TAIL)[..., 0]
        # Numbers of less precision, far below what can be seen, make a smaller file.
        with np.errstate(over="ignore"):
            numbers = np.concatenate((positions, quaternions), axis=2).astype(np.float32)
        for column, name in enumerate(_NUMBERS):
            rows[name] = numbers[..., column]
        return tails


def deletions(deleted: Iterable[str], time: int) -> bytes:
    """The part of a `SceneUpdate` that says which entities are gone.

    Args:
        deleted: The entities.
        time: Nanoseconds since 1970.
    """
    gone = [SceneEntityDeletion(type=SceneEntityDeletion.MATCHING_ID, id=id) for id in deleted]
    for deletion in gone:
        deletion.timestamp.FromNanoseconds(time)
    return SceneUpdate(deletions=gone).SerializeToString() if gone else b""


def _timestamp(time: int) -> bytes:
    """The fields of a `google.protobuf.Timestamp`."""
    seconds, nanoseconds = divmod(time, SECOND)
    return b"\x08" + _varint(seconds) + b"\x10" + _varint(nanoseconds)


def _prefix(field: int, size: int) -> bytes:
    """What stands before a message in a field, one of the first fifteen."""
    return bytes((field << 3 | _LEN,)) + _varint(size)


def _varint(value: int) -> bytes:
    """A number below 2³⁵, in 5 bytes."""
    return bytes(value >> shift & 0x7F | 0x80 for shift in (0, 7, 14, 21)) + bytes((value >> 28,))
