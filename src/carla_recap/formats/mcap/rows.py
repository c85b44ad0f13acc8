"""Frames that differ in nothing but their numbers, as rows of an array: the messages of each, as they stand in a chunk."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError
from carla_recap.formats.mcap import wire
from carla_recap.formats.mcap.schema import EMPTY, FILLED, MESSAGE, MESSAGE_FIELDS
from carla_recap.model.batch import ConstantColumn
from carla_recap.model.layout import EMPTY_LIST, OBJECTS_LIMIT, U16, PayloadError
from carla_recap.model.records import FRAME_START, Framing, Group

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import DTypeLike, NDArray

    from carla_recap.model.batch import Batch, Column

_HEADER: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("frame_tag", "u1"),
        ("frame", "<u8"),
        ("elapsed_tag", "u1"),
        ("elapsed", "<f8"),
    ]
)
"""What each message begins with: `MESSAGE`, and then `wire.HEAD`."""
_OWN: Final = ("sequence", "log_time", "publish_time", "frame", "elapsed")
"""What is each frame's own in it."""


class RowForm:
    """How the messages of each frame of some batches follow each other.

    Args:
        channels: The channel of each type, by packet id.
        frame_channel: The channel of the messages of the frames themselves.
        batch: A batch of this form; see `has_form`.

    Attributes:
        key: What batches of this form have in common.
        size: The bytes of all messages of a frame.
        additional: Whether there are packets that CARLA writes only when it records additional data.
    """

    def __init__(self, channels: Mapping[int, int], frame_channel: int, batch: Batch) -> None:
        self.key = key(batch)
        self.additional = any(column.type is not None and column.type.additional for column in batch.columns)
        self._messages: list[tuple[int, int]] = []  # channel and offset of each
        self._fields: dict[str, tuple[DTypeLike, int]] = {}
        template = bytearray()
        kinds = bytearray((FRAME_START,))
        for column in batch.columns:
            if _is_empty(column):
                kinds.append(EMPTY)
                continue
            kinds.append(FILLED)
            assert column.type is not None
            at = len(template) + _HEADER.itemsize
            if column.type.fixed:
                body, dtype = wire.uniform_body(column.type, column.records.shape[1])
                self._fields[column.type.name] = (dtype, (column.records.shape[1],)), at
            else:
                body = wire.encode(column.type, column.packet(0).payload)
                self._fields[column.type.name] = ("u1", (len(body),)), at
            self._add(template, channels[column.id], body)
        ids = bytes((FRAME_START, *(column.id for column in batch.columns)))
        self._fields["duration"] = "<f8", len(template) + _HEADER.itemsize + 1  # behind its tag
        self._add(template, frame_channel, wire.frame_body(0.0, ids, bytes(kinds)))
        self.size = len(template)
        self._template = np.frombuffer(bytes(template), np.uint8)
        self._dtype = np.dtype(
            {
                "names": list(self._fields),
                "formats": [dtype for dtype, _ in self._fields.values()],
                "offsets": [at for _, at in self._fields.values()],
                "itemsize": self.size,
            }
        )

    def messages(self, batch: Batch) -> NDArray[np.uint8] | None:
        """Return the messages of a batch of this form without their own numbers and times, (frames, bytes).

        None where the messages of the frames have other sizes after all.
        """
        count = len(batch)
        data = np.empty((count, self.size), np.uint8)
        data[:] = self._template
        rows = data.view(self._dtype)[:, 0]
        for column in batch.columns:
            if _is_empty(column):
                continue
            assert column.type is not None
            if column.type.fixed:
                wire.fill(column.type, rows[column.type.name], column.records)
                continue
            bodies = wire.encode_rows(column.type, column.payloads(count))
            if bodies is None or bodies.shape != rows[column.type.name].shape:
                return None
            rows[column.type.name] = bodies
        rows["duration"] = batch.duration
        return data

    def number(
        self, messages: NDArray[np.uint8], batch: Batch, sequence: int, times: NDArray[np.uint64]
    ) -> dict[int, NDArray[np.uint64]]:
        """Number messages and give them their times.

        Args:
            messages: What `messages` returned.
            batch: The frames of these messages.
            sequence: The sequence number of the first of them.
            times: Log and publish time of each frame in ns, (frames, 2).

        Returns:
            By channel, the log time and offset of each message, (messages, 2).
        """
        count = len(batch)
        header = np.empty(count, _HEADER)
        header["sequence"] = np.arange(sequence, sequence + count)
        header["log_time"], header["publish_time"] = times.T
        header["frame"] = batch.id
        header["elapsed"] = batch.elapsed
        rows = messages.view(self._dtype)[:, 0]
        index: dict[int, NDArray[np.uint64]] = {}
        begins = np.arange(0, count * self.size, self.size, dtype=np.uint64)
        for channel, at in self._messages:
            headers = rows[_header_at(at)]
            for name in _OWN:
                headers[name] = header[name]
            index[channel] = np.stack((times[:, 0], begins + np.uint64(at)), axis=1)
        return index

    def _add(self, template: bytearray, channel: int, body: bytes) -> None:
        self._messages.append((channel, len(template)))
        self._fields[_header_at(len(template))] = _HEADER, len(template)
        length = MESSAGE_FIELDS + wire.HEAD.size + len(body)
        template += MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, 0, 0) + wire.head(0, 0.0) + body


def has_form(batch: Batch) -> bool:
    """Return whether the messages of all frames of a batch can be written at once."""
    names = [column.id for column in batch.columns if not _is_empty(column)]
    if batch.preamble or len(set(names)) < len(names):
        return False
    return all(_is_empty(column) or _is_regular(column) for column in batch.columns)


def key(batch: Batch) -> tuple[tuple[int, int], ...]:
    """Return what batches of the same form have in common."""
    return tuple((column.id, -1 if _is_empty(column) else column.size) for column in batch.columns)


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
            return wire.encode_rows(type, column.payloads(1)) is not None
        start = 0 if type.framing is Framing.SINGLE else U16.size
        records = column.records
        return start + records.shape[1] * type.dtype.itemsize == column.size and wire.fits(type, records)
    except (PayloadError, FormatError):
        return False


def _header_at(offset: int) -> str:
    """Return the name of the field of the header of the message at an offset."""
    return f"header at {offset}"
