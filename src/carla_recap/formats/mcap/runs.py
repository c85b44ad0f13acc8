"""Runs of frames in a chunk whose messages are alike, as columns of arrays.

The messages of a frame stand together, under one sequence number. Frames in a row that have messages on the same channels,
of the same sizes, in the same order, repeat at equal distances, so that numpy can view all of them at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from carla_recap.formats.mcap import wire
from carla_recap.formats.mcap.schema import MESSAGE, MESSAGE_FIELDS, RECORD
from carla_recap.model.batch import Column, equal_rows
from carla_recap.model.frame import Packet
from carla_recap.model.layout import U16
from carla_recap.model.records import Framing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.model.records import RecordType

Place = tuple[int, int, int]  # channel, offset of the message's data in the frame, and their size

_FIELDS: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_SHAPE_BYTES: Final = 11  # of a message: opcode, length and channel
_WORD: Final = 8


class BrokenRecords(ValueError):
    """The content of a chunk is no sequence of whole records."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageRun:
    """Frames of one shape that follow each other in a chunk.

    Attributes:
        sequence: The sequence number of the first one, which is its position in the recording.
        count: The number of frames.
        data: The records of the chunk.
        start: Where the messages of the first frame begin in the data.
        stride: Bytes from one frame to the next.
        places: The messages of each frame.
    """

    sequence: int
    count: int
    data: bytes
    start: int
    stride: int
    places: tuple[Place, ...]

    @property
    def times(self) -> NDArray[np.uint64]:
        """The log times of the frames in ns, (count,)."""
        return self.view(_FIELDS, self.places[0][1] - MESSAGE.size)["log_time"][:, 0]

    def first(self, count: int) -> MessageRun:
        """Return the first frames of the run."""
        return MessageRun(self.sequence, count, self.data, self.start, self.stride, self.places)

    def behind(self, count: int) -> MessageRun:
        """Return what is left behind the first frames."""
        start = self.start + count * self.stride
        return MessageRun(self.sequence + count, self.count - count, self.data, start, self.stride, self.places)

    def message(self, row: int, place: Place) -> memoryview:
        """Return the data of a message of one of the frames."""
        at = self.start + row * self.stride + place[1]
        return memoryview(self.data)[at : at + place[2]]

    def view(self, dtype: np.dtype[np.void], offset: int, number: int = 1) -> NDArray[np.void]:
        """Return structures that stand at the same place in all frames, (count, number)."""
        if not number:
            return np.empty((self.count, 0), dtype)
        strides = (self.stride, dtype.itemsize)
        return np.ndarray((self.count, number), dtype, self.data, self.start + offset, strides)

    def bytes_at(self, offset: int, size: int) -> NDArray[np.uint8]:
        """Return bytes that stand at the same place in all frames, (count, size)."""
        return np.ndarray((self.count, size), np.uint8, self.data, self.start + offset, (self.stride, 1))


def message_runs(data: bytes, spine: int) -> Iterator[MessageRun]:
    """Yield the frames of a chunk's records, in the order in which they stand there.

    Args:
        data: The records of the chunk.
        spine: The channel of the messages that say which packets a frame has: these are part of a frame's shape.

    Raises:
        BrokenRecords: The data are no whole records.
    """
    at, before = 0, None
    while at < len(data):
        sequence, places, end = _frame(data, at)
        if not places:
            return
        if before is not None and before.places == places and before.stride == end - at and before.sequence + 1 == sequence:
            run = _extended(before, spine)
            yield run
            at, before = run.start + run.count * run.stride, None
            if run.count > 1:
                continue
            sequence, places, end = _frame(data, at)
        elif before is not None:
            yield before
        before = MessageRun(sequence, 1, data, at, end - at, places)
        at = end
    if before is not None:
        yield before


def _frame(data: bytes, at: int) -> tuple[int, tuple[Place, ...], int]:
    """Return the sequence number of the frame at a place, its messages, and where it ends."""
    unpack, size, begin = MESSAGE.unpack_from, len(data), at
    places: list[Place] = []
    sequence = -1
    while at < size:
        if at + MESSAGE.size > size or data[at] != Opcode.MESSAGE:
            at = _behind_other(data, at)
            continue
        _, length, channel, number, _, _ = unpack(data, at)
        if places and number != sequence:
            break
        end = at + RECORD.size + length
        if end > size or length < MESSAGE_FIELDS:
            raise BrokenRecords(f"no whole record at byte {at} of its content")
        sequence = number
        places.append((channel, at + MESSAGE.size - begin, end - at - MESSAGE.size))
        at = end
    return sequence, tuple(places), at


def _behind_other(data: bytes, at: int) -> int:
    """Return where a record ends that is no message, such as a schema or channel."""
    opcode, length = RECORD.unpack_from(data, at) if at + RECORD.size <= len(data) else (0, len(data))
    if at + RECORD.size + length > len(data) or opcode == Opcode.MESSAGE:
        raise BrokenRecords(f"no whole record at byte {at} of its content")
    return at + RECORD.size + int(length)


def _extended(run: MessageRun, spine: int) -> MessageRun:
    """Return a run of one frame with those that follow it and are like it."""
    room = (len(run.data) - run.start) // run.stride
    compared: list[int] = []
    for channel, offset, size in run.places:
        begin = offset - MESSAGE.size
        compared += (begin, begin + _SHAPE_BYTES - _WORD)
        if channel == spine:
            first, end = offset + wire.HEAD.size + wire.FRAME_BODY.size, offset + size
            compared += (min(at, end - _WORD) for at in range(first, end, _WORD))
    # Words of all bytes, which overlap: to take some of them out is faster than to take each byte.
    words = np.ndarray((room, run.stride - _WORD + 1), np.uint64, run.data, run.start, (run.stride, 1))
    where = np.array(compared, np.intp)
    same = equal_rows(words, where)
    numbers = np.arange(run.sequence, run.sequence + same)
    for _, offset, _ in run.places:
        found = run.first(same).view(_FIELDS, offset - MESSAGE.size)["sequence"][:, 0]
        wrong = np.flatnonzero(found != numbers[:same])
        same = int(wrong[0]) if len(wrong) else same
    # Another message of the last frame may follow, which its shape does not have.
    behind = run.start + same * run.stride
    if behind + MESSAGE.size <= len(run.data) and run.data[behind] == Opcode.MESSAGE:
        same -= MESSAGE.unpack_from(run.data, behind)[3] == run.sequence + same - 1
    return run.first(max(same, 1))


class UniformColumn(Column):
    """Messages whose records have one size, at equal distances; those of all frames are decoded together.

    Args:
        type: The record type.
        run: The frames.
        place: The message in each of them.

    Raises:
        ValueError: Not all of the messages look as this package writes them.
    """

    __slots__ = ("_count", "_records", "_wire")

    def __init__(self, type: RecordType, run: MessageRun, place: Place) -> None:
        _, offset, size = place
        number = wire.uniform_count(type, size - wire.HEAD.size)
        body = run.bytes_at(offset + wire.HEAD.size, size - wire.HEAD.size)
        if number is None or not wire.have_heads(run.bytes_at(offset, wire.HEAD.size)) or not wire.is_uniform(type, body):
            raise ValueError(f"a {type.message_name} of another form")
        start = 0 if type.framing is Framing.SINGLE else U16.size
        super().__init__(type.id, type, start + number * type.dtype.itemsize)
        self._wire = run.view(wire.uniform_record(type), offset + wire.HEAD.size, number)
        self._count = run.count
        self._records: NDArray[np.void] | None = None

    @property
    def records(self) -> NDArray[np.void]:
        """See `Column.records`."""
        if self._records is None:
            assert self.type is not None
            self._records = np.empty(self._wire.shape, self.type.dtype)
            for name in self.type.dtype.names or ():
                self._records[name] = self._wire[name]
            self._records.flags.writeable = False
        return self._records

    def packet(self, row: int) -> Packet:
        """See `Column.packet`."""
        return Packet(self.id, self.type, records=self.records[row])

    def payloads(self, count: int) -> NDArray[np.uint8]:
        """See `Column.payloads`."""
        start = self.size - self._wire.shape[1] * self.records.dtype.itemsize
        data = np.empty((count, self.size), np.uint8)
        if start:
            data[:, :start] = np.frombuffer(U16.pack(self._wire.shape[1]), np.uint8)
        data[:, start:] = self.records[:count].view(np.uint8).reshape(count, -1)
        return data

    def sliced(self, start: int, stop: int) -> Column:
        """See `Column.sliced`."""
        part = object.__new__(UniformColumn)
        Column.__init__(part, self.id, self.type, self.size)
        part._wire, part._count = self._wire[start:stop], stop - start
        part._records = None if self._records is None else self._records[start:stop]
        return part


class PayloadColumn(Column):
    """Payloads as the rows of an array, (frames, bytes of each)."""

    __slots__ = ("_payloads",)

    def __init__(self, type: RecordType, payloads: NDArray[np.uint8]) -> None:
        super().__init__(type.id, type, payloads.shape[1])
        self._payloads = payloads

    @property
    def records(self) -> NDArray[np.void]:
        """Not to be had: the records vary in size."""
        raise TypeError("the records of this type vary in size")

    def packet(self, row: int) -> Packet:
        """See `Column.packet`."""
        return Packet(self.id, self.type, self._payloads[row].tobytes())

    def payloads(self, count: int) -> NDArray[np.uint8]:
        """See `Column.payloads`."""
        return self._payloads[:count]

    def sliced(self, start: int, stop: int) -> Column:
        """See `Column.sliced`."""
        assert self.type is not None
        return PayloadColumn(self.type, self._payloads[start:stop])


def column(type: RecordType, run: MessageRun, place: Place) -> Column:
    """Return the messages at one place of the frames of a run.

    Raises:
        ValueError: They cannot be decoded together.
        WireError: The first one contradicts its schema.
    """
    if type.fixed:
        return UniformColumn(type, run, place)
    payloads = wire.decode_rows(type, run.bytes_at(place[1], place[2]))
    if payloads is None:
        raise ValueError(f"messages of {type.message_name} of several forms")
    return PayloadColumn(type, payloads)
