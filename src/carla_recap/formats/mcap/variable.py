"""Payloads of any structure ↔ their messages, such as of records whose size varies.

A message is the numbers of its payload, moved, between bytes that depend on nothing but the packet's *structure*: counts and
texts. The latest structure of each type is kept as a `PacketTemplate`, which moves all numbers of a packet at once. A
message with other fields, or in another order, is put in order by protobuf.

A payload that no message can give back byte for byte (a flag of 2, broken UTF-8, surplus bytes) is kept as a whole in the
message's field `raw` as well.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import astuple
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.formats.mcap.fixed import fixed_codec, wire_numbers
from carla_recap.formats.mcap.messages import (
    HEAD,
    HEAD_DTYPE,
    ITEMS,
    LEN,
    RAW_TAG,
    WireError,
    have_heads,
    head,
    parse,
    read_head,
    tag,
    varint,
)
from carla_recap.formats.mcap.schema import STRETCHES_MESSAGE
from carla_recap.model.layout import (
    FLAG,
    MAX_COUNT,
    OBJECTS_LIMIT,
    TEXT,
    U16,
    Framing,
    Items,
    Layout,
    Numbers,
    PacketType,
    Span,
    compiled,
    locate,
    unpack,
)
from carla_recap.model.records import Group

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.mcap.fixed import WireNumbers
    from carla_recap.model.layout import Buffer, CompiledLayout
    from carla_recap.model.records import RecordType

_VARINT_SIZE: Final = 10  # bytes of a number of 64 bits
_REPEATED: Final = 64  # bytes of a record: smaller ones, such as attributes, are cached, since many are equal
_SMALL: Final = 1 << 17  # bytes of a message: for larger ones, protobuf is worth the time of its import
_ENDING: Final = 1 << 10  # bytes behind the first numbers of a record: fewer are cached, such as those of a blueprint
_LEAST: Final = 7  # bytes of a record with nothing but an id
_templates: dict[RecordType, PacketTemplate] = {}  # of the latest packet of each type


class PacketTemplate(NamedTuple):
    """A structure of packets.

    Attributes:
        payload: A packet of this structure.
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


class _Encoder:
    """Writes the records of a payload as a message.

    Attributes:
        body: The message, whose numbers are still zero.
        moves: Numbers that are to be moved: their offset in the payload, in the message, and how they are written.
        exact: Whether the message gives the payload back.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self.body = bytearray()
        self.moves: list[tuple[int, int, WireNumbers]] = []
        self.exact = True

    def add(self, number: int, span: Span) -> None:
        """Add records as items of a field."""
        layout = span.layout
        for index in range(span.number):
            item = _Encoder(self._payload)
            if layout.make is None:
                item.add_record(layout, [span.offset + index * layout.dtype.itemsize])
            else:
                item.add_record(layout, span.records[index])
            self.body += tag(number, LEN) + varint(len(item.body))
            self.moves += [(source, len(self.body) + target, form) for source, target, form in item.moves]
            self.body += item.body
            self.exact &= item.exact

    def add_record(self, layout: CompiledLayout, parts: Sequence[int | slice | Span]) -> None:
        """Add the fields of a record."""
        for step, part in zip(layout.steps, parts, strict=True):
            if isinstance(step, Numbers):
                self.add_numbers(wire_numbers(step), part)  # type: ignore[arg-type]
            elif isinstance(part, slice):
                text = self._payload[part]
                clean = text.decode("utf-8", "replace").encode()
                self.exact &= clean == text
                self.body += tag(step.number, LEN) + varint(len(clean)) + clean
            else:
                self.add(step.number, part)  # type: ignore[arg-type]

    def add_numbers(self, form: WireNumbers, offset: int) -> None:
        """Add numbers; those that do not fit a varint of one byte as what comes closest."""
        payload = self._payload
        if not any(size == 1 and payload[offset + at] & form.masks[at] for _, _, size, at in form.fields):
            self.moves.append((offset, len(self.body), form))
            self.body += form.blank
            return
        self.exact = False
        for name, kind, size, at in form.fields:
            data = payload[offset + at : offset + at + size]
            if size == 1:
                value = min(data[0], 1) if kind == FLAG else int.from_bytes(data, signed=kind == "i1")
                data = varint(value % (1 << 64))
            self.body += name + data


class _Decoder:
    """Reads a message whose fields are all present and in order; methods raise `ValueError` or `struct.error` otherwise.

    Args:
        message: The message.
        choice: Which of alternative layouts to take.
        offset: The offset of the first field that belongs to the payload.
    """

    def __init__(self, message: bytes, choice: int, offset: int = HEAD.size) -> None:
        self._message = message
        self._choice = choice
        self._offset = offset

    def payload(self, type: PacketType) -> bytes:
        """Return the payload."""
        layout, size = compiled(type), len(self._message)
        if type.framing is Framing.SINGLE:
            payload = self._numbers(wire_numbers(layout.steps[0], ITEMS))
        else:
            payload = self._items(ITEMS, U16, layout, size)
        if read_head(self._message) is None or self._offset != size:
            raise ValueError("other fields")
        return payload

    def records(self, type: PacketType) -> list[Any]:
        """Return the records of a layout that begins with numbers; these must fit, as in nearly all messages they do."""
        layout = compiled(type)
        form, make, name = wire_numbers(layout.steps[0]), layout.make, tag(ITEMS, LEN)
        assert make is not None
        message, size, found = self._message, len(form.blank), []
        if read_head(message) is None:
            raise ValueError("other fields")
        while self._offset < len(message):
            record = self._take(self._size(name))
            numbers, ending = record[:size], record[size:]
            if not form.matches(numbers):
                raise ValueError("numbers of other sizes")
            endings = _ending if len(ending) <= _ENDING else _ending.__wrapped__
            values: list[Any] = list(form.numbers.unpack(numbers))
            for value, make_item in endings(type, ending):
                values.append([make_item(*item) for item in value] if make_item else value)
            found.append(make(*values))
        if len(found) > MAX_COUNT:
            raise ValueError("more records than a packet counts")
        return found

    def _items(self, number: int, counter: struct.Struct, layout: CompiledLayout, end: int) -> bytes:
        """Return the items of a field of a message that ends at an offset, with their number in front."""
        name, items = tag(number, LEN), []
        while self._offset < end and self._message.startswith(name, self._offset):
            size = self._size(name)
            if size > _REPEATED:
                items.append(self._record(layout, self._offset + size))
            else:
                items.append(_decoded(layout, self._choice, self._take(size)))
        return counter.pack(len(items)) + b"".join(items)

    def _record(self, layout: CompiledLayout, end: int) -> bytes:
        parts = []
        for step in layout.steps:
            if isinstance(step, Numbers):
                parts.append(self._numbers(wire_numbers(step)))
            elif isinstance(step, Items):
                inner = step.layouts[min(self._choice, len(step.layouts) - 1)]
                parts.append(self._items(step.number, step.counter, inner, end))
            else:
                text = self._take(self._size(tag(step.number, LEN)))
                text.decode()
                parts.append(U16.pack(len(text)) + text)
        if self._offset != end:
            raise ValueError("another size")
        return b"".join(parts)

    def _numbers(self, form: WireNumbers) -> bytes:
        found = self._message[self._offset : self._offset + len(form.blank)]
        if form.matches(found):
            self._offset += len(found)
            return b"".join(form.values.unpack(found))
        data = bytearray()
        for name, kind, size, _ in form.fields:
            if self._take(len(name)) != name:
                raise ValueError("another field")
            if size > 1:
                data += self._take(size)
                continue
            value = self._varint()
            if kind == "i1":
                data += struct.pack("b", value - (value >> 63 << 64))
            else:
                data.append(min(value, 1) if kind == FLAG else value)
        return bytes(data)

    def _size(self, name: bytes) -> int:
        """Go over a tag and the size behind it."""
        if not self._message.startswith(name, self._offset):
            raise ValueError("another field")
        self._offset += len(name)
        return self._varint()

    def _varint(self) -> int:
        value = 0
        for index, byte in enumerate(self._message[self._offset : self._offset + _VARINT_SIZE]):
            value |= (byte & 0x7F) << 7 * index
            if byte < 0x80:
                self._offset += index + 1
                return value
        raise ValueError("no whole number of at most 64 bits")

    def _take(self, size: int) -> bytes:
        found = self._message[self._offset : self._offset + size]
        if len(found) < size:
            raise ValueError("too few bytes")
        self._offset += size
        return found


@lru_cache(maxsize=1 << 12)
def _decoded(layout: CompiledLayout, choice: int, record: bytes) -> bytes:
    """Return the bytes of a record in a payload."""
    return _Decoder(record, choice, 0)._record(layout, len(record))


@lru_cache(maxsize=1 << 10)
def _ending(type: PacketType, data: bytes) -> list[tuple[Any, Callable[..., Any] | None]]:
    """Return the values behind the first numbers of a record: a text, or the values of each item, and the items' class."""
    first, *steps = compiled(type).steps
    record = wire_numbers(first).blank + data
    message = tag(ITEMS, LEN) + varint(len(record)) + record
    decoder = _Decoder(head(0, 0.0) + message, 0)
    ((found,), _) = unpack(type, decoder.payload(type))
    values: list[tuple[Any, Callable[..., Any] | None]] = []
    for step in steps:
        assert not isinstance(step, Numbers)
        value, make = getattr(found, step.name), step.layouts[0].make if isinstance(step, Items) else None
        values.append(([astuple(item) for item in value] if make else value, make))
    return values


def _template(type: RecordType, payload: Buffer) -> tuple[PacketTemplate, bytes]:
    """Return the structure of a packet, and what its message has behind that to give the payload back.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    data = bytes(payload)
    span, rest = locate(type, data)
    encoder = _Encoder(data)
    if type.framing is Framing.SINGLE:
        encoder.add_numbers(wire_numbers(span.layout.steps[0], ITEMS), 0)
    else:
        encoder.add(ITEMS, span)
    none = [np.empty(0, np.intp)]
    sources = np.concatenate(none + [source + form.sources for source, _, form in encoder.moves])
    targets = np.concatenate(none + [target + form.targets for _, target, form in encoder.moves])
    masks = np.concatenate([np.empty(0, np.uint8), *(form.masks for _, _, form in encoder.moves)])
    array, body = np.frombuffer(data, np.uint8), np.frombuffer(encoder.body, np.uint8)
    body[targets] = array[sources]
    payload_mask, body_mask = np.full(len(array), 0xFF, np.uint8), np.full(len(body), 0xFF, np.uint8)
    payload_mask[sources] = body_mask[targets] = masks
    raw = b"" if encoder.exact and not rest else bytes([RAW_TAG]) + varint(len(data)) + data
    return PacketTemplate(array, body, sources, targets, payload_mask, body_mask), raw


def encode(type: RecordType, payload: Buffer) -> bytes:
    """Return the body of a message.

    Raises:
        PayloadError: The payload contradicts the type's layout.
    """
    if type.fixed:
        return bytes(encode_many(type, [payload])[0])
    template = _templates.get(type)
    bodies = template.encode(_row(payload)) if template else None
    if bodies is not None:
        return bodies.tobytes()
    template, raw = _template(type, payload)
    if not raw and type.group is Group.STATE:
        _templates[type] = template
    return template.body.tobytes() + raw


def encode_many(type: RecordType, payloads: Sequence[Buffer]) -> Sequence[Buffer]:
    """Return the bodies of messages of a type whose records have one size.

    Raises:
        PayloadError: A payload contradicts the type's layout.
    """
    bodies = fixed_codec(type).encode(payloads)
    if bodies is not None:
        return bodies
    return [template.body.tobytes() + raw for template, raw in (_template(type, payload) for payload in payloads)]


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
        found = fixed_codec(type).decode([data])
        return found.payload(0) if found else _decode_any(type, data)
    template = _templates.get(type)
    payloads = template.decode(_row(data)) if template else None
    return _decode_any(type, data) if payloads is None else payloads.tobytes()


def decode_records(type: RecordType, data: Buffer) -> list[Any] | None:
    """Return the records of a message of events whose size varies; None where its payload has to be decoded first.

    Many actors have the same blueprint and attributes: these are decoded once.
    """
    if type.fixed or type.opaque or type.group is Group.STATE or compiled(type).choices > 1 or len(data) > OBJECTS_LIMIT:
        return None
    with suppress(ValueError, struct.error):
        return _Decoder(bytes(data), 0).records(type)
    return None


def decode_rows(type: RecordType, messages: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return the payloads of messages of varying size that have the structure of the first one, (messages, bytes).

    None where one of them has another.

    Raises:
        WireError: The first message contradicts its schema.
    """
    decode(type, messages[0].tobytes())
    template = _templates.get(type)
    return template.decode(messages) if template else None


class _Interval(NamedTuple):
    id: int
    type_id: str
    start: float
    duration: float
    x: float
    y: float
    z: float


_INTERVALS: Final = PacketType(
    name="stretches",
    layout=Layout(
        {"id": "u4", "type_id": TEXT, "start": "f8", "duration": "f8", "x": "f8", "y": "f8", "z": "f8"}, _Interval
    ),
)


def decode_intervals(data: Buffer) -> Iterable[Any]:
    """Return the stationary intervals of a `Stretches` message, with the attributes of a `Stretch`.

    Raises:
        WireError: It is no such message.
    """
    if len(data) < _SMALL:
        with suppress(ValueError, struct.error):
            return unpack(_INTERVALS, _Decoder(bytes(data), 0).payload(_INTERVALS))[0]
    found: Iterable[Any] = parse(_INTERVALS.name, STRETCHES_MESSAGE, data).stretches
    return found


def _row(data: Buffer) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)[None]


# --- by way of protobuf ------------------------------------------------------------------------------------------------


def _decode_any(type: RecordType, data: Buffer) -> bytes:
    payload = _decode_in_order(type, bytes(data)) if len(data) <= OBJECTS_LIMIT else None
    if payload is None:
        return _decode_by_protobuf(type, data)
    if not type.fixed and type.group is Group.STATE:
        _templates[type], _ = _template(type, payload)
    return payload


def _decode_by_protobuf(type: RecordType, data: Buffer) -> bytes:
    message = parse(type.name, type.message_name, data)
    if message.HasField("raw"):
        return bytes(message.raw)
    _complete(type, message, len(data))
    payload = _decode_in_order(type, message.SerializeToString())
    if payload is None:
        raise WireError(f"{type.name}: numbers beyond their fields")
    return payload


def _decode_in_order(type: RecordType, message: bytes) -> bytes | None:
    """Return the payload of a message whose fields are all present and in order; None if they are not."""
    for choice in range(compiled(type).choices):
        with suppress(ValueError, struct.error):
            return _Decoder(message, choice).payload(type)
    return None


def _complete(type: RecordType, message: Any, size: int) -> None:
    """Set the missing fields of a message to zero, and remove all that its type does not have."""
    message.DiscardUnknownFields()
    names = ["frame", "elapsed"]
    if type.framing is Framing.SINGLE:
        names.append(type.items)
    else:
        items = getattr(message, type.items)
        if not type.fixed and _LEAST * len(items) > size:
            raise WireError(f"{type.name}: {len(items)} records in {size} bytes, most of them without an id")
        if len(items) > MAX_COUNT:
            raise WireError(f"{type.name}: {len(items)} records, a packet counts at most {MAX_COUNT}")
        _complete_items([compiled(type)], items)
    _set_missing(message, names)


def _complete_items(layouts: Sequence[CompiledLayout], messages: Any) -> None:
    """Complete messages of the one of some layouts of which the first message has all fields."""
    layout = layouts[0]
    if messages and len(layouts) > 1:
        layout = next((each for each in layouts if all(map(messages[0].HasField, each.dtype.names or ()))), layout)
    others = set(layouts[0].dtype.names or ()) - set(layout.dtype.names or ())
    for message in messages:
        for name in others:
            message.ClearField(name)
        for step in layout.steps:
            if isinstance(step, Items):
                items = getattr(message, step.name)
                if len(items) > MAX_COUNT:
                    raise WireError(f"{len(items)} items in a record, at most {MAX_COUNT} were expected")
                _complete_items(step.layouts, items)
            else:
                _set_missing(message, step.fields if isinstance(step, Numbers) else [step.name])


def _set_missing(message: Any, names: Iterable[str]) -> None:
    for name in names:
        if not message.HasField(name):
            setattr(message, name, getattr(message, name))
