"""A chunk while it is being filled."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode

from carla_recap.formats.mcap import wire
from carla_recap.formats.mcap.schema import MESSAGE, MESSAGE_FIELDS, RECORD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.layout import Buffer
    from carla_recap.model.records import RecordType


class Chunk:
    """A chunk being filled: messages, some with bodies that are encoded together later, and such as are encoded already.

    Attributes:
        size: About how many bytes it will have.
        start, end: First and last log time.
    """

    def __init__(self) -> None:
        self.size = 0
        self.start = self.end = 0
        # Channel, sequence, log and publish time, head and body of each; and those whose bodies are to come, by type: their
        # places, and their payloads.
        self._messages: list[tuple[int, int, int, int, bytes, bytes]] = []
        self._waiting: dict[RecordType, tuple[list[int], list[Buffer]]] = {}
        self._parts: list[Buffer] = []
        self._index: dict[int, array[int]] = {}
        self._at = 0

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing in it."""
        return not self._messages and not self._parts

    def add(self, channel: int, sequence: int, times: tuple[int, int], head: bytes, body: bytes) -> None:
        """Add a message."""
        if self.is_empty:
            self.start = times[0]
        self.end = times[0]
        self.size += MESSAGE.size + len(head) + len(body)
        self._messages.append((channel, sequence, *times, head, body))

    def wait_for(self, type: RecordType, payload: Buffer, size: int) -> None:
        """Let the body of the latest message, of some size, come with its like."""
        waiting = self._waiting.get(type)
        if waiting is None:
            waiting = self._waiting[type] = ([], [])
        places, payloads = waiting
        places.append(len(self._messages) - 1)
        payloads.append(payload)
        self.size += size

    def add_rows(self, data: bytes, index: dict[int, NDArray[np.uint64]], start: int, end: int) -> None:
        """Add messages that are encoded already; see `RowForm.rows`."""
        if self.is_empty:
            self.start = start
        self.end = end
        self._encode()
        for channel, entries in index.items():
            entries[:, 1] += np.uint64(self._at)
            self._index.setdefault(channel, array("Q")).frombytes(entries.tobytes())
        self._parts.append(data)
        self._at += len(data)
        self.size += len(data)

    def seal(self) -> tuple[bytes, dict[int, array[int]]]:
        """The records, and by channel the log time and offset of each message."""
        self._encode()
        return b"".join(self._parts), self._index

    def _encode(self) -> None:
        """Turn the messages into records."""
        bodies: dict[int, Buffer] = {}
        for type, (places, payloads) in self._waiting.items():
            bodies.update(zip(places, wire.encode_many(type, payloads), strict=True))
        parts, index, at, pack = self._parts, self._index, self._at, MESSAGE.pack
        for place, (channel, sequence, log_time, publish_time, head, body) in enumerate(self._messages):
            data = bodies.get(place, body)
            length = MESSAGE_FIELDS + len(head) + len(data)
            entries = index.get(channel)
            if entries is None:
                entries = index[channel] = array("Q")
            entries.append(log_time)
            entries.append(at)
            parts += (pack(Opcode.MESSAGE, length, channel, sequence, log_time, publish_time), head, data)
            at += RECORD.size + length
        self._at = at
        self._messages.clear()
        self._waiting.clear()
