"""Payloads of records of one size ↔ the bodies of their messages, many at once.

All numbers have a fixed size in the schemas: a message is the numbers of its records, between tags that are the same for
each record. A body is what follows `messages.HEAD`.
"""

from __future__ import annotations

import struct
from functools import cache
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.formats.mcap.messages import (
    FIXED32,
    FIXED64,
    HEAD,
    HEAD_DTYPE,
    ITEMS,
    LEN,
    VARINT,
    have_heads,
    tag,
    varint,
)
from carla_recap.model.layout import FLAG, MAX_COUNT, U16, Framing, Numbers, compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.model.layout import Buffer, PacketType

_WIRE_TYPES: Final = {"u4": FIXED32, "i4": FIXED32, "f4": FIXED32, "u8": FIXED64, "f8": FIXED64}


class WireNumbers:
    """How numbers that follow each other in a payload are written in a message.

    Args:
        numbers: The numbers.
        first: The field number of the first field of the record.

    Attributes:
        fields: Tag, kind, size, and the offset in the payload of each number.
        blank: The bytes of the message, all numbers being zero.
        sources: The offset in the payload of each byte of a number.
        targets: Its offset in the message.
        masks: Of each of these bytes, the bits that are not free: a number of one byte is to fit a varint of one byte.
        fixed_bits: The bits of the message that are not free, as one number.
        values: The numbers in the message, as bytes.
        numbers: The numbers in the message.
    """

    def __init__(self, numbers: Numbers, first: int = 1) -> None:
        self.fields: list[tuple[bytes, str, int, int]] = []
        blank, targets, masks, offset = bytearray(), list[int](), bytearray(), 0
        for number, kind in numbers.fields.values():
            size = 1 if kind == FLAG else int(kind[1:])
            name = tag(number + first - 1, _WIRE_TYPES.get(kind, VARINT))
            self.fields.append((name, kind, size, offset))
            blank += name
            targets += range(len(blank), len(blank) + size)
            masks += bytes((0 if size > 1 else 0xFE if kind == FLAG else 0x80,)) * size
            blank += bytes(size)
            offset += size
        self.blank = bytes(blank)
        self.sources = np.arange(offset)
        self.targets = np.array(targets)
        self.masks = np.frombuffer(bytes(masks), np.uint8)
        fixed_bits = np.full(len(blank), 0xFF, np.uint8)
        fixed_bits[self.targets] = self.masks
        self.fixed_bits = int.from_bytes(fixed_bits.tobytes(), "little")
        self.values = struct.Struct("".join(f"{len(name)}x{size}s" for name, _, size, _ in self.fields))
        codes = zip(self.fields, numbers.struct.format.removeprefix("<"), strict=True)
        self.numbers = struct.Struct("<" + "".join(f"{len(name)}x{code}" for (name, *_), code in codes))

    def matches(self, data: bytes) -> bool:
        """Return whether some bytes are these numbers in a message."""
        different = int.from_bytes(data, "little") ^ int.from_bytes(self.blank, "little")
        return len(data) == len(self.blank) and not different & self.fixed_bits


@cache
def wire_numbers(numbers: Numbers, first: int = 1) -> WireNumbers:
    """Return how some numbers are written in a message; see `WireNumbers`."""
    return WireNumbers(numbers, first)


class Payloads:
    """Payloads of packets of one type, decoded together.

    Args:
        records: The records of all of them, one after the other.
        ends: The end of the records of each.
        counted: Whether each payload begins with its number of records.
    """

    def __init__(self, records: NDArray[np.void], ends: list[int], *, counted: bool) -> None:
        records.setflags(write=False)
        self._records = records
        self._bytes = records.view(np.uint8).data if len(records) else memoryview(b"")
        self._size = records.dtype.itemsize
        self._ends = [*ends, 0]  # the last one stands before the first
        self._counted = counted

    def records(self, index: int) -> NDArray[np.void]:
        """Return the records of one payload."""
        return self._records[self._ends[index - 1] : self._ends[index]]

    def payload(self, index: int) -> bytes:
        """Return the bytes of one payload."""
        start, end = self._ends[index - 1], self._ends[index]
        data = self._bytes[start * self._size : end * self._size]
        return U16.pack(end - start) + data if self._counted else bytes(data)


class FixedCodec:
    """Encodes and decodes the packets of a type whose records have one size.

    Attributes:
        stride: Bytes of a record in a body.
        wire: The numpy type of a record in a body: its numbers, with gaps for what is the same in each.
    """

    def __init__(self, type: PacketType) -> None:
        (numbers,) = compiled(type).steps
        assert isinstance(numbers, Numbers)
        self._dtype = type.dtype
        self._single = type.framing is Framing.SINGLE
        self._start = 0 if self._single else U16.size
        form = wire_numbers(numbers, ITEMS if self._single else 1)
        header = b"" if self._single else tag(ITEMS, LEN) + varint(len(form.blank))
        blank = np.frombuffer(header + form.blank, np.uint8)
        targets = form.targets + len(header)
        self.stride = len(blank)
        self._blank = blank.view(np.void(self.stride).dtype)
        self._constants = [(offset, blank[offset]) for offset in {*range(self.stride)} - {*targets.tolist()}]
        fields: Any = type.dtype.fields
        offsets = {name: int(targets[offset]) for name, (_, offset, *_) in fields.items()}
        self._masks = {name: mask for name, (_, offset, *_) in fields.items() if (mask := form.masks[offset])}
        formats = [dtype for dtype, *_ in fields.values()]
        names = {"names": list(fields), "formats": formats, "offsets": list(offsets.values())}
        self.wire: np.dtype[np.void] = np.dtype({**names, "itemsize": self.stride})  # type: ignore[call-overload]

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
        """Return the records of bodies of the type `wire`."""
        records = np.empty(bodies.shape, self._dtype)
        for name in self._dtype.names or ():
            records[name] = bodies[name]
        return records

    def decode(self, messages: Sequence[Buffer]) -> Payloads | None:
        """Return the payloads of some messages; None where one is not as `encode` writes it."""
        sizes = np.array([len(message) for message in messages], np.int64) - HEAD.size
        counts, rest = np.divmod(sizes, self.stride)
        if rest.any() or (self._single and (counts != 1).any()) or not ((counts >= 0) & (counts <= MAX_COUNT)).all():
            return None
        if not have_heads(np.frombuffer(b"".join([message[: HEAD.size] for message in messages]), HEAD_DTYPE)):
            return None
        bodies = b"".join([message[HEAD.size :] for message in messages])
        if not self.matches(np.frombuffer(bodies, np.uint8).reshape(1, -1)):
            return None
        return Payloads(self.records(np.frombuffer(bodies, self.wire)), np.cumsum(counts).tolist(), counted=not self._single)


@cache
def fixed_codec(type: PacketType) -> FixedCodec:
    """Return the codec of a type whose records have one size."""
    return FixedCodec(type)
