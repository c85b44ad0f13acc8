"""Payloads of packets ↔ protobuf messages: as columns of arrays where they repeat, and field by field elsewhere.

All numbers have a fixed size in the schemas, so a message is the numbers of its payload, moved, between bytes that depend on
the packet's *structure* alone: its counts and texts. A `Transforms` message of one actor, for example (`..` are numbers):

    09 ........ 11 ........ 1a 23 0d .... 15 .... 1d .... 25 .... 2d .... 35 .... 3d ....
    frame       elapsed     item  id      x       y       z       roll    pitch   yaw

- Records of one size repeat at equal distances: `RecordsCodec` moves their fields between two structured arrays.
- For records whose size varies, such as bones, the latest structure of each type is kept as a `PacketTemplate`.
- A payload that no message can give back byte for byte (a flag of 2, broken UTF-8, surplus bytes) is kept as a whole in the
  message's field `raw` as well.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import cache, lru_cache
from importlib import import_module
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
FRAME_BODY: Final = struct.Struct("<Bd")  # field 3: duration
FRAME_HEAD: Final = np.dtype([*HEAD_DTYPE.descr, ("duration_tag", "u1"), ("duration", "<f8")])
"""`HEAD` and `FRAME_BODY` in arrays."""
FRAME_TAG, ELAPSED_TAG, DURATION_TAG = 0x09, 0x11, 0x19
ITEMS, RAW = 3, 4  # the fields that hold the records, and the bytes of a payload
VARINT, FIXED64, LEN, FIXED32 = 0, 1, 2, 5

_WIRE_TYPES: Final = {"u4": FIXED32, "i4": FIXED32, "f4": FIXED32, "u8": FIXED64, "f8": FIXED64}
_SIZES: Final = {FIXED32: 4, FIXED64: 8}  # bytes
_KNOWN: Final = (VARINT, FIXED64, LEN, FIXED32)
_LEAST: Final = 7  # bytes of a record with nothing but an id


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
    """Return a message, parsed by protobuf, or raise `WireError`; see `message_class`."""
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
    return FRAME_BODY.pack(DURATION_TAG, duration) + frame_packets(ids, kinds)


@lru_cache(maxsize=64)
def frame_packets(ids: bytes, kinds: bytes) -> bytes:
    """Return the part of a `Frame` that seldom changes: the id and kind of each packet."""
    return b"\x22" + varint(len(ids)) + ids + b"\x2a" + varint(len(kinds)) + kinds


def read_frame(data: Buffer) -> tuple[int, float, float, bytes, bytes] | None:
    """Return id, elapsed and duration of a `Frame`, and the id and kind of each packet.

    None for a message that is not as `frame_body` writes it, or has more than 127 packets.
    """
    if len(data) <= FRAME_HEAD.itemsize + 1:
        return None
    tag1, frame, tag2, elapsed = HEAD.unpack_from(data)
    tag3, duration = FRAME_BODY.unpack_from(data, HEAD.size)
    packets = bytes(data[FRAME_HEAD.itemsize :])
    ids, kinds = packets[2 : 2 + packets[1]], packets[4 + packets[1] :]
    if (tag1, tag2, tag3) != (FRAME_TAG, ELAPSED_TAG, DURATION_TAG) or packets != frame_packets(ids, kinds):
        return None
    return frame, elapsed, duration, ids, kinds


def raw_bodies(id: int, payload: Buffer) -> Iterator[bytes]:
    """Yield the bodies of the `RawPacket` messages of a packet that has no message of its own."""
    make: Any = message_class("raw_packet", "RawPacket")
    for offset in range(0, max(len(payload), 1), PIECE):
        yield make(id=id, size=len(payload), data=bytes(payload[offset : offset + PIECE])).SerializeToString()


def tail(piece: bytes) -> bytes:
    """Return a `Tail` message."""
    make: Any = message_class("tail", "Tail")
    message: bytes = make(data=piece).SerializeToString()
    return message


# --- records of one size -----------------------------------------------------------------------------------------------


class WireNumbers:
    """How numbers that follow each other in a payload are written in a message, from a field number (`first`) on."""

    def __init__(self, numbers: Numbers, first: int = 1) -> None:
        blank, targets, masks = bytearray(), list[int](), bytearray()
        self.fields: list[tuple[int, bytes, int, str]] = []  # the key of each, also as bytes, its size and its kind
        for number, kind in numbers.fields.values():
            size = 1 if kind == FLAG else int(kind[1:])
            key = number + first - 1 << 3 | _WIRE_TYPES.get(kind, VARINT)
            name = varint(key)
            self.fields.append((key, name, size, kind))
            blank += name
            targets += range(len(blank), len(blank) + size)
            masks += bytes((0 if size > 1 else 0xFE if kind == FLAG else 0x80,)) * size
            blank += bytes(size)
        self.blank = bytes(blank)  # the bytes of the message, all numbers being zero
        self.targets = np.array(targets)  # the offset in the message of each byte of a number
        # Of each of these bytes, the bits that are not free: a number of one byte is to fit a varint of one byte.
        self.masks = np.frombuffer(bytes(masks), np.uint8)

    def encode(self, payload: bytes, offset: int) -> tuple[bytes, bool]:
        """Return the numbers at an offset of a payload as a message has them, and whether each has its size in `blank`."""
        parts, fits = list[bytes](), True
        for _, name, size, kind in self.fields:
            value = payload[offset : offset + size]
            offset += size
            if size == 1 and value[0] > (1 if kind == FLAG else 0x7F):
                fits = False
                signed = int.from_bytes(value, signed=kind == "i1")
                value = b"\1" if kind == FLAG else varint(signed & 0xFFFF_FFFF_FFFF_FFFF)
            parts += (name, value)
        return b"".join(parts), fits


@cache
def wire_numbers(numbers: Numbers, first: int = 1) -> WireNumbers:
    """Return how some numbers are written in a message; see `WireNumbers`."""
    return WireNumbers(numbers, first)


class RecordsCodec:
    """Encodes and decodes the packets of a type whose records have one size."""

    def __init__(self, type: RecordType) -> None:
        (numbers,) = compiled(type).steps
        assert isinstance(numbers, Numbers)
        self._dtype = type.dtype
        self._single = type.framing is Framing.SINGLE
        self._start = 0 if self._single else U16.size
        form = wire_numbers(numbers, ITEMS if self._single else 1)
        header = b"" if self._single else tag(ITEMS, LEN) + varint(len(form.blank))
        self._blank = np.frombuffer(header + form.blank, np.uint8)
        targets = form.targets + len(header)
        self.stride = len(self._blank)  # bytes of a record in a body
        self._fixed_bits = np.full(self.stride, 0xFF, np.uint8)
        self._fixed_bits[targets] = form.masks
        fields: Any = type.dtype.fields
        offsets = {name: int(targets[offset]) for name, (_, offset, *_) in fields.items()}
        self._masks = {name: mask for name, (_, offset, *_) in fields.items() if (mask := form.masks[offset])}
        formats = [dtype for dtype, *_ in fields.values()]
        names = {"names": list(fields), "formats": formats, "offsets": list(offsets.values())}
        # The numpy type of a record in a body: its numbers, with gaps for what is the same in each.
        self.wire: np.dtype[np.void] = np.dtype({**names, "itemsize": self.stride})  # type: ignore[call-overload]

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

    def encode(self, payload: Buffer) -> bytes | None:
        """Return the body of a payload; None where it has another size, or numbers that do not fit."""
        size = len(payload)
        count = 1 if self._single else payload[0] | payload[1] << 8 if size > 1 else 0
        if size != self.payload_size(count):
            return None
        records = np.frombuffer(payload, self._dtype, count, self._start)
        if not self.fits(records):
            return None
        bodies = np.empty((count, self.stride), np.uint8)
        bodies[:] = self._blank
        self.fill(bodies.view(self.wire)[:, 0], records)
        return bodies.tobytes()

    def matches(self, bodies: NDArray[np.uint8]) -> bool:
        """Return whether bodies, (messages, bytes), are as `encode` writes them."""
        records = bodies.reshape(len(bodies), bodies.shape[1] // self.stride, self.stride)
        return not ((records ^ self._blank) & self._fixed_bits).any()

    def decode(self, message: Buffer) -> bytes | None:
        """Return the payload of a message; None where it is not as `encode` writes it."""
        size = len(message) - HEAD.size
        count = self.count_in(size)
        if count is None or read_head(message) is None:
            return None
        if not self.matches(np.frombuffer(message, np.uint8, size, HEAD.size)[None]):
            return None
        records, found = np.empty(count, self._dtype), np.frombuffer(message, self.wire, count, HEAD.size)
        for name in self._dtype.names or ():
            records[name] = found[name]
        return (b"" if self._single else U16.pack(count)) + records.tobytes()


@cache
def records_codec(type: RecordType) -> RecordsCodec:
    """Return the codec of a type whose records have one size."""
    return RecordsCodec(type)


# --- payloads of any structure -----------------------------------------------------------------------------------------


class PacketTemplate(NamedTuple):
    """A structure of packets."""

    payload: NDArray[np.uint8]  # a packet of this structure
    body: NDArray[np.uint8]  # the body of its message
    sources: NDArray[np.intp]  # the offset in the payload of each byte of a number
    targets: NDArray[np.intp]  # its offset in the body
    payload_mask: NDArray[np.uint8]  # the bits in which all packets of this structure agree
    body_mask: NDArray[np.uint8]  # the same of the bodies

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


Places = list[tuple[int, int, WireNumbers]]  # of numbers: their offsets in a payload and in a message
_templates: dict[RecordType, PacketTemplate] = {}  # of the latest packet of each type


def encode(type: RecordType, payload: Buffer) -> bytes:
    """Return the body of a message, or raise `PayloadError`."""
    if type.fixed:
        return records_codec(type).encode(payload) or _encode_any(type, payload)
    template = _templates.get(type)
    bodies = template.encode(_row(payload)) if template else None
    return _encode_any(type, payload) if bodies is None else bodies.tobytes()


def encode_rows(type: RecordType, payloads: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the bodies of messages of varying size that have the structure of the first payload, (messages, bytes).

    None where a payload has another structure, or one that its message does not give back; `PayloadError` for the first.
    """
    encode(type, payloads[0].tobytes())
    template = _templates.get(type)
    return template.encode(payloads) if template else None


def decode(type: RecordType, data: Buffer) -> bytes:
    """Return the payload of a message, or raise `WireError`."""
    if type.fixed:
        return records_codec(type).decode(data) or _decode_any(type, bytes(data))
    template = _templates.get(type)
    payloads = template.decode(_row(data)) if template else None
    if payloads is not None:
        return payloads.tobytes()
    payload = _decode_any(type, bytes(data))
    if type.group is Group.STATE:
        with suppress(PayloadError):  # there may be anything in a field `raw`
            _encode_any(type, payload)  # which keeps its structure
    return payload


def decode_rows(type: RecordType, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the payloads of messages of varying size that have the structure of the first one, (messages, bytes).

    None where one of them has another.
    """
    decode(type, messages[0].tobytes())
    template = _templates.get(type)
    return template.decode(messages) if template else None


def decode_records(type: RecordType, message: Buffer) -> list[Any]:
    """Return the records of a message, those of one size as tuples, or raise `WireError`."""
    try:
        records = unpack(type, decode(type, message))[0]
    except PayloadError as error:
        raise WireError(str(error)) from None
    return records.tolist() if isinstance(records, np.ndarray) else records


def _row(data: Buffer) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)[None]


def _encode_any(type: RecordType, payload: Buffer) -> bytes:
    """Return the body of a message of a payload, and keep its structure, except for events: few have that of another one."""
    data = bytes(payload)
    span, rest = locate(type, data)
    if type.framing is Framing.SINGLE:
        (numbers,) = span.layout.steps
        body, is_exact = wire_numbers(numbers, ITEMS).encode(data, 0)
        places: Places = []
    else:
        body, places, is_exact = _write_items(ITEMS, span, data)
    if rest or not is_exact:
        return body + tag(RAW, LEN) + varint(len(data)) + data
    if type.group is Group.STATE:
        _templates[type] = _template(data, body, places)
    return body


def _write_items(number: int, span: Span, data: bytes) -> tuple[bytes, Places, bool]:
    """Return records of a payload as a field, where numbers are in both, and whether the field gives the records back."""
    out, places, is_exact = bytearray(), Places(), True
    for index in range(span.number):
        item, inside = bytearray(), Places()
        parts = span.records[index] if span.layout.make else [span.offset + index * span.layout.dtype.itemsize]
        for step, part in zip(span.layout.steps, parts, strict=True):
            if isinstance(step, Numbers):
                form = wire_numbers(step)
                found, fits = form.encode(data, part)  # type: ignore[arg-type]
                inside.append((part, len(item), form))  # type: ignore[arg-type]
            elif isinstance(part, slice):
                text = data[part].decode("utf-8", "replace").encode()
                found, fits = tag(step.number, LEN) + varint(len(text)) + text, text == data[part]
            else:
                found, nested, fits = _write_items(step.number, part, data)  # type: ignore[arg-type]
                inside += [(source, len(item) + target, form) for source, target, form in nested]
            item += found
            is_exact &= fits
        out += tag(number, LEN) + varint(len(item))
        places += [(source, len(out) + target, form) for source, target, form in inside]
        out += item
    return bytes(out), places, is_exact


def _template(data: bytes, body: bytes, places: Places) -> PacketTemplate:
    """Return the structure of a packet whose message gives the payload back."""
    nothing = np.empty(0, np.intp)
    sources = np.concatenate([nothing, *(np.arange(source, source + len(form.targets)) for source, _, form in places)])
    targets = np.concatenate([nothing, *(target + form.targets for _, target, form in places)])
    masks = np.concatenate([np.empty(0, np.uint8), *(form.masks for *_, form in places)])
    payload_mask, body_mask = np.full(len(data), 0xFF, np.uint8), np.full(len(body), 0xFF, np.uint8)
    payload_mask[sources] = body_mask[targets] = masks
    payload, body_bytes = (np.frombuffer(each, np.uint8) for each in (data, body))
    return PacketTemplate(payload, body_bytes, sources, targets, payload_mask, body_mask)


# --- messages of any form ----------------------------------------------------------------------------------------------

Fields = dict[int, list[Any]]
"""The values of a message by the keys of their fields, which are number and wire type: of a varint a number, else bytes."""


def _decode_any(type: RecordType, data: bytes) -> bytes:
    """Return the payload of a message with fields in any order; missing ones are zero, unknown ones are left out.

    Protobuf makes quiet NaNs of signalling ones where numbers are of 32 bits, and its import takes 15 ms, a fifth of the
    time of `collisions` on a small recording.
    """
    if len(data) > OBJECTS_LIMIT:
        raise WireError(f"expected a {type.message_name} of at most {OBJECTS_LIMIT} bytes, found {len(data)}")
    try:
        fields = _fields(data)
        if raw := fields.get(RAW << 3 | LEN, [b""])[-1]:
            return bytes(raw)
        if type.framing is Framing.SINGLE:
            (numbers,) = compiled(type).steps
            return b"".join(_numbers(fields, wire_numbers(numbers, ITEMS)))
        found = fields.get(ITEMS << 3 | LEN, [])
        if not type.fixed and _LEAST * len(found) > len(data):
            raise WireError(f"{type.name}: {len(found)} records in {len(data)} bytes, most of them without an id")
        return b"".join(_list(found, U16, (compiled(type),)))
    except WireError:
        raise
    except (ValueError, IndexError) as error:
        raise WireError(f"not a {type.message_name}: {error}") from None
    except struct.error as error:
        raise WireError(f"{type.name}: a number beyond its field ({error})") from None


def _fields(data: bytes) -> Fields:
    """Return the fields of a message, or raise `ValueError` or `IndexError`."""
    fields: Fields = {}
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        wire_type = key & 7
        size = _SIZES.get(wire_type)
        if size is None:
            size, at = _varint(data, at)
        value = size if wire_type == VARINT else data[at : at + size]
        at += 0 if wire_type == VARINT else size
        if at > end or key < 8 or wire_type not in _KNOWN:
            raise ValueError("a field without a number, or without its end, or of an unknown form")
        fields.setdefault(key, []).append(value)
    return fields


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the whole number at an offset, and the offset behind it."""
    value = data[at]
    if value < 0x80:
        return value, at + 1
    value, shift = value & 0x7F, 7
    while True:
        at += 1
        value |= (data[at] & 0x7F) << shift
        if data[at] < 0x80:
            return value, at + 1
        shift += 7
        if shift > 63:
            raise ValueError("a whole number of more than 64 bits")


def _numbers(fields: Fields, form: WireNumbers) -> Iterator[bytes]:
    """Yield the bytes that numbers which follow each other have in a payload."""
    for key, _, size, kind in form.fields:
        values = fields.get(key)
        if size > 1:
            yield values[-1] if values else bytes(size)
            continue
        value = values[-1] & 0xFFFF_FFFF_FFFF_FFFF if values else 0
        if kind == FLAG:
            value = value > 0
        elif kind == "i1":
            value = (value & 0xFFFF_FFFF ^ 1 << 31) - (1 << 31)  # as protobuf reads an `int32`
        yield struct.pack("b" if kind == "i1" else "B", value & 0xFFFF_FFFF if kind == "u1" else value)


def _list(items: list[bytes], counter: struct.Struct, layouts: Sequence[CompiledLayout]) -> Iterator[bytes]:
    """Yield the bytes that records have in a payload, in the first layout all of whose fields the first record has."""
    if counter is U16 and len(items) > MAX_COUNT:
        raise WireError(f"{len(items)} records, a packet counts at most {MAX_COUNT}")
    yield counter.pack(len(items))
    fields = _fields(items[0]) if items else {}
    complete = (each for each in layouts if all(key in fields for key in _keys(each)))
    layout = next(complete, layouts[0]) if len(layouts) > 1 else layouts[0]
    for item in items:
        fields = _fields(item)
        for step in layout.steps:
            if isinstance(step, Numbers):
                yield from _numbers(fields, wire_numbers(step))
            elif isinstance(step, Items):
                yield from _list(fields.get(step.number << 3 | LEN, []), step.counter, step.layouts)
            else:
                text = fields.get(step.number << 3 | LEN, [b""])[-1]
                text.decode()
                yield U16.pack(len(text)) + text


def _keys(layout: CompiledLayout) -> Iterator[int]:
    """Yield the keys of the numbers of a layout."""
    return (key for step in layout.steps if isinstance(step, Numbers) for key, *_ in wire_numbers(step).fields)
