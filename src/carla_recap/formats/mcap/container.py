"""Writes MCAP files of protobuf messages in chunks, which are compressed while the next messages are made.

Schemas and channels stand outside all chunks, before the first that needs them, and again in the summary: a damaged chunk
costs only itself.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import Counter, deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import groupby
from threading import local
from typing import TYPE_CHECKING, Final

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from carla_recap.formats.base import Topic
from carla_recap.formats.mcap.schema import CHUNK, FOOTER, MAGIC, MESSAGE, MESSAGE_FIELDS, MESSAGE_INDEX, RECORD, U64
from carla_recap.util.files import AtomicFile

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from carla_recap.model.layout import Buffer

_COMPRESSION: Final = "zstd"
_WORKERS: Final = 2
_CHUNK_SIZE: Final = 1 << 20  # bytes from which on a chunk of a `MessageFile` is ended
_QUEUE: Final = 4  # chunks that are being compressed, or wait for it
_HELD_LIMIT: Final = 64 << 20
"""The most bytes of chunks that are held back for the end of the file."""
_of_thread: Final = local()


class ChunkBuilder:
    """A chunk being filled."""

    def __init__(self) -> None:
        self.size = 0  # bytes
        self.start = self.end = 0  # the first and the last log time in ns
        self._parts: list[Buffer] = []
        self._index: dict[int, array[int]] = {}

    @property
    def is_empty(self) -> bool:
        """Whether nothing was added so far."""
        return not self._parts

    def add(self, channel: int, sequence: int, times: tuple[int, int], head: bytes, body: bytes) -> None:
        """Add a message, at its log and publish time in ns."""
        time = times[0]
        self.start = min(self.start, time) if self._parts else time
        self.end = max(self.end, time) if self._parts else time
        length = MESSAGE_FIELDS + len(head) + len(body)
        self._parts += (MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, *times), head, body)
        self._index.setdefault(channel, array("Q")).extend((time, self.size))
        self.size += RECORD.size + length

    def add_records(self, records: Sequence[Buffer], index: Mapping[int, NDArray[np.uint64]], start: int, end: int) -> None:
        """Add messages that are records already, and have log times from `start` to `end` in ns.

        `index` has by channel the log time in ns and the offset in the records of each message, (messages, 2).
        """
        if self.is_empty:
            self.start = start
        self.end = end
        for channel, entries in index.items():
            entries[:, 1] += np.uint64(self.size)
            self._index.setdefault(channel, array("Q")).frombytes(entries.tobytes())
        self._parts += records
        self.size += sum(map(len, records))

    def finish(self) -> tuple[bytes, dict[int, array[int]]]:
        """Return the records, and by channel the log time and offset of each message."""
        return b"".join(self._parts), self._index


@dataclass(frozen=True)
class _Sealed:
    """A chunk that is being compressed, or waits to be written; `at_end`: behind all others."""

    start: int
    end: int
    size: int
    index: dict[int, array[int]]
    compressed: Future[tuple[bytes, int]]
    at_end: bool

    @property
    def bytes(self) -> int:
        """About how many bytes it takes in memory and in the file, with its message indexes."""
        return len(self.compressed.result()[0]) + sum(len(entries) * entries.itemsize for entries in self.index.values())


class ChunkedFile(AtomicFile):
    """Base of the writers of MCAP files; see `AtomicFile`. Chunks of live files are written when they are cut.

    The channel of a topic is its position among the topics, from 1. Topics of the same message share a schema.
    """

    def __init__(
        self, path: Path | str, topics: Sequence[Topic], *, level: int, live: bool = False, force: bool = True
    ) -> None:
        super().__init__(path, live=live, force=force)
        self._topics = list(topics)
        self._level = level
        self._pool = ThreadPoolExecutor(_WORKERS, "carla-recap-compress")
        self._sealed: deque[_Sealed] = deque()
        self._held: list[_Sealed] = []
        self._held_bytes = 0
        self._holds = not live
        self._position = self._crc = 0
        self._counts: Counter[int] = Counter()  # messages of each declared channel
        self._schemas: dict[tuple[str, str, bytes], records.Schema] = {}  # by name, encoding and data
        self._channels: list[records.Channel] = []
        self._chunk_index: list[records.ChunkIndex] = []
        self._metadata_index: list[records.MetadataIndex] = []

    def abandon(self) -> Path:
        """Give the file up, but leave what was written; see `AtomicFile.abandon`."""
        self._pool.shutdown(cancel_futures=True)
        return super().abandon()

    def _write_start(self) -> None:
        """Write what comes before all other records."""
        self._emit(MAGIC)
        self._crc = zlib.crc32(MAGIC)
        self._emit(_packed(records.Header(profile="", library=f"carla-recap/{version('carla-recap')}")))

    def _write_metadata(self, name: str, values: dict[str, str]) -> None:
        start = self._position
        self._emit(_packed(records.Metadata(name=name, metadata=values)))
        self._metadata_index.append(records.MetadataIndex(length=self._position - start, name=name, offset=start))

    def _declare(self, channel: int) -> None:
        """Write a channel, and its schema unless another channel has it."""
        topic = self._topics[channel - 1]
        schema_id = 0
        if topic.message:
            key = topic.message, topic.schema_encoding, topic.schema()
            schema = self._schemas.get(key)
            if schema is None:
                schema = records.Schema(id=channel, data=key[2], encoding=key[1], name=key[0])
                self._schemas[key] = schema
                self._emit(_packed(schema))
            schema_id = schema.id
        declared = records.Channel(
            id=channel,
            topic=topic.name,
            message_encoding=topic.encoding,
            metadata=dict(topic.metadata),
            schema_id=schema_id,
        )
        self._channels.append(declared)
        self._counts[channel] = 0
        self._emit(_packed(declared))

    def _add_chunk(self, chunk: ChunkBuilder, *, at_end: bool = False) -> None:
        """Send a chunk to be compressed; chunks that are ready are written.

        With `at_end`, it is held back until `_write_held`, unless the file is live, or too much is held back already.
        """
        data, index = chunk.finish()
        self._sealed.append(_Sealed(chunk.start, chunk.end, len(data), index, self._compressed(data), at_end))
        self._write_chunks(0 if self._live else _QUEUE)

    def _compressed(self, data: bytes) -> Future[tuple[bytes, int]]:
        try:
            return self._pool.submit(_compress, data, self._level)
        except RuntimeError:  # the interpreter is about to end, and starts no thread
            done: Future[tuple[bytes, int]] = Future()
            done.set_result(_compress(data, self._level))
            return done

    def _write_chunks(self, waiting: int) -> None:
        """Write chunks, or hold them back, until no more than some of them wait."""
        while len(self._sealed) > waiting:
            chunk = self._sealed.popleft()
            for channel in chunk.index:
                if channel not in self._counts:
                    self._declare(channel)
            if not (chunk.at_end and self._holds):
                self._write_chunk(chunk)
                continue
            self._held.append(chunk)
            self._held_bytes += chunk.bytes
            if self._held_bytes > _HELD_LIMIT:
                self._write_held()
                self._holds = False

    def _write_held(self) -> int | None:
        """Write the chunks that were held back; return their offset, None if they are not all together."""
        start = self._position if self._holds else None
        for chunk in self._held:
            self._write_chunk(chunk)
        self._held.clear()
        return start

    def _write_chunk(self, chunk: _Sealed) -> None:
        compressed, crc = chunk.compressed.result()
        compression = _COMPRESSION.encode()
        start = self._position
        self._emit(
            RECORD.pack(Opcode.CHUNK, CHUNK.size + len(compression) + U64.size + len(compressed))
            + CHUNK.pack(chunk.start, chunk.end, chunk.size, crc, len(compression))
            + compression
            + U64.pack(len(compressed))
        )
        self._emit(compressed)
        size = self._position - start
        offsets = {}
        for channel, entries in chunk.index.items():
            offsets[channel] = self._position
            packed = entries.tobytes()
            self._counts[channel] += len(entries) // 2
            self._emit(
                RECORD.pack(Opcode.MESSAGE_INDEX, MESSAGE_INDEX.size + len(packed))
                + MESSAGE_INDEX.pack(channel, len(packed))
                + packed
            )
        self._chunk_index.append(
            records.ChunkIndex(
                chunk_length=size,
                chunk_start_offset=start,
                compression=_COMPRESSION,
                compressed_size=len(compressed),
                message_end_time=chunk.end,
                message_index_length=self._position - start - size,
                message_index_offsets=offsets,
                message_start_time=chunk.start,
                uncompressed_size=chunk.size,
            )
        )
        if self._live:
            self._sync()

    def _finish(self) -> None:
        """Write the chunks that wait, and the summary."""
        self._write_chunks(0)
        self._pool.shutdown()
        self._emit(_packed(records.DataEnd(data_section_crc=self._crc)))
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_index),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunk_index), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunk_index), default=0),
            metadata_count=len(self._metadata_index),
            schema_count=len(self._schemas),
        )
        groups = (self._schemas.values(), self._channels, [statistics], self._metadata_index, self._chunk_index)
        self._put(_summary(self._position, [record for group in groups for record in group]))

    def _emit(self, data: bytes) -> None:
        self._put(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)


def message_topic(name: str, message: type[Message], metadata: dict[str, str] | None = None) -> Topic:
    """Return the topic of a message of protobuf; its schema is the descriptors of all files that the message needs."""
    return Topic(name, message.DESCRIPTOR.full_name, partial(schema_of, message), metadata or {})


def schema_of(message: type[Message]) -> bytes:
    """Return the schema of a message of protobuf."""
    from mcap_protobuf.schema import build_file_descriptor_set

    data: bytes = build_file_descriptor_set(message).SerializeToString()
    return data


class MessageFile(ChunkedFile):
    """Writes messages of topics, which are all declared at the start, after metadata by their names; see `AtomicFile`."""

    def __init__(
        self, path: Path | str, topics: Sequence[Topic], about: Mapping[str, dict[str, str]], *, level: int, force: bool
    ) -> None:
        super().__init__(path, topics, level=level, force=force)
        self._about = about
        self._channel_of = {topic.name: channel for channel, topic in enumerate(self._topics, 1)}
        self._chunks: dict[str, ChunkBuilder] = {}
        self._begin(self._write_about)

    def write(self, topic: str, time: int, data: bytes, *, group: str = "") -> None:
        """Add a message, at its time in ns; those of a group are in chunks of their own, in the order of time."""
        chunk = self._chunks.setdefault(group, ChunkBuilder())
        chunk.add(self._channel_of[topic], 0, (time, time), b"", data)
        if chunk.size >= _CHUNK_SIZE:
            self.end_chunk(group)

    def end_chunk(self, group: str = "") -> None:
        """End the current chunk of a group, after which times can begin again."""
        if group in self._chunks:
            self._add_chunk(self._chunks.pop(group))

    def _write_about(self) -> None:
        self._write_start()
        for name, values in self._about.items():
            self._write_metadata(name, values)
        for channel in self._channel_of.values():
            self._declare(channel)

    def _finish(self) -> None:
        for group in list(self._chunks):
            self.end_chunk(group)
        super()._finish()


def _compress(data: bytes, level: int) -> tuple[bytes, int]:
    """Return a chunk's records, compressed, and their checksum."""
    compressors: dict[int, zstandard.ZstdCompressor] = _of_thread.__dict__.setdefault("compressors", {})
    if level not in compressors:  # a new one takes a fifth of the time of compressing a chunk
        compressors[level] = zstandard.ZstdCompressor(level=level)
    return compressors[level].compress(data), zlib.crc32(data)


def _packed(*items: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for item in items:
        item.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _summary(start: int, items: list[records.McapRecord]) -> bytes:
    """Return the summary section, where records of a kind stand together, and the footer."""
    data = bytearray()
    offsets = []
    for _, group in groupby(items, type):
        packed = _packed(*group)
        offsets.append(
            records.SummaryOffset(group_opcode=packed[0], group_start=start + len(data), group_length=len(packed))
        )
        data += packed
    offset_start = start + len(data)
    data += _packed(*offsets)
    data += RECORD.pack(Opcode.FOOTER, FOOTER.size) + FOOTER.pack(start, offset_start, 0)[:-4]
    return bytes(data) + struct.pack("<I", zlib.crc32(data)) + MAGIC
