"""Reads an MCAP file within bounds: parts of it, chunks, and its summary, which has the index of the chunks.

No chunk takes more memory than `CHUNK_LIMIT`, whatever it claims; every checksum is checked. The `mcap` package's own
classes are left to the writer: their import takes 8 ms, for which every query would wait, and they believe all sizes.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import zstandard
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, NotARecording
from carla_recap.formats.mcap.schema import CHUNK, CHUNK_INDEX, CHUNK_OFFSETS, FOOTER, MAGIC, RECORD, U64

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.formats.sources import ByteRange, ByteSource

CHUNK_LIMIT: Final = 64 << 20
"""The largest chunk that is read, in bytes, compressed or not; ours are about 1 MiB."""
SUMMARY_LIMIT: Final = 256 << 20
"""The largest summary that is read, in bytes."""
METADATA_LIMIT: Final = 512 << 10
"""The largest metadata that are read, in bytes; those of a header with the longest of names are smaller."""
RECORDS_LIMIT: Final = 1 << 17
"""The most records, beside chunk indexes, that a summary is made of: as many schemas and channels as there are ids."""
CHANNELS_LIMIT: Final = 0xFFFF
"""The most channels of a file: their ids have 16 bits, and are not 0."""

_U16: Final = struct.Struct("<H")
_U32: Final = struct.Struct("<I")
_CHANNEL: Final = struct.Struct("<HH")  # id, schema
_CHANNEL_COUNT: Final = struct.Struct("<HQ")  # channel, number of its messages
_METADATA_INDEX: Final = struct.Struct("<QQ")  # offset, length
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
"""Numbers of messages, schemas, channels, attachments, metadata and chunks, first and last time."""


def read_record(source: ByteSource, offset: int, opcode: Opcode, what: str, limit: int = CHUNK_LIMIT) -> bytes:
    """Return the content of the record at an offset, or raise `FormatError`."""
    found, size = RECORD.unpack(source.read(offset, RECORD.size, what))
    if found != opcode or size > limit:
        raise FormatError(source.location, offset, f"expected {what}, found a record of kind {found} with {size} bytes")
    return source.read(offset + RECORD.size, size, what)


def split_records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record in a run of whole records, or raise `ValueError`."""
    at, size = 0, len(data)
    while at < size:
        if at + RECORD.size > size:
            raise ValueError(f"{size - at} bytes are left behind the last record")
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size:
            raise ValueError(f"a record of {length} bytes goes beyond the {size} that there are")
        yield opcode, start, at


class ChannelRecord(NamedTuple):
    """The declaration of a channel: its id, its schema's id, its topic, and the encoding of its messages."""

    id: int
    schema: int
    topic: str
    encoding: str


def _strings(data: memoryview, offset: int) -> dict[str, str]:
    """Return a map of strings."""
    (size,) = _U32.unpack_from(data, offset)
    offset += _U32.size
    values, end = {}, offset + size
    while offset < end:
        key, offset = _string(data, offset)
        values[key], offset = _string(data, offset)
    return values


def _string(data: memoryview, offset: int) -> tuple[str, int]:
    """Return a string with its length in front, and the offset behind it."""
    (size,) = _U32.unpack_from(data, offset)
    end = offset + _U32.size + size
    if end > len(data):
        raise ValueError("a text goes beyond the end")
    return str(data[offset + _U32.size : end], "utf-8"), end


@contextmanager
def _breaking(opcode: int) -> Iterator[None]:
    """Raise a `ValueError` that names the kind of a record where it cannot be read."""
    try:
        yield
    except (struct.error, ValueError) as error:
        raise ValueError(f"broken {Opcode(opcode).name} record ({error})") from None


def parse_metadata(content: bytes) -> tuple[str, dict[str, str]]:
    """Return the name and the values of a metadata record, or raise `ValueError`."""
    with _breaking(Opcode.METADATA):
        name, offset = _string(memoryview(content), 0)
        return name, _strings(memoryview(content), offset)


def parse_channel_metadata(content: bytes) -> dict[str, str]:
    """Return the metadata of a channel record; see `parse_metadata`."""
    with _breaking(Opcode.CHANNEL):
        data = memoryview(content)
        _, offset = _string(data, _CHANNEL.size)
        return _strings(data, _string(data, offset)[1])


def parse_schema(content: bytes) -> tuple[str, bytes]:
    """Return the encoding and the data of a schema record; see `parse_metadata`."""
    with _breaking(Opcode.SCHEMA):
        data = memoryview(content)
        _, offset = _string(data, _U16.size)
        encoding, offset = _string(data, offset)
        (size,) = _U32.unpack_from(data, offset)
        offset += _U32.size
        if offset + size > len(data):
            raise ValueError("its data go beyond the end")
        return encoding, bytes(data[offset : offset + size])


def decompress(compression: str, data: bytes | memoryview, size: int) -> bytes:
    """Return a chunk's records, never more than the chunk says; raise `ValueError` if they are damaged."""
    if size > CHUNK_LIMIT:
        raise ValueError(f"a chunk of {size} bytes, at most {CHUNK_LIMIT} are read")
    try:
        if compression == "":
            records = bytes(data)
        elif compression == "zstd":
            if zstandard.frame_content_size(data) not in (-1, size):
                raise ValueError("the compressed data announce another size than the chunk")
            records = zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
        elif compression == "lz4":
            import lz4.frame

            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
        else:
            raise ValueError(f"unknown compression {compression!r:.40}")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise ValueError(f"damaged data ({error})") from None
    if len(records) != size:
        raise ValueError(f"expected {size} bytes after decompression, found {len(records)}")
    return records


def open_chunk(content: bytes | memoryview) -> tuple[int, int, bytes]:
    """Return first and last log time, and the records, of a chunk record's content, or raise `ValueError`."""
    if len(content) < CHUNK.size:
        raise ValueError("a chunk of less than its fixed fields")
    start, end, size, crc, name_size = CHUNK.unpack_from(content)
    at = CHUNK.size + name_size
    if at + U64.size > len(content) or name_size > 16:
        raise ValueError("a chunk with a broken compression name")
    compression = str(content[CHUNK.size : at], "ascii", "replace")
    (stored,) = U64.unpack_from(content, at)
    data = memoryview(content)[at + U64.size :]
    if stored != len(data):
        raise ValueError(f"{len(data)} bytes of records, the chunk says {stored}")
    records = decompress(compression, data, size)
    if crc and zlib.crc32(records) != crc:
        raise ValueError("the checksum does not match")
    return start, end, records


class ChunkIndex(NamedTuple):
    """A chunk as the index describes it. Times in ns; `channels` are those of its messages, empty where unknown."""

    start: int
    end: int
    offset: int
    length: int
    channels: frozenset[int]


class Summary:
    """The content of an MCAP file, as its summary describes it."""

    def __init__(self) -> None:
        self.schemas: dict[int, str] = {}  # the names of the schemas, by id
        self.channels: dict[int, ChannelRecord] = {}  # the channels, by id
        self.chunks: list[ChunkIndex] = []  # the chunks, in order of time
        self.metadata: dict[str, int] = {}  # the offsets of metadata records, by name
        # Where the content of each schema's record is in the file: offset and size; or itself, if in a chunk.
        self.schema_spans: dict[int, ByteRange | bytes] = {}
        self.channel_spans: dict[int, ByteRange | bytes] = {}  # the same of each channel
        self.messages: int | None = None  # the number of messages; None if unknown
        self.counts: Counter[int] = Counter()  # the number of messages of each channel, as far as it is known
        self.chunk_count: int | None = None  # the number of chunks; None if unknown
        self.finished = False  # whether the data section ends properly

    def add(self, opcode: int, data: memoryview, offset: int | None = None) -> None:
        """Add what a record, whose content is at an offset in the file or in a chunk, says, if it is of such a kind."""
        if opcode == Opcode.CHUNK_INDEX:
            self.chunks.append(_chunk_index(data))
            return
        with _breaking(opcode):
            if opcode == Opcode.SCHEMA:
                (id,) = _U16.unpack_from(data)
                self.schemas[id], _ = _string(data, _U16.size)
                self.schema_spans[id] = bytes(data) if offset is None else (offset, len(data))
            elif opcode == Opcode.CHANNEL:
                id, schema = _CHANNEL.unpack_from(data)
                topic, end = _string(data, _CHANNEL.size)
                self.channels[id] = ChannelRecord(id, schema, topic, _string(data, end)[0])
                self.channel_spans[id] = bytes(data) if offset is None else (offset, len(data))
            elif opcode == Opcode.METADATA_INDEX:
                at, _ = _METADATA_INDEX.unpack_from(data)
                self.metadata[_string(data, _METADATA_INDEX.size)[0]] = at
            elif opcode == Opcode.STATISTICS:
                self.messages, *_, self.chunk_count, _, _ = _STATISTICS.unpack_from(data)
                self.counts = _channel_counts(data[_STATISTICS.size :])


def read_summary(source: ByteSource) -> Summary:
    """Return the summary of a finished file, or raise `NotARecording`, or `FormatError` if it is damaged or not finished."""
    path, size = source.location, source.size
    is_short = size < len(MAGIC)
    # The start of a remote file is a request of its own; the end has the magic, too.
    if is_short or (not source.is_remote and source.read(0, len(MAGIC), "the magic") != MAGIC):
        raise NotARecording(path, "is no MCAP file (the magic is missing)")
    unfinished = "the file has no valid end: it is damaged, or its writer died; 'carla-recap recover' saves what it holds"
    tail = RECORD.size + FOOTER.size + len(MAGIC)
    if size < tail + len(MAGIC):
        raise FormatError(path, size, unfinished)
    end = source.read(size - tail, tail, "the footer")
    opcode, length = RECORD.unpack_from(end)
    if not end.endswith(MAGIC) or opcode != Opcode.FOOTER or length != FOOTER.size:
        raise FormatError(path, size - tail, unfinished)
    start, _, crc = FOOTER.unpack_from(end, RECORD.size)
    if start == 0:
        raise FormatError(path, size - tail, "the file has no summary; 'carla-recap recover' makes one")
    length = size - tail - start
    if not len(MAGIC) <= start <= size - tail or length > SUMMARY_LIMIT:
        raise FormatError(path, size - tail, f"the summary is said to begin at byte {start}, which cannot be")
    data = source.read(start, length, "the summary")
    if crc and zlib.crc32(end[: RECORD.size + 16], zlib.crc32(data)) != crc:
        raise FormatError(
            path,
            start,
            "the summary is damaged (its checksum does not match); 'carla-recap recover' makes a new one",
        )
    summary = Summary()
    others = 0
    try:
        for opcode, at, until in split_records(data):
            others += opcode != Opcode.CHUNK_INDEX
            if others > RECORDS_LIMIT:
                raise ValueError(f"more than {RECORDS_LIMIT} records beside chunk indexes")
            summary.add(opcode, memoryview(data)[at:until], start + at)
    except ValueError as error:
        raise FormatError(path, start, f"the summary is damaged: {error}; 'carla-recap recover' makes a new one") from None
    summary.chunks.sort(key=lambda chunk: (chunk.start, chunk.offset))
    offsets = {chunk.offset for chunk in summary.chunks}
    if len(offsets) < len(summary.chunks):
        raise FormatError(path, start, "the summary names a chunk twice")
    placed = sorted((chunk.offset, chunk.offset + chunk.length) for chunk in summary.chunks)
    if any(end > after for (_, end), (after, _) in pairwise(placed)):
        raise FormatError(path, start, "the summary names chunks that lie in one another")
    if summary.chunk_count not in (None, len(offsets)):
        raise FormatError(
            path,
            start,
            f"the summary names {len(offsets)} of {summary.chunk_count} chunks; 'carla-recap recover' makes a new one",
        )
    if summary.messages and not offsets:
        raise FormatError(path, start, f"{summary.messages} messages lie outside chunks, where none are read")
    return summary


def _channel_counts(data: memoryview) -> Counter[int]:
    """Return the number of messages of each channel, as statistics have them after their fixed fields."""
    (size,) = _U32.unpack_from(data)
    counts = data[_U32.size : _U32.size + size]
    if len(counts) != size or size > CHANNELS_LIMIT * _CHANNEL_COUNT.size:
        raise ValueError("counts of channels that do not fit")
    return Counter(dict(_CHANNEL_COUNT.iter_unpack(counts)))


def _chunk_index(data: memoryview) -> ChunkIndex:
    if len(data) < CHUNK_INDEX.size:
        raise ValueError("a chunk index of less than its fixed fields")
    start, end, offset, length, size = CHUNK_INDEX.unpack_from(data)
    offsets = data[CHUNK_INDEX.size : CHUNK_INDEX.size + size]
    if len(offsets) != size or size % CHUNK_OFFSETS.size or length > CHUNK_LIMIT:
        raise ValueError("a chunk index that does not fit")
    return ChunkIndex(start, end, offset, length, frozenset(channel for channel, _ in CHUNK_OFFSETS.iter_unpack(offsets)))
