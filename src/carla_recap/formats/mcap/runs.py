"""Runs of frames in a chunk whose messages are alike, as columns of arrays.

The messages of a frame follow each other, under one sequence number and log time. Consecutive frames with messages on the
same channels, of the same sizes, in the same order, repeat at equal distances, so that numpy can view all of them at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from carla_recap.formats.mcap.codec import FRAME_HEAD, HEAD, decode_rows, records_codec
from carla_recap.formats.mcap.schema import MESSAGE, MESSAGE_DTYPE, MESSAGE_FIELDS, RECORD
from carla_recap.model.batch import PackedColumn, equal_rows, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.model.batch import Column
    from carla_recap.model.records import RecordType

Slot = tuple[int, int, int]  # of a message in a frame: its channel, the offset and size of its data

_MESSAGE: Final = int(Opcode.MESSAGE)
_NO_MESSAGE: Final = (0,) * 6  # instead of the fields of one
_HEADER_BYTES: Final = 11  # of a message: opcode, length and channel


class BrokenRecords(ValueError):
    """The content of a chunk is no sequence of whole records."""


class MessageRun(NamedTuple):
    """Frames with the same slots that follow each other in a chunk."""

    sequence: int  # the sequence number of the first one, which is its position in the recording
    number: int  # the number of frames
    data: memoryview  # the records of the chunk
    start: int  # the offset in the data of the messages of the first frame, in bytes
    stride: int  # bytes from one frame to the next
    slots: tuple[Slot, ...]  # the messages of each frame
    time: int  # the log time of the first frame in ns

    @property
    def times(self) -> NDArray[np.uint64]:
        """The log times of the frames in ns, (frames,)."""
        return self.view(MESSAGE_DTYPE, self.slots[0][1] - MESSAGE.size)["log_time"][:, 0]

    def number_before(self, time: int) -> int:
        """Return the number of frames before a log time in ns."""
        # A plain int would make numpy compare as floats, which know a time since 1970 to 256 ns.
        return int(self.time < time) if self.number == 1 else int(np.searchsorted(self.times, np.uint64(time)))

    def part(self, start: int, stop: int) -> MessageRun:
        """Return the run of some of the frames."""
        if stop - start == self.number:
            return self
        offset, time = self.start + start * self.stride, int(self.times[start])
        return self._replace(sequence=self.sequence + start, number=stop - start, start=offset, time=time)

    def message(self, row: int, slot: Slot) -> memoryview:
        """Return the data of a message of one of the frames."""
        offset = self.start + row * self.stride + slot[1]
        return self.data[offset : offset + slot[2]]

    def view(self, dtype: np.dtype[np.void], offset: int, count: int = 1) -> NDArray[np.void]:
        """Return structures at the same offset in all frames, (frames, count)."""
        if not count:
            return np.empty((self.number, 0), dtype)
        strides = (self.stride, dtype.itemsize)
        return np.ndarray((self.number, count), dtype, self.data, self.start + offset, strides)

    def bytes_at(self, offset: int, size: int) -> NDArray[np.uint8]:
        """Return bytes at the same offset in all frames, (frames, size)."""
        return np.ndarray((self.number, size), np.uint8, self.data, self.start + offset, (self.stride, 1))


def message_runs(data: bytes, frame_channel: int) -> Iterator[MessageRun]:
    """Yield the frames of a chunk's records in order; those that differ on the frames' channel in runs of their own."""
    view, offset = memoryview(data), 0
    before: MessageRun | None = None
    while offset < len(data):
        frame, end = _frame(view, offset)
        if frame is None:
            break
        if before is not None:
            if before.slots == frame.slots and before.stride == frame.stride and before.sequence + 1 == frame.sequence:
                before = _extended(before, frame_channel)
            yield before
            if before.number > 1:
                offset, before = before.start + before.number * before.stride, None
                continue
        before, offset = frame, end
    if before is not None:
        yield before


def _frame(data: memoryview, offset: int) -> tuple[MessageRun | None, int]:
    """Return the frame at an offset as a run of its own, and the offset of its end."""
    unpack, header, size, start = MESSAGE.unpack_from, MESSAGE.size, len(data), offset
    slots: list[Slot] = []
    sequence, time = -1, 0
    while offset < size:
        opcode, length, channel, number, log_time, _ = unpack(data, offset) if offset + header <= size else _NO_MESSAGE
        if opcode != _MESSAGE:
            offset = _end_of_other(data, offset)
            continue
        if slots and (number, log_time) != (sequence, time):
            break
        end = offset + RECORD.size + length
        if end > size or length < MESSAGE_FIELDS:
            raise BrokenRecords(f"no whole record at byte {offset} of its content")
        if not slots:
            sequence, time = number, log_time
        offset += header
        slots.append((channel, offset - start, end - offset))
        offset = end
    return (MessageRun(sequence, 1, data, start, offset - start, tuple(slots), time) if slots else None), offset


def _end_of_other(data: memoryview, offset: int) -> int:
    """Return the end of a record that is no message, such as a schema or channel."""
    opcode, length = RECORD.unpack_from(data, offset) if offset + RECORD.size <= len(data) else (0, len(data))
    if offset + RECORD.size + length > len(data) or opcode == _MESSAGE:
        raise BrokenRecords(f"no whole record at byte {offset} of its content")
    return offset + RECORD.size + int(length)


def _extended(run: MessageRun, frame_channel: int) -> MessageRun:
    """Return a run of one frame with those that follow it and are like it."""
    room = (len(run.data) - run.start) // run.stride
    compared: list[int] = []
    for channel, offset, size in run.slots:
        compared += range(offset - MESSAGE.size, offset - MESSAGE.size + _HEADER_BYTES)
        if channel == frame_channel:
            compared += range(offset + FRAME_HEAD.itemsize, offset + size)
    frames = np.ndarray((room, run.stride), np.uint8, run.data, run.start)
    same = equal_rows(frames, np.array(compared, np.intp))
    numbers = np.arange(run.sequence, run.sequence + same)
    for _, offset, _ in run.slots:
        run = run._replace(number=same)
        found = run.view(MESSAGE_DTYPE, offset - MESSAGE.size)[:, 0]
        wrong = np.flatnonzero((found["sequence"] != numbers[:same]) | (found["log_time"] != run.times))
        same = int(wrong[0]) if len(wrong) else same
    # Another message of the last frame may follow, which the others do not have.
    end = run.start + same * run.stride
    if end + MESSAGE.size <= len(run.data) and run.data[end] == _MESSAGE:
        same -= MESSAGE.unpack_from(run.data, end)[3] == run.sequence + same - 1
    return run._replace(number=max(same, 1))


def column(type: RecordType, run: MessageRun, slot: Slot) -> Column:
    """Return the messages in a slot of the frames of a run, decoded, or raise `ValueError` if they cannot be together.

    Their heads are those of the frames.
    """
    _, offset, size = slot
    if not type.fixed:
        payloads = decode_rows(type, run.bytes_at(offset, size))
        if payloads is None:
            raise ValueError(f"messages of {type.message_name} of several forms")
        size = payloads.shape[1]
        return PackedColumn(type.id, type, size, payloads.reshape(-1).data, 0, size, run.number)
    codec, start, size = records_codec(type), offset + HEAD.size, size - HEAD.size
    count = codec.count_in(size)
    if count is None or not codec.matches(run.bytes_at(start, size)):
        raise ValueError(f"a {type.message_name} of another form")
    return packed(type, run.view(codec.wire, start, count))
