"""Payloads of packets ↔ protobuf messages: by numpy where many are alike, by protobuf's own library elsewhere.

All numbers have a fixed size in the schemas, so a message is the numbers of its payload, moved, between bytes that depend on
the packet's *structure* alone: its counts and texts. Where the numbers are shows when the messages of two payloads are
compared, which protobuf writes. A `Transforms` message of one actor, for example (`..` are numbers):

    09 ........ 11 ........ 1a 23 0d .... 15 .... 1d .... 25 .... 2d .... 35 .... 3d ....
    frame       elapsed     item  id      x       y       z       roll    pitch   yaw

- Records of one size repeat at equal distances: `RecordsCodec` moves their fields between two structured arrays.
- For state whose records vary in size, such as bones, the latest structure of each type is kept as a `PacketTemplate`.
- A payload that no message gives back byte for byte (a flag of 2, broken UTF-8, surplus bytes) is kept as a whole in the
  message's field `raw` as well.
"""

from __future__ import annotations

import struct
from functools import cache
from importlib import import_module
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.formats.base import PIECE
from carla_recap.model.layout import (
    FLAG,
    MAX_COUNT,
    OBJECTS_LIMIT,
    U16,
    Framing,
    Items,
    Numbers,
    PayloadError,
    compiled,
    locate,
    pack,
    unpack,
)
from carla_recap.model.records import Group

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.model.layout import Buffer, CompiledLayout, Span
    from carla_recap.model.records import RecordType

HEAD: Final = struct.Struct("<BQBd")  # fields 1 and 2 of every message: frame, elapsed
HEAD_DTYPE: Final = np.dtype([("frame_tag", "u1"), ("frame", "<u8"), ("elapsed_tag", "u1"), ("elapsed", "<f8")])
"""`HEAD` in arrays."""
FRAME_HEAD: Final = np.dtype([*HEAD_DTYPE.descr, ("duration_tag", "u1"), ("duration", "<f8")])
"""Fields 1 to 3 of a `Frame`."""
FRAME_TAG, ELAPSED_TAG, DURATION_TAG = 0x09, 0x11, 0x19
ITEMS, RAW = 3, 4  # the fields that hold the records, and the bytes of a payload
VARINT, FIXED64, LEN, FIXED32 = 0, 1, 2, 5

_MIN_RECORD: Final = 7  # bytes of a record with nothing but an id


class WireError(ValueError):
    """A message contradicts its schema."""


# --- the wire format ---------------------------------------------------------------------------------------------------


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
        raise WireError(f"expected a {name} of at most {OBJECTS_LIMIT} bytes, found {len(data)}")
    message = message_class(module, name)()
    try:
        message.ParseFromString(bytes(data))
    except DecodeError as error:
        raise WireError(f"not a {name}: {error}") from None
    return message


# --- messages of frames, and such without records ----------------------------------------------------------------------


def head(frame: int, elapsed: float) -> bytes:
    """Return the first two fields of every message; what follows them is its body."""
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
    return _body("frame", "Frame", duration=duration, packets=ids, filled=kinds)


def raw_bodies(id: int, payload: Buffer) -> Iterator[bytes]:
    """Yield the bodies of the `RawPacket` messages of a packet that has no message of its own."""
    for offset in range(0, max(len(payload), 1), PIECE):
        yield _body("raw_packet", "RawPacket", id=id, size=len(payload), data=bytes(payload[offset : offset + PIECE]))


def tail(piece: bytes) -> bytes:
    """Return a `Tail` message."""
    return _body("tail", "Tail", data=piece)


def _body(module: str, name: str, **fields: Any) -> bytes:
    make: Any = message_class(module, name)
    body: bytes = make(**fields).SerializeToString()
    return body


# --- records of one size -----------------------------------------------------------------------------------------------


@cache
def _masks(numbers: Numbers) -> bytes:
    """Return, for each byte of some numbers, the bits that must be zero: a number of one byte has to fit a varint of one."""
    kinds = [kind for _, kind in numbers.fields.values()]
    return b"".join({FLAG: b"\xfe", "u1": b"\x80", "i1": b"\x80"}.get(kind) or bytes(int(kind[1:])) for kind in kinds)


class RecordsCodec:
    """Encodes and decodes the packets of a type whose records have one size.

    Attributes:
        stride: Bytes of a record in a body.
        wire: The numpy type of a record in a body: its numbers, with gaps for what is the same in each.
    """

    def __init__(self, type: RecordType) -> None:
        (numbers,) = compiled(type).steps
        assert isinstance(numbers, Numbers)
        self._dtype = type.dtype
        self._single = type.framing is Framing.SINGLE
        count = b"" if self._single else U16.pack(1)
        self._start = len(count)
        blank, other = (
            np.frombuffer(_serialized(type, count + bytes((value,)) * type.dtype.itemsize), np.uint8) for value in (0, 1)
        )
        targets = np.flatnonzero(blank != other)  # the offset of each byte of a number
        self.stride = len(blank)
        self._blank = blank.view(np.void(self.stride).dtype)
        self._constants = [(offset, blank[offset]) for offset in np.flatnonzero(blank == other).tolist()]
        fields: Any = type.dtype.fields
        masks = _masks(numbers)
        self._masks = {name: mask for name, (_, offset, *_) in fields.items() if (mask := masks[offset])}
        form = {
            "names": list(fields),
            "formats": [dtype for dtype, *_ in fields.values()],
            "offsets": [int(targets[offset]) for _, offset, *_ in fields.values()],
            "itemsize": self.stride,
        }
        self.wire: np.dtype[np.void] = np.dtype(form)  # type: ignore[call-overload]

    def body_size(self, payload: Buffer) -> int | None:
        """Return the size of the body of a payload; None where its size is not that of its records."""
        size = len(payload)
        if self._single:
            return self.stride if size == self._dtype.itemsize else None
        count = payload[0] | payload[1] << 8 if size > 1 else 0
        return count * self.stride if size == U16.size + count * self._dtype.itemsize else None

    def count_in(self, size: int) -> int | None:
        """Return the number of records in a body of some bytes; None where no body has that size."""
        count, rest = divmod(size, self.stride)
        return None if size < 0 or rest or count > MAX_COUNT or (self._single and count != 1) else count

    def payload_size(self, count: int) -> int:
        """Return the size of a payload with a number of records."""
        return self._start + count * self._dtype.itemsize

    def blank(self, count: int) -> bytes:
        """Return the body of records that are all zero."""
        return self._blank.tobytes() * count

    def fits(self, records: NDArray[np.void]) -> bool:
        """Return whether all numbers have the size that they have in `blank`."""
        return not any((records[name].view(np.uint8) & mask).any() for name, mask in self._masks.items())

    def fill(self, bodies: NDArray[np.void], records: NDArray[np.void]) -> None:
        """Write the numbers of records that fit into bodies of the type `wire`."""
        for name in self._dtype.names or ():
            bodies[name] = records[name]

    def encode(self, payloads: Sequence[Buffer]) -> list[memoryview] | None:
        """Return the bodies of some payloads; None where one of them has another size, or numbers that do not fit."""
        sizes = [size for size in map(self.body_size, payloads) if size is not None]
        if len(sizes) < len(payloads):
            return None
        records = np.frombuffer(b"".join([memoryview(payload)[self._start :] for payload in payloads]), self._dtype)
        if not self.fits(records):
            return None
        bodies = np.empty(len(records), self._blank.dtype)
        bodies[:] = self._blank
        self.fill(bodies.view(self.wire), records)
        data = bodies.view(np.uint8).data if len(bodies) else memoryview(b"")
        return [data[start:end] for start, end in pairwise([0, *accumulate(sizes)])]

    def matches(self, bodies: NDArray[np.uint8]) -> bool:
        """Return whether bodies, (messages, bytes), are as `encode` writes them."""
        records = bodies.reshape(len(bodies), bodies.shape[1] // self.stride, self.stride)
        fields: Any = self.wire.fields
        return not (
            any((records[:, :, offset] != value).any() for offset, value in self._constants)
            or any((records[:, :, fields[name][1]] & mask).any() for name, mask in self._masks.items())
        )

    def records(self, bodies: NDArray[np.void]) -> NDArray[np.void]:
        """Return the records of bodies of the type `wire`, read-only."""
        records = np.empty(bodies.shape, self._dtype)
        for name in self._dtype.names or ():
            records[name] = bodies[name]
        records.flags.writeable = False
        return records

    def decode(self, messages: Sequence[Buffer]) -> list[NDArray[np.void]] | None:
        """Return the records of each of some messages; None where one is not as `encode` writes it."""
        counts = [self.count_in(len(message) - HEAD.size) for message in messages]
        if None in counts:
            return None
        if not have_heads(np.frombuffer(b"".join([message[: HEAD.size] for message in messages]), HEAD_DTYPE)):
            return None
        bodies = b"".join([message[HEAD.size :] for message in messages])
        if not self.matches(np.frombuffer(bodies, np.uint8).reshape(1, -1)):
            return None
        records = self.records(np.frombuffer(bodies, self.wire))
        return [records[start:end] for start, end in pairwise([0, *accumulate(count or 0 for count in counts)])]


@cache
def records_codec(type: RecordType) -> RecordsCodec:
    """Return the codec of a type whose records have one size."""
    return RecordsCodec(type)


# --- payloads of any structure -----------------------------------------------------------------------------------------


class PacketTemplate(NamedTuple):
    """A structure of packets.

    Attributes:
        payload: A packet of this structure, its numbers zero.
        body: The body of its message.
        sources: The offset in the payload of each byte of a number.
        targets: Its offset in the body.
        payload_mask: The bits in which all packets of this structure agree.
        body_mask: The same of the bodies.
    """

    payload: NDArray[np.uint8]
    body: NDArray[np.uint8]
    sources: NDArray[np.intp]
    targets: NDArray[np.intp]
    payload_mask: NDArray[np.uint8]
    body_mask: NDArray[np.uint8]

    @staticmethod
    def of(type: RecordType, data: bytes) -> PacketTemplate | None:
        """Return the structure of a packet; None where messages do not give it back.

        Raises:
            PayloadError: The payload contradicts the type's layout.
        """
        numbers = list(_numbers_in(locate(type, data)[0]))
        sources = np.concatenate([np.empty(0, np.intp), *(np.arange(len(masks)) + offset for offset, masks in numbers)])
        zeros = np.frombuffer(bytearray(data), np.uint8)
        ones = zeros.copy()
        zeros[sources], ones[sources] = 0, 1
        body, other = (np.frombuffer(_serialized(type, payload.tobytes()), np.uint8) for payload in (zeros, ones))
        if _decode_by_protobuf(type, body.tobytes()) != zeros.tobytes():
            return None
        targets = np.flatnonzero(body != other)
        payload_mask, body_mask = np.full(len(zeros), 0xFF, np.uint8), np.full(len(body), 0xFF, np.uint8)
        payload_mask[sources] = body_mask[targets] = np.frombuffer(b"".join(masks for _, masks in numbers), np.uint8)
        return PacketTemplate(zeros, body, sources, targets, payload_mask, body_mask)

    def encode(self, payloads: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        """Return the bodies of some payloads, (packets, bytes); None where one has another structure."""
        if payloads.shape[1] != len(self.payload) or ((payloads ^ self.payload) & self.payload_mask).any():
            return None
        bodies = np.empty((len(payloads), len(self.body)), np.uint8)
        bodies[:] = self.body
        bodies[:, self.targets] = payloads[:, self.sources]
        return bodies

    def decode(self, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        """Return the payloads of some messages, (packets, bytes); None where one has another structure."""
        if messages.shape[1] != HEAD.size + len(self.body):
            return None
        bodies = messages[:, HEAD.size :]
        heads = np.ascontiguousarray(messages[:, : HEAD.size]).view(HEAD_DTYPE)
        if ((bodies ^ self.body) & self.body_mask).any() or not have_heads(heads):
            return None
        payloads = np.empty((len(messages), len(self.payload)), np.uint8)
        payloads[:] = self.payload
        payloads[:, self.sources] = bodies[:, self.targets]
        return payloads


def _numbers_in(span: Span) -> Iterator[tuple[int, bytes]]:
    """Yield the offset of numbers that follow each other in a payload, and their masks; see `_masks`."""
    for index in range(span.number):
        parts = span.records[index] if span.layout.make else [span.offset + index * span.layout.dtype.itemsize]
        for step, part in zip(span.layout.steps, parts, strict=True):
            if isinstance(step, Numbers):
                yield part, _masks(step)  # type: ignore[misc]
            elif isinstance(step, Items):
                yield from _numbers_in(part)  # type: ignore[arg-type]


_templates: dict[RecordType, PacketTemplate] = {}  # of the latest packet of each type


def encode(type: RecordType, payload: Buffer) -> bytes:
    """Return the body of a message.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    if type.fixed:
        return bytes(encode_many(type, [payload])[0])
    template = _templates.get(type)
    bodies = template.encode(_row(payload)) if template else None
    return _encode_any(type, payload) if bodies is None else bodies.tobytes()


def encode_many(type: RecordType, payloads: Sequence[Buffer]) -> Sequence[Buffer]:
    """Return the bodies of messages of a type whose records have one size.

    Raises:
        PayloadError: A payload contradicts the type's layout.
    """
    return records_codec(type).encode(payloads) or [_encode_any(type, payload) for payload in payloads]


def encode_rows(type: RecordType, payloads: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the bodies of messages of varying size that have the structure of the first payload, (messages, bytes).

    None where a payload has another structure, or one that its message does not give back.

    Raises:
        PayloadError: The first payload contradicts the type's layout.
    """
    encode(type, payloads[0].tobytes())
    template = _templates.get(type)
    return template.encode(payloads) if template else None


def decode(type: RecordType, data: Buffer) -> bytes:
    """Return the payload of a message.

    Raises:
        WireError: The message contradicts its schema.
    """
    if type.fixed:
        found = records_codec(type).decode([data])
        return pack(type, found[0]) if found else _decode_by_protobuf(type, data)
    template = _templates.get(type)
    payloads = template.decode(_row(data)) if template else None
    if payloads is not None:
        return payloads.tobytes()
    payload = _decode_by_protobuf(type, data)
    if type.group is Group.STATE and (template := _keep(type, payload)):
        payloads = template.decode(_row(data))  # with all bits of NaNs, some of which protobuf's floats of 32 bits lose
    return payload if payloads is None else payloads.tobytes()


def decode_rows(type: RecordType, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the payloads of messages of varying size that have the structure of the first one, (messages, bytes).

    None where one of them has another.

    Raises:
        WireError: The first message contradicts its schema.
    """
    decode(type, messages[0].tobytes())
    template = _templates.get(type)
    return template.decode(messages) if template else None


def decode_records(type: RecordType, messages: Sequence[Buffer]) -> list[Any]:
    """Return the records of some messages, those of one size as tuples.

    Raises:
        WireError: A message contradicts its schema.
    """
    rows: list[Any] = []
    for message in messages:
        try:
            records, _ = unpack(type, decode(type, message))
        except PayloadError as error:
            raise WireError(str(error)) from None
        rows += records.tolist() if isinstance(records, np.ndarray) else records
    return rows


def _row(data: Buffer) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)[None]


def _keep(type: RecordType, payload: bytes) -> PacketTemplate | None:
    """Keep the structure of a packet, if messages can have it, and return it."""
    try:
        template = PacketTemplate.of(type, payload)
    except PayloadError:  # in a field `raw` there may be anything
        return None
    if template is not None:
        _templates[type] = template
    return template


def _encode_any(type: RecordType, payload: Buffer) -> bytes:
    """Return the body of a message of a payload whose structure is new."""
    data = bytes(payload)
    body = _serialized(type, data)
    if type.group is Group.STATE and not type.fixed:  # few events have the structure of another one
        template = _keep(type, data)
        bodies = template.encode(_row(data)) if template else None
        if bodies is not None:
            return bodies.tobytes()
    exact = _decode_by_protobuf(type, body) == data
    return body if exact else body + tag(RAW, LEN) + varint(len(data)) + data


# --- by protobuf -------------------------------------------------------------------------------------------------------


def _serialized(type: RecordType, data: bytes) -> bytes:
    """Return the body of a message with the records of a payload.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    span, _ = locate(type, data)
    message: Any = message_class(type.name, type.message_name)()
    if type.framing is Framing.SINGLE:
        setattr(message, type.items, span.layout.steps[0].struct.unpack_from(data)[0])  # type: ignore[union-attr]
    else:
        _fill(getattr(message, type.items), span, data)
    body: bytes = message.SerializeToString()
    return body


def _fill(items: Any, span: Span, data: bytes) -> None:
    """Add records of a payload to a field of a message."""
    layout = span.layout
    for index in range(span.number):
        item = items.add()
        parts = span.records[index] if layout.make else [span.offset + index * layout.dtype.itemsize]
        for step, part in zip(layout.steps, parts, strict=True):
            if isinstance(step, Numbers):
                values = step.struct.unpack_from(data, part)  # type: ignore[arg-type]
                for (name, (_, kind)), value in zip(step.fields.items(), values, strict=True):
                    setattr(item, name, bool(value) if kind == FLAG else value)
            elif isinstance(part, slice):
                setattr(item, step.name, data[part].decode("utf-8", "replace"))
            else:
                _fill(getattr(item, step.name), part, data)  # type: ignore[arg-type]


def _decode_by_protobuf(type: RecordType, data: Buffer) -> bytes:
    """Return the payload of a message with fields in any order; missing ones are zero, unknown ones are left out.

    Raises:
        WireError: The message contradicts its schema.
    """
    message = parse(type.name, type.message_name, data)
    if raw := getattr(message, "raw", b""):
        return bytes(raw)
    layout, found = compiled(type), getattr(message, type.items)
    try:
        if type.framing is Framing.SINGLE:
            return bytes(layout.steps[0].struct.pack(found))  # type: ignore[union-attr]
        if not type.fixed and _MIN_RECORD * len(found) > len(data):
            raise WireError(f"{type.name}: {len(found)} records in {len(data)} bytes, most of them without an id")
        parts: list[bytes] = []
        _collect(parts, found, layout, U16)
        return b"".join(parts)
    except struct.error as error:
        raise WireError(f"{type.name}: a number beyond its field ({error})") from None


def _collect(parts: list[bytes], items: Any, layout: CompiledLayout, counter: struct.Struct) -> None:
    """Append the bytes that records of a message have in a payload."""
    if len(items) > MAX_COUNT:
        raise WireError(f"{len(items)} records, a packet counts at most {MAX_COUNT}")
    parts.append(counter.pack(len(items)))
    for item in items:
        for step in layout.steps:
            if isinstance(step, Numbers):
                parts.append(step.struct.pack(*[getattr(item, name) for name in step.fields]))
            elif isinstance(step, Items):
                inner = getattr(item, step.name)
                _collect(parts, inner, _layout_of(inner, step.layouts), step.counter)
            else:
                text = getattr(item, step.name).encode()
                parts += (U16.pack(len(text)), text)


def _layout_of(items: Any, layouts: Sequence[CompiledLayout]) -> CompiledLayout:
    """Return the one of some layouts of which the first item has all fields; the first layout if there is none."""
    complete = (layout for layout in layouts if items and all(map(items[0].HasField, layout.dtype.names or ())))
    return next(complete, layouts[0])
