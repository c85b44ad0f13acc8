"""A packet's payload ↔ its protobuf message, without an object in between.

Both are the same numbers in another setting: all numbers have a fixed size in the schemas, so a message is its payload's
bytes, moved, between bytes that depend only on the packet's *structure*: counts and texts. Where records have one size the
packets of a whole chunk are moved column by column; where it varies, the last structure is remembered, and a packet is one
gather. A message that does not look as this module writes it is parsed by protobuf.

A payload that no message can give back byte for byte (a flag of 2, broken UTF-8, surplus bytes) goes along in the message's
field `raw`.
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from importlib import import_module
from itertools import accumulate, pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.formats.base import PIECE
from carla_recap.formats.mcap.schema import STRETCHES_MESSAGE
from carla_recap.model.layout import MAX_COUNT, OBJECTS_LIMIT, U16, Buffer, PayloadError, need, pack
from carla_recap.model.records import FLAG, REAL, TEXT, Framing, Group, Layout, Many, Records, RecordType

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.model.stationary import BlockedRow

HEAD: Final = struct.Struct("<BQBd")  # fields 1 and 2 of every message: frame, elapsed
FRAME_BODY: Final = struct.Struct("<Bd")  # field 3: duration
FRAME_TAG, ELAPSED_TAG, DURATION_TAG, RAW_TAG = 0x09, 0x11, 0x19, 0x22
ITEMS: Final = 3  # the field that holds the records

_VARINT, _FIXED64, _LEN, _FIXED32 = 0, 1, 2, 5
_WIRE_TYPES: Final = {"u4": _FIXED32, "i4": _FIXED32, "f4": _FIXED32, "u8": _FIXED64, "f8": _FIXED64}
_LEAF: Final = 256  # in an index: below, the byte itself; from here on, a place in the source
_LEAST: Final = 7  # bytes of a record with nothing but an id
_ELAPSED_AT: Final = 9  # in a message: where the tag of elapsed stands
_POOL: Final = bytes(range(_LEAF))
FRAME_HEAD: Final = np.dtype(
    [
        ("frame_tag", "u1"),
        ("frame", "<u8"),
        ("elapsed_tag", "u1"),
        ("elapsed", "<f8"),
        ("duration_tag", "u1"),
        ("duration", "<f8"),
    ]
)
"""What a `Frame` message begins with."""
_HEAD: Final = np.dtype([("frame_tag", "u1"), ("frame", "<u8"), ("elapsed_tag", "u1"), ("elapsed", "<f8")])


class WireError(ValueError):
    """A message contradicts its schema."""


def head(frame: int, elapsed: float) -> bytes:
    """The first two fields of every message."""
    return HEAD.pack(FRAME_TAG, frame, ELAPSED_TAG, elapsed)


def frame_body(duration: float, ids: bytes, kinds: bytes) -> bytes:
    """The body of a `Frame`: its duration, and the id and kind of each packet."""
    return FRAME_BODY.pack(DURATION_TAG, duration) + frame_packets(ids, kinds)


@lru_cache(maxsize=64)
def frame_packets(ids: bytes, kinds: bytes) -> bytes:
    """The part of a `Frame` that seldom changes: the id and kind of each packet."""
    return b"\x22" + _varint(len(ids)) + ids + b"\x2a" + _varint(len(kinds)) + kinds


def read_frame(data: Buffer) -> tuple[int, float, float, bytes] | None:
    """Frame id, elapsed, duration, and what `frame_packets` wrote; None where they are not in this order."""
    if len(data) < HEAD.size + FRAME_BODY.size:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    tag3, duration = FRAME_BODY.unpack_from(data, HEAD.size)
    if tag1 != FRAME_TAG or tag2 != ELAPSED_TAG or tag3 != DURATION_TAG:
        return None
    return frame, elapsed, duration, bytes(data[HEAD.size + FRAME_BODY.size :])


def raw_bodies(id: int, payload: Buffer) -> Iterator[bytes]:
    """Bodies of `RawPacket` messages of a packet that has no message of its own."""
    start = b"\x18" + _varint(id) + b"\x21" + len(payload).to_bytes(8, "little")
    for at in range(0, max(len(payload), 1), PIECE):
        piece = payload[at : at + PIECE]
        yield start + b"\x2a" + _varint(len(piece)) + bytes(piece)


def tail(piece: bytes) -> bytes:
    """A `Tail` message."""
    return b"\x0a" + _varint(len(piece)) + piece


def stretches(rows: Iterable[BlockedRow]) -> bytes:
    """The body of a `Stretches` message."""
    message: Any = message_class("stretches", STRETCHES_MESSAGE)()
    for row in rows:
        message.stretches.add(**asdict(row))
    data: bytes = message.SerializeToString()
    return data


def read_head(data: Buffer) -> tuple[int, float] | None:
    """Frame id and elapsed seconds of a message; None where they do not come first."""
    if len(data) < HEAD.size:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    return (frame, elapsed) if (tag1, tag2) == (FRAME_TAG, ELAPSED_TAG) else None


def expected_size(type: RecordType, payload: Buffer) -> int | None:
    """The size of a body, where it is known without encoding: records of one size, and not a byte besides."""
    uniform = _uniforms.get(type)
    if uniform is None:
        if not type.fixed:
            return None
        uniform = _uniform(type)
    if uniform.single:
        return uniform.stride if len(payload) == uniform.size else None
    count = payload[0] | payload[1] << 8 if len(payload) > 1 else 0
    return count * uniform.stride if len(payload) == U16.size + count * uniform.size else None


def uniform_body(type: RecordType, count: int) -> tuple[bytes, np.dtype[np.void]]:
    """The body of a message of so many records of one size, all of them zero, and the layout of a record in it."""
    uniform = _uniform(type)
    return uniform.blank.tobytes() * count, uniform.wire


def fits(type: RecordType, records: NDArray[np.void]) -> bool:
    """Whether all numbers of records of one size have the size that they have in `uniform_body`."""
    return _uniform(type).fits(records)


def fill(type: RecordType, body: NDArray[np.void], records: NDArray[np.void]) -> None:
    """Put records that fit where their bodies are, of the layout of `uniform_body`."""
    _uniform(type).fill(body, records)


def encode(type: RecordType, payload: Buffer) -> bytes:
    """The body of a message, to go behind its head.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    if type.fixed:
        return bytes(encode_many(type, [payload])[0])
    shape = _shapes.get(type)
    body = shape.encode(payload) if shape else None
    if body is None:
        body, shape = _weave(type, payload)
        if shape and type.group is Group.STATE:
            _shapes[type] = shape
    return body


def encode_many(type: RecordType, payloads: Sequence[Buffer]) -> Sequence[Buffer]:
    """The bodies of messages of a type whose records have one size, all at once.

    Raises:
        PayloadError: A payload contradicts the type's layout.
    """
    return _uniform(type).encode(payloads) or [_weave(type, payload)[0] for payload in payloads]


def decode(type: RecordType, data: Buffer) -> bytes:
    """The payload of a message.

    Raises:
        WireError: The message contradicts its schema.
    """
    if type.fixed:
        found = decode_many(type, [data])
        payload = found.payload(0) if found else None
    else:
        shape = _shapes.get(type)
        payload = shape.decode(data) if shape else None
    return _decode_any(type, data) if payload is None else payload


def decode_many(type: RecordType, messages: Sequence[Buffer]) -> Payloads | None:
    """The payloads of messages of a type whose records have one size, all at once.

    None where a message does not look as this module writes it: each is to be decoded by itself.
    """
    return _uniform(type).decode(messages)


def uniform_count(type: RecordType, size: int) -> int | None:
    """Return the number of records of one size in a body of some bytes; None where that cannot be."""
    uniform = _uniform(type)
    count, rest = divmod(size, uniform.stride)
    return None if size < 0 or rest or count > MAX_COUNT or (uniform.single and count != 1) else count


def are_frames(heads: NDArray[np.void]) -> bool:
    """Return whether `Frame` messages begin with frame, elapsed and duration; see `FRAME_HEAD`."""
    fields = zip(("frame_tag", "elapsed_tag", "duration_tag"), (FRAME_TAG, ELAPSED_TAG, DURATION_TAG), strict=True)
    return all(bool((heads[name] == tag).all()) for name, tag in fields)


def have_heads(heads: NDArray[np.uint8]) -> bool:
    """Return whether messages begin with frame and elapsed, from their first bytes, (messages, `HEAD.size`)."""
    return bool((heads[:, 0] == FRAME_TAG).all() and (heads[:, _ELAPSED_AT] == ELAPSED_TAG).all())


def is_uniform(type: RecordType, bodies: NDArray[np.uint8]) -> bool:
    """Return whether bodies of records of one size look as this module writes them, (messages, bytes)."""
    return _uniform(type).matches(bodies)


def uniform_record(type: RecordType) -> np.dtype[np.void]:
    """Return where the fields of a record stand in a uniform body."""
    return _uniform(type).wire


def encode_rows(type: RecordType, payloads: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the bodies of messages of varying size that have the structure of the first payload, (messages, bytes).

    None where a payload has another structure, or one that its message does not give back.

    Raises:
        PayloadError: The first payload contradicts the type's layout.
    """
    encode(type, payloads[0].tobytes())
    shape = _shapes.get(type)
    return shape.encode_rows(payloads) if shape else None


def decode_rows(type: RecordType, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the payloads of messages of varying size that have the structure of the first one, (messages, bytes).

    None where one of them has another.

    Raises:
        WireError: The first message contradicts its schema.
    """
    decode(type, messages[0].tobytes())
    shape = _shapes.get(type)
    return shape.decode_rows(messages) if shape else None


def decode_records(type: RecordType, data: Buffer) -> Records | None:
    """The records of a message of varying size, by way of protobuf; None where its payload is to be taken.

    Raises:
        WireError: The message contradicts its schema.
    """
    message = parse(type.name, type.message_name, data)
    if message.HasField("raw"):
        return None
    return _records(type, message, len(data))


@cache
def message_class(module: str, name: str) -> type[Message]:
    """The generated class of a message. `module`: its file in `proto/carla_recap/v1`, named as the record type."""
    found: type[Message] = getattr(import_module(f"carla_recap.v1.{module}_pb2"), name.rpartition(".")[2])
    return found


def parse(module: str, name: str, data: Buffer) -> Any:
    """A message, parsed by protobuf; see `message_class`.

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


# --- one structure: what the numbers are set in ------------------------------------------------------------------------


class Payloads:
    """Payloads of packets of one type, decoded together.

    Args:
        counts: Whether each payload begins with its number of records.
        records: The records of all of them, one after the other.
        ends: Where the records of each end.
    """

    def __init__(self, records: NDArray[np.void], ends: list[int], *, counts: bool) -> None:
        records.setflags(write=False)
        self._records = records
        self._bytes = records.view(np.uint8).data if len(records) else memoryview(b"")
        self._size = records.dtype.itemsize
        self._ends = ends
        self._counts = counts

    def records(self, place: int) -> NDArray[np.void]:
        """The records of one payload."""
        return self._records[self._ends[place - 1] if place else 0 : self._ends[place]]

    def payload(self, place: int) -> bytes:
        """The bytes of one payload."""
        start, end = self._ends[place - 1] if place else 0, self._ends[place]
        data = self._bytes[start * self._size : end * self._size]
        return U16.pack(end - start) + data if self._counts else bytes(data)


class _Uniform:
    """Packets of records of one size: between the numbers of a record stand always the same bytes.

    Attributes:
        single: Whether a payload is one record, without a count.
        size, stride: Bytes of a record in a payload, and in a message.
        blank: A record in a message, all of whose numbers are zero.
        wire: Where the numbers stand in it.
    """

    def __init__(self, type: RecordType) -> None:
        self._type = type
        self.single = type.framing is Framing.SINGLE
        self.size = type.dtype.itemsize
        weaver = _Weaver(type, bytes(type.dtype.itemsize))
        weaver.record(type.layout, 0)
        index, mask = np.array(weaver.index), np.frombuffer(weaver.mask, np.uint8)
        self.stride = len(index)
        fields: Mapping[str, Any] = type.dtype.fields or {}
        offsets = {name: int(np.flatnonzero(index == _LEAF + place)[0]) for name, (_, place, *_) in fields.items()}
        self.wire = np.dtype(
            {
                "names": list(fields),
                "formats": [dtype for dtype, *_ in fields.values()],
                "offsets": list(offsets.values()),
                "itemsize": self.stride,
            }
        )
        self._setting = [(int(place), index[place].astype(np.uint8)) for place in np.flatnonzero(mask == 0xFF)]
        self.blank = np.where(mask == 0xFF, index, 0).astype(np.uint8).view(np.void(self.stride).dtype)
        # The bits that a one-byte number must leave alone, or it would not fit a varint of one byte.
        self._loose = {name: mask[offset] for name, offset in offsets.items() if mask[offset]}

    def encode(self, payloads: Sequence[Buffer]) -> list[memoryview] | None:
        sizes = [expected_size(self._type, payload) for payload in payloads]
        if None in sizes:
            return None
        start = 0 if self.single else U16.size
        records = np.frombuffer(b"".join([memoryview(payload)[start:] for payload in payloads]), self._type.dtype)
        if not self.fits(records):
            return None
        rows = np.empty(len(records), self.blank.dtype)
        rows[:] = self.blank
        self.fill(rows.view(self.wire), records)
        data = rows.view(np.uint8).data if len(rows) else memoryview(b"")
        ends = [0, *accumulate(size or 0 for size in sizes)]
        return [data[at:end] for at, end in pairwise(ends)]

    def fits(self, records: NDArray[np.void]) -> bool:
        return not any((records[name].view(np.uint8) & loose).any() for name, loose in self._loose.items())

    def fill(self, body: NDArray[np.void], records: NDArray[np.void]) -> None:
        for name in self.wire.names or ():
            body[name] = records[name]

    def matches(self, bodies: NDArray[np.uint8]) -> bool:
        records = bodies.reshape(len(bodies), bodies.shape[1] // self.stride, self.stride)
        if any((records[:, :, place] != value).any() for place, value in self._setting):
            return False
        fields: Mapping[str, Any] = self.wire.fields or {}
        return not any((records[:, :, fields[name][1]] & loose).any() for name, loose in self._loose.items())

    def decode(self, messages: Sequence[Buffer]) -> Payloads | None:
        sizes = [len(message) - HEAD.size for message in messages]
        if any(size < 0 or size % self.stride or size > MAX_COUNT * self.stride for size in sizes):
            return None
        if self.single and any(size != self.stride for size in sizes):
            return None
        heads = np.frombuffer(b"".join([message[: HEAD.size] for message in messages]), _HEAD)
        if (heads["frame_tag"] != FRAME_TAG).any() or (heads["elapsed_tag"] != ELAPSED_TAG).any():
            return None
        wire = np.frombuffer(b"".join([message[HEAD.size :] for message in messages]), self.wire)
        columns = wire.view(np.uint8).reshape(-1, self.stride)
        if any((columns[:, place] != value).any() for place, value in self._setting):
            return None
        if any((wire[name].view(np.uint8) & loose).any() for name, loose in self._loose.items()):
            return None
        records = np.empty(len(wire), self._type.dtype)
        for name in self.wire.names or ():
            records[name] = wire[name]
        ends = list(accumulate(size // self.stride for size in sizes))
        return Payloads(records, ends, counts=not self.single)


@dataclass(frozen=True)
class _Shape:
    """One structure of packets of varying size; whoever records walkers or wheels writes the same one frame after frame.

    Attributes:
        payload, wire: A packet of this structure, and its message body.
        payload_mask, wire_mask: The bits in which all packets of this structure agree.
        to_wire, to_payload: Where each byte comes from.
    """

    payload: NDArray[np.uint8]
    wire: NDArray[np.uint8]
    payload_mask: NDArray[np.uint8]
    wire_mask: NDArray[np.uint8]
    to_wire: NDArray[np.intp]
    to_payload: NDArray[np.intp]

    def encode(self, payload: Buffer) -> bytes | None:
        if len(payload) != len(self.payload):
            return None
        source = np.frombuffer(_POOL + payload, np.uint8)
        if ((source[_LEAF:] ^ self.payload) & self.payload_mask).any():
            return None
        return source[self.to_wire].tobytes()

    def encode_rows(self, payloads: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        if payloads.shape[1] != len(self.payload) or ((payloads ^ self.payload) & self.payload_mask).any():
            return None
        bodies = np.empty((len(payloads), len(self.wire)), np.uint8)
        bodies[:] = self.wire
        leaves = np.flatnonzero(self.to_wire >= _LEAF)
        bodies[:, leaves] = payloads[:, self.to_wire[leaves] - _LEAF]
        return bodies

    def decode(self, data: Buffer) -> bytes | None:
        if len(data) != HEAD.size + len(self.wire) or read_head(data) is None:
            return None
        source = np.frombuffer(_POOL + data, np.uint8)
        if ((source[_LEAF + HEAD.size :] ^ self.wire) & self.wire_mask).any():
            return None
        return source[self.to_payload].tobytes()

    def decode_rows(self, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        if messages.shape[1] != HEAD.size + len(self.wire) or not have_heads(messages[:, : HEAD.size]):
            return None
        if ((messages[:, HEAD.size :] ^ self.wire) & self.wire_mask).any():
            return None
        payloads = np.empty((len(messages), len(self.payload)), np.uint8)
        payloads[:] = self.payload
        leaves = np.flatnonzero(self.to_payload >= _LEAF)
        payloads[:, leaves] = messages[:, self.to_payload[leaves] - _LEAF]
        return payloads


_uniforms: dict[RecordType, _Uniform] = {}
_shapes: dict[RecordType, _Shape] = {}


def _uniform(type: RecordType) -> _Uniform:
    found = _uniforms.get(type)
    if found is None:
        found = _uniforms[type] = _Uniform(type)
    return found


# --- any structure -----------------------------------------------------------------------------------------------------


class _Weaver:
    """Sets a payload's numbers into wire format, and keeps for each byte of it where it came from.

    Attributes:
        index: For each byte of the message body, the byte itself, or `_LEAF` plus its place in the payload.
        mask: The bits of each byte that belong to the structure.
        exact: Whether the body gives the payload back.
    """

    def __init__(self, type: RecordType, payload: bytes) -> None:
        self._type = type
        self._payload = payload
        self.index = array("q")
        self.mask = bytearray()
        self.exact = True

    def packet(self, choice: int) -> int:
        """Weave the whole packet; returns where its records end. `choice`: which of alternative layouts to take."""
        if len(self._payload) > OBJECTS_LIMIT and not self._type.fixed:
            raise PayloadError(0, f"{self._type.name}: at most {OBJECTS_LIMIT} bytes, this has {len(self._payload)}")
        if self._type.framing is Framing.SINGLE:
            return self.record(self._type.layout, 0, choice)
        need(self._type, self._payload, 0, U16.size, "a count")
        at = U16.size
        for _ in range(U16.unpack_from(self._payload)[0]):
            at = self.record(self._type.layout, at, choice)
        return at

    def record(self, layout: Layout, at: int, choice: int = 0) -> int:
        """Weave one record, as an item of the message's list."""
        if self._type.framing is Framing.SINGLE:
            return self._fields(layout, layout, at, choice, first=ITEMS)
        return self._nested(ITEMS, layout, layout, at, choice)

    def _nested(self, number: int, layout: Layout, full: Layout, at: int, choice: int) -> int:
        outer_index, outer_mask = self.index, self.mask
        self.index, self.mask = array("q"), bytearray()
        at = self._fields(layout, full, at, choice)
        index, mask = self.index, self.mask
        self.index, self.mask = outer_index, outer_mask
        self._constant(_tag(number, _LEN) + _varint(len(index)))
        self.index += index
        self.mask += mask
        return at

    def _fields(self, layout: Layout, full: Layout, at: int, choice: int, first: int = 1) -> int:
        numbers = {name: number for number, name in enumerate(full.fields, first)}
        for name, kind in layout.fields.items():
            number = numbers[name]
            if isinstance(kind, Many):
                at = self._many(number, kind, at, choice)
            elif kind == TEXT:
                at = self._text(number, name, at)
            else:
                at = self._number(number, name, kind, at)
        return at

    def _many(self, number: int, many: Many, at: int, choice: int) -> int:
        counter = struct.Struct("<H" if many.count == "u2" else "<I")
        need(self._type, self._payload, at, counter.size, "a count")
        (count,) = counter.unpack_from(self._payload, at)
        at += counter.size
        layout = many.layouts[min(choice, len(many.layouts) - 1)]
        for _ in range(count):
            at = self._nested(number, layout, many.layouts[0], at, choice)
        return at

    def _text(self, number: int, name: str, at: int) -> int:
        need(self._type, self._payload, at, U16.size, name)
        size: int = U16.unpack_from(self._payload, at)[0]
        at += U16.size
        need(self._type, self._payload, at, size, name)
        text = self._payload[at : at + size]
        clean = text.decode("utf-8", "replace").encode()
        self.exact &= clean == text
        self._constant(_tag(number, _LEN) + _varint(len(clean)) + clean)
        return at + size

    def _number(self, number: int, name: str, kind: str, at: int) -> int:
        code = ("f8" if self._type.wide else "f4") if kind == REAL else kind
        size = 1 if code == FLAG else int(code[1:])
        need(self._type, self._payload, at, size, name)
        self._constant(_tag(number, _WIRE_TYPES.get(code, _VARINT)))
        if size > 1:
            self._leaf(at, size, 0)
            return at + size
        loose = 0xFE if code == FLAG else 0x80
        value = self._payload[at]
        if value & loose:
            self.exact = False
            if code == FLAG:
                value = 1
            elif code == "i1":
                value -= 1 << 8
            self._constant(_varint(value % (1 << 64)))
        else:
            self._leaf(at, size, loose)
        return at + size

    def _constant(self, data: bytes) -> None:
        self.index.extend(data)
        self.mask += b"\xff" * len(data)

    def _leaf(self, at: int, size: int, mask: int) -> None:
        self.index.extend(range(_LEAF + at, _LEAF + at + size))
        self.mask += bytes((mask,)) * size


def _weave(type: RecordType, payload: Buffer) -> tuple[bytes, _Shape | None]:
    """The body of a message for any payload; and its shape, unless the body does not give the payload back."""
    data = bytes(payload)
    weaver, end = _woven(type, data)
    index = np.frombuffer(weaver.index, np.int64).astype(np.intp, copy=False)
    source = np.frombuffer(_POOL + data, np.uint8)
    wire = source[index]
    if not weaver.exact or end < len(data):
        return wire.tobytes() + bytes([RAW_TAG]) + _varint(len(data)) + data, None
    mask = np.frombuffer(weaver.mask, np.uint8)
    leaves = np.flatnonzero(index >= _LEAF)
    places = index[leaves] - _LEAF
    payload_mask = np.full(len(data), 0xFF, np.uint8)
    payload_mask[places] = mask[leaves]
    to_payload = source[_LEAF:].astype(np.intp)
    to_payload[places] = _LEAF + HEAD.size + leaves
    return wire.tobytes(), _Shape(source[_LEAF:], wire, payload_mask, mask, index, to_payload)


def _woven(type: RecordType, data: bytes) -> tuple[_Weaver, int]:
    choices = max(
        (len(kind.layouts) if isinstance(kind, Many) else 1 for kind in type.layout.fields.values()),
        default=1,
    )
    found: tuple[_Weaver, int] | None = None
    failure: PayloadError | None = None
    for choice in range(choices):
        weaver = _Weaver(type, data)
        try:
            end = weaver.packet(choice)
        except PayloadError as error:
            failure = failure or error
            continue
        if end == len(data):
            return weaver, end
        found = found or (weaver, end)
    if found is None:
        assert failure
        raise failure
    return found


# --- by way of protobuf ------------------------------------------------------------------------------------------------


def _decode_any(type: RecordType, data: Buffer) -> bytes:
    message = parse(type.name, type.message_name, data)
    if message.HasField("raw"):
        return bytes(message.raw)
    try:
        payload = pack(type, _records(type, message, len(data)))
    except RecordError as error:
        raise WireError(str(error)) from None
    if type.fixed:
        return payload
    # Protobuf's Python floats lose the bits of some NaNs; the message itself has them.
    try:
        shape = _weave(type, payload)[1]
    except PayloadError as error:
        raise WireError(str(error)) from None
    exact = shape.decode(data) if shape else None
    if shape and exact is not None and type.group is Group.STATE:
        _shapes[type] = shape
    return payload if exact is None else exact


def _records(type: RecordType, message: Any, size: int) -> Records:
    try:
        if type.framing is Framing.SINGLE:
            return np.array([(getattr(message, type.items),)], type.dtype)
        items = getattr(message, type.items)
        if not type.fixed and _LEAST * len(items) > size:
            raise WireError(f"{type.name}: {len(items)} records in {size} bytes, most of them without an id")
        if len(items) > MAX_COUNT:
            raise WireError(f"{type.name}: {len(items)} records, a packet counts at most {MAX_COUNT}")
        if type.fixed:
            return _rows(items, type.dtype)
        return [_object(type.layout, item, type.wide) for item in items]
    except (OverflowError, ValueError) as error:
        raise WireError(f"{type.name}: {error}") from None


def _rows(items: Any, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    names = dtype.names or ()
    return np.array([tuple(getattr(item, name) for name in names) for item in items], dtype)


def _object(layout: Layout, message: Any, wide: bool) -> Any:
    fields, special = _getter(id(layout)) or _make_getter(layout)
    assert layout.make
    if not special:
        return layout.make(*fields(message))
    values = list(fields(message))
    for place, kind in special:
        value = values[place]
        if not isinstance(kind, Many):
            values[place] = int(value)
        elif len(value) > MAX_COUNT:
            raise WireError(f"{len(value)} items in a record, at most {MAX_COUNT} were expected")
        elif kind.layouts[0].make:
            values[place] = [_object(kind.layouts[0], item, wide) for item in value]
        else:
            values[place] = _rows(value, _present(kind, value).dtype(wide))
    return layout.make(*values)


Getter = tuple[Any, list[tuple[int, str | Many]]]  # attrgetter of all fields, and those that want more
_getters: dict[int, Getter] = {}
_getter = _getters.get


def _make_getter(layout: Layout) -> Getter:
    """What takes all fields from a message at once, and which of them are to be made into something else."""
    special = [(place, kind) for place, kind in enumerate(layout.fields.values()) if isinstance(kind, Many) or kind == FLAG]
    getter = _getters[id(layout)] = (attrgetter(*layout.fields), special)
    return getter


def _present(many: Many, items: Any) -> Layout:
    """The alternative layout of which all fields are there."""
    if not items:
        return many.layouts[0]
    return next(
        (layout for layout in many.layouts if all(items[0].HasField(name) for name in layout.fields)),
        many.layouts[0],
    )


@cache
def _tag(number: int, wire_type: int) -> bytes:
    return _varint(number << 3 | wire_type)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
