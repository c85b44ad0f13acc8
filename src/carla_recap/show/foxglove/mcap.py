"""Writes an export as an MCAP file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from carla_recap.formats.mcap.container import ChunkBuilder, ChunkedFile
from carla_recap.formats.mcap.schema import EXPORT_METADATA, MESSAGE, MESSAGE_DTYPE, RECORD
from carla_recap.show.foxglove.topics import TOPICS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from carla_recap.formats.base import Topic
    from carla_recap.show.foxglove.messages import Times, TopicMessages
    from carla_recap.show.foxglove.topics import TimedMessages

_CHUNK_SIZE: Final = 1 << 20
_COMPRESSION_LEVEL: Final = 1  # the files are as small as those of level 3


class FoxgloveFile(ChunkedFile):
    """Writes messages.

    Args:
        path: The destination.
        description: The metadata.
        further: The topics of other messages, such as those of sensors.
        force: See `AtomicFile`.

    Raises:
        RecapError: The file cannot be written.
    """

    def __init__(
        self, path: Path | str, description: dict[str, str], further: Sequence[Topic] = (), *, force: bool = True
    ) -> None:
        topics = [*TOPICS, *further]
        super().__init__(path, topics, level=_COMPRESSION_LEVEL, force=force)
        self._channel_of = {topic.name: channel for channel, topic in enumerate(topics, 1)}
        self._chunk = ChunkBuilder()
        self._further_chunk = ChunkBuilder()
        self._begin(lambda: self._write_description(description))

    def write(self, added: TimedMessages) -> None:
        """Add messages in the order of time; where times are equal, in the given order."""
        messages, times, _ = added
        if not messages:
            return
        rows = np.concatenate([some.rows for some in messages])
        order = np.argsort(rows, kind="stable")
        counts = [len(some.rows) for some in messages]
        channels = np.repeat([self._channel_of[some.topic] for some in messages], counts)[order]
        sizes = np.repeat([some.data.shape[1] for some in messages], counts)[order]
        log_times = times[rows[order]]
        records: list[memoryview] = []
        for some in messages:
            records += _records(some, self._channel_of[some.topic], times)
        begin, offsets = 0, np.concatenate(([0], np.cumsum(sizes)))
        while begin < len(order):
            room = offsets[begin] + _CHUNK_SIZE - self._chunk.size
            stop = max(begin + 1, min(int(np.searchsorted(offsets, room)), len(order)))
            entries = np.stack((log_times[begin:stop], (offsets[begin:stop] - offsets[begin]).astype(np.uint64)), axis=1)
            index = {channel: entries[channels[begin:stop] == channel] for channel in set(channels[begin:stop].tolist())}
            packed = [records[record] for record in order[begin:stop].tolist()]
            self._chunk.add_records(packed, index, int(log_times[begin]), int(log_times[stop - 1]))
            if self._chunk.size >= _CHUNK_SIZE:
                self.end_chunk()
            begin = stop

    def write_further(self, topic: str, time: int, data: bytes) -> None:
        """Add a message of a further topic, to chunks that have no others.

        Its time is in ns since 1970.
        """
        self._further_chunk.add(self._channel_of[topic], 0, (time, time), b"", data)
        if self._further_chunk.size >= _CHUNK_SIZE:
            self._end_further()

    def _end_further(self) -> None:
        if not self._further_chunk.is_empty:
            chunk, self._further_chunk = self._further_chunk, ChunkBuilder()
            self._add_chunk(chunk)

    def end_chunk(self) -> None:
        """End the current chunk."""
        if not self._chunk.is_empty:
            chunk, self._chunk = self._chunk, ChunkBuilder()
            self._add_chunk(chunk)

    def _write_description(self, description: dict[str, str]) -> None:
        self._write_start()
        self._write_metadata(EXPORT_METADATA, description)
        for channel in self._channel_of.values():
            self._declare(channel)

    def _finish(self) -> None:
        self.end_chunk()
        self._end_further()
        super()._finish()


def _records(messages: TopicMessages, channel: int, times: Times) -> list[memoryview]:
    """Return the records of messages, whose headers are set."""
    size = messages.data.shape[1]
    header = messages.data[:, : MESSAGE.size].view(MESSAGE_DTYPE)[:, 0]
    header["opcode"], header["length"], header["channel"], header["sequence"] = (
        Opcode.MESSAGE,
        size - RECORD.size,
        channel,
        0,
    )
    header["log_time"] = header["publish_time"] = times[messages.rows]
    data = messages.data.reshape(-1).data
    return [data[start : start + size] for start in range(0, len(data), size)]
