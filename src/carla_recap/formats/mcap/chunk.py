"""Chunks while they are filled: messages one by one, or those of many frames that are alike, as rows of an array."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.codec import encode, encode_many, encode_rows, records_codec
from carla_recap.formats.mcap.schema import EMPTY, FILLED, MESSAGE, MESSAGE_DTYPE, MESSAGE_FIELDS, RECORD
from carla_recap.model.batch import ConstantColumn
from carla_recap.model.layout import EMPTY_LIST, OBJECTS_LIMIT, Framing, PayloadError
from carla_recap.model.records import FRAME_START, Group

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch, Column
    from carla_recap.model.layout import Buffer
    from carla_recap.model.records import RecordType

_HEADER: Final = np.dtype([*MESSAGE_DTYPE.descr, *codec.HEAD_DTYPE.descr])  # of each message: `MESSAGE`, `codec.HEAD`
_DURATION: Final = _HEADER.itemsize + 1  # the offset of the duration in a frame's own message


class ChunkBuilder:
    """A chunk being filled.

    Attributes:
        size: About how many bytes it will have.
        start: First log time in ns.
        end: Last log time in ns.
    """

    def __init__(self) -> None:
        self.size = 0
        self.start = self.end = 0
        # Channel, sequence, log and publish time, head and body of each message that is to be encoded; and by type the
        # indexes of those whose bodies are encoded together, with their payloads.
        self._messages: list[tuple[int, int, int, int, bytes, bytes]] = []
        self._waiting: dict[RecordType, tuple[list[int], list[Buffer]]] = {}
        self._parts: list[Buffer] = []
        self._index: dict[int, array[int]] = {}
        self._end = 0  # of the parts, in bytes

    @property
    def is_empty(self) -> bool:
        """Whether nothing was added so far."""
        return not self._messages and not self._parts

    def add(self, channel: int, sequence: int, times: tuple[int, int], head: bytes, body: bytes) -> None:
        """Add a message."""
        if self.is_empty:
            self.start = times[0]
        self.end = times[0]
        self.size += MESSAGE.size + len(head) + len(body)
        self._messages.append((channel, sequence, *times, head, body))

    def encode_later(self, type: RecordType, payload: Buffer, size: int) -> None:
        """Give the latest message a body of a known size, which is encoded together with others of its type."""
        waiting = self._waiting.get(type)
        if waiting is None:
            waiting = self._waiting[type] = ([], [])
        waiting[0].append(len(self._messages) - 1)
        waiting[1].append(payload)
        self.size += size

    def add_records(self, records: Sequence[Buffer], index: Mapping[int, NDArray[np.uint64]], start: int, end: int) -> None:
        """Add messages that are records already.

        Args:
            records: The records, some or all of them together.
            index: By channel, the log time in ns and the offset in the records of each message, (messages, 2).
            start: First log time in ns.
            end: Last log time in ns.
        """
        if self.is_empty:
            self.start = start
        self.end = end
        self._encode()
        for channel, entries in index.items():
            entries[:, 1] += np.uint64(self._end)
            self._index.setdefault(channel, array("Q")).frombytes(entries.tobytes())
        self._parts += records
        size = sum(map(len, records))
        self._end += size
        self.size += size

    def finish(self) -> tuple[bytes, dict[int, array[int]]]:
        """Return the records, and by channel the log time and offset of each message."""
        self._encode()
        return b"".join(self._parts), self._index

    def _encode(self) -> None:
        """Turn the messages into records."""
        bodies: dict[int, Buffer] = {}
        for type, (indexes, payloads) in self._waiting.items():
            bodies.update(zip(indexes, encode_many(type, payloads), strict=True))
        parts, index, end, pack = self._parts, self._index, self._end, MESSAGE.pack
        for number, (channel, sequence, log_time, publish_time, head, body) in enumerate(self._messages):
            data = bodies.get(number, body)
            length = MESSAGE_FIELDS + len(head) + len(data)
            entries = index.get(channel)
            if entries is None:
                entries = index[channel] = array("Q")
            entries.append(log_time)
            entries.append(end)
            parts += (pack(Opcode.MESSAGE, length, channel, sequence, log_time, publish_time), head, data)
            end += RECORD.size + length
        self._end = end
        self._messages.clear()
        self._waiting.clear()


class FrameTemplate:
    """The messages of frames that differ in nothing but their numbers.

    Args:
        channels: The channel of each type, by packet id.
        frame_channel: The channel of the messages of the frames themselves.
        batch: A batch of such frames; see `has_template`.

    Attributes:
        key: What batches with the same template have in common.
        size: The bytes of all messages of a frame.
        offsets: Channel and offset of each message.
        additional: Whether some packets are such as CARLA writes only when it records additional data.
    """

    def __init__(self, channels: Mapping[int, int], frame_channel: int, batch: Batch) -> None:
        self.key = template_key(batch)
        self.additional = any(column.type is not None and column.type.additional for column in batch.columns)
        self.offsets: list[tuple[int, int]] = []
        bodies: list[tuple[int, bytes]] = []
        for column in _filled(batch):
            type = column.type
            assert type is not None
            if type.fixed:
                bodies.append((channels[column.id], records_codec(type).blank(column.records.shape[1])))
            else:
                bodies.append((channels[column.id], encode(type, column.packet(0).payload)))
        ids = bytes((FRAME_START, *(column.id for column in batch.columns)))
        kinds = bytes((FRAME_START, *(EMPTY if _is_empty(column) else FILLED for column in batch.columns)))
        frame = codec.frame_body(0.0, ids, kinds)
        template = bytearray()
        for channel, body in (*bodies, (frame_channel, frame)):
            self.offsets.append((channel, len(template)))
            length = MESSAGE_FIELDS + codec.HEAD.size + len(body)
            template += MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, 0, 0) + codec.head(0, 0.0) + body
        self.size = len(template)
        self._template = np.frombuffer(bytes(template), np.uint8)

    def encode(self, batch: Batch) -> NDArray[np.uint8] | None:
        """Return the messages of a batch, (frames, bytes), without sequence numbers and times.

        None where the messages of the frames have other sizes after all.
        """
        rows = np.empty((len(batch), self.size), np.uint8)
        rows[:] = self._template
        ends = [offset for _, offset in self.offsets[1:]]
        for column, (_, offset), end in zip(_filled(batch), self.offsets, ends, strict=False):
            type = column.type
            assert type is not None
            if type.fixed:
                form = records_codec(type)
                form.fill(_fields(rows, form.wire, offset + _HEADER.itemsize, column.records.shape[1]), column.records)
                continue
            bodies = encode_rows(type, column.payloads(len(batch)))
            if bodies is None or offset + _HEADER.itemsize + bodies.shape[1] != end:
                return None
            rows[:, offset + _HEADER.itemsize : end] = bodies
        for _, offset in self.offsets:
            headers = _fields(rows, _HEADER, offset)
            headers["frame"] = batch.id
            headers["elapsed"] = batch.elapsed
        _fields(rows, np.dtype([("duration", "<f8")]), offset + _DURATION)["duration"] = batch.duration
        return rows

    def number(self, rows: NDArray[np.uint8], sequence: int, times: NDArray[np.uint64]) -> dict[int, NDArray[np.uint64]]:
        """Give messages their sequence numbers and times; return the index of them, see `ChunkBuilder.add_records`.

        Args:
            rows: The messages of each frame, (frames, bytes).
            sequence: The sequence number of the first frame.
            times: Log and publish time of each frame in ns, (frames, 2).
        """
        index = {}
        numbers = np.arange(sequence, sequence + len(rows))
        entries = np.empty((len(rows), 2), np.uint64)
        entries[:, 0] = times[:, 0]
        entries[:, 1] = np.arange(0, rows.nbytes, self.size)
        for channel, offset in self.offsets:
            headers = _fields(rows, MESSAGE_DTYPE, offset)
            headers["sequence"] = numbers
            headers["log_time"], headers["publish_time"] = times.T
            index[channel] = entries + np.array([0, offset], np.uint64)
        return index


def has_template(batch: Batch) -> bool:
    """Return whether the messages of all frames of a batch can be written at once."""
    ids = [column.id for column in _filled(batch)]
    if batch.preamble or len(set(ids)) < len(ids):
        return False
    return all(map(_is_regular, _filled(batch)))


def template_key(batch: Batch) -> tuple[tuple[int, int], ...]:
    """Return what batches with the same template have in common."""
    return tuple((column.id, -1 if _is_empty(column) else column.size) for column in batch.columns)


def _fields(rows: NDArray[np.uint8], dtype: np.dtype[np.void], offset: int, count: int | None = None) -> NDArray[np.void]:
    """Return structures at the same offset in all rows: one in each, (rows,), or some in each, (rows, count)."""
    shape, strides = (len(rows),), (rows.shape[1],)
    if count is not None:
        return np.ndarray((*shape, count), dtype, rows, offset, (*strides, dtype.itemsize))
    return np.ndarray(shape, dtype, rows, offset, strides)


def _filled(batch: Batch) -> list[Column]:
    return [column for column in batch.columns if not _is_empty(column)]


def _is_empty(column: Column) -> bool:
    """Return whether the packets hold no records."""
    type = column.type
    if type is None or not isinstance(column, ConstantColumn):
        return False
    return column.packet(0).payload == (b"" if type.framing is Framing.MARKER else EMPTY_LIST)


def _is_regular(column: Column) -> bool:
    """Return whether packets are like those that fill a message of state, and give their bytes back."""
    type = column.type
    if type is None or type.group is not Group.STATE or type.opaque or not type.topic or column.size > OBJECTS_LIMIT:
        return False
    if isinstance(column, ConstantColumn):
        return False
    try:
        if not type.fixed:
            return encode_rows(type, column.payloads(1)) is not None
        form, records = records_codec(type), column.records
        return form.payload_size(records.shape[1]) == column.size and form.fits(records)
    except (PayloadError, FormatError):
        return False
