"""Messages in protobuf's wire format: what all of them begin with, and those that hold no records.

Messages with records are in `fixed` and `variable`.
"""

from __future__ import annotations

import struct
from functools import cache, lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.formats.base import PIECE
from carla_recap.formats.mcap.schema import STRETCHES_MESSAGE
from carla_recap.model.layout import OBJECTS_LIMIT

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.model.layout import Buffer
    from carla_recap.model.stationary import BlockedRow

HEAD: Final = struct.Struct("<BQBd")  # fields 1 and 2 of every message: frame, elapsed
HEAD_DTYPE: Final = np.dtype([("frame_tag", "u1"), ("frame", "<u8"), ("elapsed_tag", "u1"), ("elapsed", "<f8")])
"""`HEAD` in arrays."""
FRAME_BODY: Final = struct.Struct("<Bd")  # field 3: duration
FRAME_HEAD: Final = np.dtype([*HEAD_DTYPE.descr, ("duration_tag", "u1"), ("duration", "<f8")])
"""`HEAD` and `FRAME_BODY` in arrays."""
FRAME_TAG, ELAPSED_TAG, DURATION_TAG, RAW_TAG = 0x09, 0x11, 0x19, 0x22
ITEMS: Final = 3  # the field that holds the records
VARINT, FIXED64, LEN, FIXED32 = 0, 1, 2, 5


class WireError(ValueError):
    """A message contradicts its schema."""


def head(frame: int, elapsed: float) -> bytes:
    """Return the first two fields of every message."""
    return HEAD.pack(FRAME_TAG, frame, ELAPSED_TAG, elapsed)


def read_head(data: Buffer) -> tuple[int, float] | None:
    """Return frame id and elapsed seconds of a message; None where they do not come first."""
    if len(data) < HEAD.size:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    return (frame, elapsed) if (tag1, tag2) == (FRAME_TAG, ELAPSED_TAG) else None


def have_heads(heads: NDArray[np.void]) -> bool:
    """Return whether messages begin with frame and elapsed, see `HEAD_DTYPE`, and a `Frame` with its duration."""
    tags = {"frame_tag": FRAME_TAG, "elapsed_tag": ELAPSED_TAG, "duration_tag": DURATION_TAG}
    return all(bool((heads[name] == tag).all()) for name, tag in tags.items() if name in (heads.dtype.names or ()))


def frame_body(duration: float, ids: bytes, kinds: bytes) -> bytes:
    """Return the body of a `Frame`: its duration, and the id and kind of each packet."""
    return FRAME_BODY.pack(DURATION_TAG, duration) + frame_packets(ids, kinds)


@lru_cache(maxsize=64)
def frame_packets(ids: bytes, kinds: bytes) -> bytes:
    """Return the part of a `Frame` that seldom changes: the id and kind of each packet."""
    return b"\x22" + varint(len(ids)) + ids + b"\x2a" + varint(len(kinds)) + kinds


def read_frame_packets(data: bytes) -> tuple[bytes, bytes] | None:
    """Return the ids and kinds that `frame_packets` wrote; None for other data, or more than 127 packets."""
    count = data[1] if len(data) > 1 else 0
    ids, kinds = data[2 : 2 + count], data[4 + count :]
    return (ids, kinds) if frame_packets(ids, kinds) == data else None


def read_frame(data: Buffer) -> tuple[int, float, float, bytes] | None:
    """Return frame id, elapsed, duration, and what `frame_packets` wrote; None where they are not in this order."""
    if len(data) < HEAD.size + FRAME_BODY.size:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    tag3, duration = FRAME_BODY.unpack_from(data, HEAD.size)
    if tag1 != FRAME_TAG or tag2 != ELAPSED_TAG or tag3 != DURATION_TAG:
        return None
    return frame, elapsed, duration, bytes(data[HEAD.size + FRAME_BODY.size :])


def raw_bodies(id: int, payload: Buffer) -> Iterator[bytes]:
    """Yield the bodies of the `RawPacket` messages of a packet that has no message of its own."""
    start = b"\x18" + varint(id) + b"\x21" + len(payload).to_bytes(8, "little")
    for offset in range(0, max(len(payload), 1), PIECE):
        piece = payload[offset : offset + PIECE]
        yield start + b"\x2a" + varint(len(piece)) + bytes(piece)


def tail(piece: bytes) -> bytes:
    """Return a `Tail` message."""
    return b"\x0a" + varint(len(piece)) + piece


def stationary_intervals(rows: Iterable[BlockedRow]) -> bytes:
    """Return the body of a `Stretches` message."""
    message: Any = message_class("stretches", STRETCHES_MESSAGE)()
    for row in rows:
        message.stretches.add(
            start=row.start, duration=row.duration, id=row.id, type_id=row.type_id, x=row.x, y=row.y, z=row.z
        )
    data: bytes = message.SerializeToString()
    return data


@cache
def message_class(module: str, name: str) -> type[Message]:
    """Return the generated class of a message. `module`: its file in `proto/carla_recap/v1`, named as the record type."""
    found: type[Message] = getattr(import_module(f"carla_recap.v1.{module}_pb2"), name.rpartition(".")[2])
    return found


def parse(module: str, name: str, data: Buffer) -> Any:
    """Return a message, parsed by protobuf; see `message_class`.

    Raises:
        WireError: It is none of that name, or too large to parse.
    """
    from google.protobuf.message import DecodeError

    if len(data) > OBJECTS_LIMIT:
        raise WireError(f"a {name} of at most {OBJECTS_LIMIT} bytes was expected, this has {len(data)}")
    message = message_class(module, name)()
    try:
        message.ParseFromString(bytes(data))
    except DecodeError as error:
        raise WireError(f"not a {name}: {error}") from None
    return message


@cache
def tag(number: int, wire_type: int) -> bytes:
    """Return what stands before a field."""
    return varint(number << 3 | wire_type)


def varint(value: int) -> bytes:
    """Return a whole number of at most 64 bits as protobuf writes it."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
