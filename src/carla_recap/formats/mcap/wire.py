"""A packet's payload ↔ its protobuf message, without an object in between.

Both are the same numbers in another setting: all numbers have a fixed size in the schemas, so a message is its payload's
bytes, moved, between bytes that only depend on the packet's *structure*: counts and texts. Where the structure is known,
a packet of any size is one gather. A message that does not look as this module writes it is parsed by protobuf.

A payload that no message can give back byte for byte (a flag of 2, broken UTF-8, surplus bytes) goes along in the message's
field `raw`.
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.formats.base import PIECE
from carla_recap.payload import MAX_COUNT, OBJECTS_LIMIT, U16, Buffer, PayloadError, need, pack
from carla_recap.records import FLAG, REAL, TEXT, Framing, Group, Layout, Many, Records, RecordType

if TYPE_CHECKING:
    from collections.abc import Iterator

    from google.protobuf.message import Message
    from numpy.typing import NDArray

HEAD: Final = struct.Struct("<BQBd")  # fields 1 and 2 of every message: frame, elapsed
FRAME_BODY: Final = struct.Struct("<Bd")  # field 3: duration
FRAME_TAG, ELAPSED_TAG, RAW_TAG = 0x09, 0x11, 0x22
ITEMS: Final = 3  # the field that holds the records

_VARINT, _FIXED64, _LEN, _FIXED32 = 0, 1, 2, 5
_WIRE_TYPES: Final = {"u4": _FIXED32, "i4": _FIXED32, "f4": _FIXED32, "u8": _FIXED64, "f8": _FIXED64}
_LEAF: Final = 256  # in an index: below, the byte itself; from here on, a place in the source
_POOL: Final = bytes(range(_LEAF))
_UNIFORM_STEP: Final = 256
_MODULES: Final = ("recording", "actors", "collisions", "vehicles", "walkers", "environment", "double")


class WireError(ValueError):
    """A message contradicts its schema."""


def head(frame: int, elapsed: float) -> bytes:
    """The first two fields of every message."""
    return HEAD.pack(FRAME_TAG, frame, ELAPSED_TAG, elapsed)


def frame_body(duration: float, ids: bytes, kinds: bytes) -> bytes:
    """The body of a `Frame`: its duration, and the id and kind of each packet."""
    return FRAME_BODY.pack(0x19, duration) + b"\x22" + _varint(len(ids)) + ids + b"\x2a" + _varint(len(kinds)) + kinds


def raw_pieces(head: bytes, id: int, payload: Buffer) -> Iterator[bytes]:
    """`RawPacket` messages of a packet that has no message of its own."""
    start = head + b"\x18" + _varint(id) + b"\x21" + len(payload).to_bytes(8, "little")
    for at in range(0, max(len(payload), 1), PIECE):
        piece = payload[at : at + PIECE]
        yield start + b"\x2a" + _varint(len(piece)) + bytes(piece)


def tail(piece: bytes) -> bytes:
    """A `Tail` message."""
    return b"\x0a" + _varint(len(piece)) + piece


def read_head(data: Buffer) -> tuple[int, float] | None:
    """Frame id and elapsed seconds of a message; None where they do not come first."""
    if len(data) < HEAD.size:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    return (frame, elapsed) if (tag1, tag2) == (FRAME_TAG, ELAPSED_TAG) else None


def encode(type: RecordType, payload: Buffer) -> bytes:
    """The body of a message, to go behind its head.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    codec = _uniform(type) if type.fixed else _remembered(type)
    body = codec.encode(payload) if codec else None
    if body is None:
        body, shape = _weave(type, payload)
        if shape and not type.fixed and type.group is Group.STATE:
            _shapes[type] = shape
    return body


def decode(type: RecordType, data: Buffer) -> bytes:
    """The payload of a message.

    Raises:
        WireError: The message contradicts its schema.
    """
    codec = _uniform(type) if type.fixed else _remembered(type)
    payload = codec.decode(data) if codec else None
    return _decode_any(type, data) if payload is None else payload


def decode_records(type: RecordType, data: Buffer) -> Records | None:
    """The records of a message of varying size, by way of protobuf; None where its payload is to be taken.

    Raises:
        WireError: The message contradicts its schema.
    """
    message = parse(type.message_name, data)
    if message.HasField("raw"):
        return None
    return _records(type, message)


@cache
def message_class(name: str) -> type[Message]:
    """The generated class of a message, by its full name."""
    short = name.rpartition(".")[2]
    for module in _MODULES:
        found = getattr(import_module(f"carla_recap.v1.{module}_pb2"), short, None)
        if found is not None:
            return found  # type: ignore[no-any-return]
    raise KeyError(name)


def parse(name: str, data: Buffer) -> Any:
    """A message, parsed by protobuf.

    Raises:
        WireError: It is none of that name.
    """
    from google.protobuf.message import DecodeError  # noqa: PLC0415

    if len(data) > OBJECTS_LIMIT:
        raise WireError(f"a {name} of at most {OBJECTS_LIMIT} bytes was expected, this has {len(data)}")
    message = message_class(name)()
    try:
        message.ParseFromString(bytes(data))
    except DecodeError as error:
        raise WireError(f"not a {name}: {error}") from None
    return message


# --- one structure: what the numbers are set in ------------------------------------------------------------------------


class _Uniform:
    """Packets of records of one fixed size, any number of them."""

    def __init__(self, type: RecordType) -> None:
        self._type = type
        self._single = type.framing is Framing.SINGLE
        self._size = type.dtype.itemsize
        self._payload_start = 0 if self._single else U16.size
        weaver = _Weaver(type, bytes(U16.size + self._size))
        weaver.record(type.layout, self._payload_start)
        self._stride = len(weaver.index)
        self._index = np.array(weaver.index, np.intp)
        self._mask = np.frombuffer(weaver.mask, np.uint8)
        self._checked = bool(((self._mask > 0) & (self._index >= _LEAF)).any())
        self._grow(1)

    def _grow(self, count: int) -> None:
        self._capacity = count
        step = np.arange(count)[:, None]
        leaf = self._index >= _LEAF
        to_wire = self._index + np.where(leaf, step * self._size, 0)
        back = np.empty((count, self._size), np.intp)
        back[:, self._index[leaf] - _LEAF - self._payload_start] = (
            _LEAF + HEAD.size + np.flatnonzero(leaf) + step * self._stride
        )
        self._to_wire, self._to_payload = to_wire.ravel(), back.ravel()
        self._constant = np.tile(np.where(leaf, 0, self._index).astype(np.uint8), count)
        self._strict = np.tile(self._mask, count)
        self._small = np.tile(np.where(leaf, self._mask, 0).astype(np.uint8), count)

    def encode(self, payload: Buffer) -> bytes | None:
        if self._single:
            count = 1
        elif len(payload) < U16.size:
            return None
        else:
            count = U16.unpack_from(payload)[0]
        if len(payload) != self._payload_start + count * self._size:
            return None
        if count > self._capacity:
            self._grow(-(-count // _UNIFORM_STEP) * _UNIFORM_STEP)
        source = np.frombuffer(_POOL + payload, np.uint8)
        end = count * self._stride
        wire = source[self._to_wire[:end]]
        if self._checked and (wire & self._small[:end]).any():
            return None
        return wire.tobytes()

    def decode(self, data: Buffer) -> bytes | None:
        count, rest = divmod(len(data) - HEAD.size, self._stride)
        if rest or count < 0 or count > 0xFFFF or read_head(data) is None or (self._single and count != 1):
            return None
        if count > self._capacity:
            self._grow(-(-count // _UNIFORM_STEP) * _UNIFORM_STEP)
        source = np.frombuffer(_POOL + data, np.uint8)
        end = count * self._stride
        if ((source[_LEAF + HEAD.size :] ^ self._constant[:end]) & self._strict[:end]).any():
            return None
        payload = source[self._to_payload[: count * self._size]].tobytes()
        return payload if self._single else U16.pack(count) + payload


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

    def decode(self, data: Buffer) -> bytes | None:
        if len(data) != HEAD.size + len(self.wire) or read_head(data) is None:
            return None
        source = np.frombuffer(_POOL + data, np.uint8)
        if ((source[_LEAF + HEAD.size :] ^ self.wire) & self.wire_mask).any():
            return None
        return source[self.to_payload].tobytes()


_uniforms: dict[RecordType, _Uniform] = {}
_shapes: dict[RecordType, _Shape] = {}


def _uniform(type: RecordType) -> _Uniform:
    found = _uniforms.get(type)
    if found is None:
        found = _uniforms[type] = _Uniform(type)
    return found


def _remembered(type: RecordType) -> _Shape | None:
    return _shapes.get(type) if type.group is Group.STATE else None


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
        (size,) = U16.unpack_from(self._payload, at)
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
    choices = max((len(kind.layouts) if isinstance(kind, Many) else 1 for kind in type.layout.fields.values()), default=1)
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
    message = parse(type.message_name, data)
    if message.HasField("raw"):
        return bytes(message.raw)
    try:
        payload = pack(type, _records(type, message))
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


def _records(type: RecordType, message: Any) -> Records:
    try:
        if type.framing is Framing.SINGLE:
            return np.array([(getattr(message, type.items),)], type.dtype)
        items = getattr(message, type.items)
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
    values = []
    for name, kind in layout.fields.items():
        value = getattr(message, name)
        if isinstance(kind, Many):
            inner = kind.layouts[0]
            if inner.make:
                value = [_object(inner, item, wide) for item in value]
            else:
                value = _rows(value, _present(kind, value).dtype(wide))
        elif kind == FLAG:
            value = int(value)
        values.append(value)
    assert layout.make
    return layout.make(*values)


def _present(many: Many, items: Any) -> Layout:
    """The alternative layout of which all fields are there."""
    if not items:
        return many.layouts[0]
    return next(
        (layout for layout in many.layouts if all(items[0].HasField(name) for name in layout.fields)), many.layouts[0]
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
