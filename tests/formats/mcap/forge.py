"""Parts of MCAP files, and files of any parts, valid or not."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"


def read_records(path: Path) -> list[Any]:
    """Every record of a file, chunks as they are."""
    with path.open("rb") as file:
        return list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)


def data_records(path: Path) -> list[Any]:
    """The records before the summary."""
    found = read_records(path)
    return found[: next(n for n, record in enumerate(found) if isinstance(record, records.DataEnd))]


def chunk_records(chunk: records.Chunk) -> bytes:
    """What is in a chunk."""
    if chunk.compression == "zstd":
        return zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)
    assert chunk.compression == ""
    return chunk.data


def messages_in(chunk: records.Chunk) -> Iterator[tuple[int, int, int, int, bytes]]:
    """Yield channel, sequence, log time, publish time and data of each message of a chunk, which has no other records."""
    data, at = chunk_records(chunk), 0
    while at < len(data):
        opcode, length, channel, sequence, logged, published = struct.unpack_from("<BQHIQQ", data, at)
        assert opcode == Opcode.MESSAGE
        yield channel, sequence, logged, published, data[at + 31 : at + 9 + length]
        at += 9 + length


def chunk_places(data: bytes) -> list[tuple[int, int]]:
    """Return offset and size of each chunk of a file."""
    at, found = len(MAGIC), []
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == Opcode.CHUNK:
            found.append((at, 9 + length))
        at += 9 + length
    return found


def seal(content: bytes, packer: str = "zstd", **changes: Any) -> records.Chunk:
    """Return a chunk of some records; `changes` are false statements about it."""
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(packer, bytes)
    fields = {
        "compression": packer,
        "data": pack(content),
        "message_start_time": 0,
        "message_end_time": (1 << 63) - 1,
        "uncompressed_crc": zlib.crc32(content),
        "uncompressed_size": len(content),
    }
    return records.Chunk(**fields | changes)


def resealed(chunk: records.Chunk, packer: str, **changes: Any) -> records.Chunk:
    """A chunk with the same records and times in another compression."""
    times = {"message_start_time": chunk.message_start_time, "message_end_time": chunk.message_end_time}
    return seal(chunk_records(chunk), packer, **times | changes)


def packed(*items: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for item in items:
        item.write(builder)
    return bytes(builder.end())


@dataclass
class Forge:
    """A file in the making.

    Args:
        parts: Header, metadata, schemas, channels and chunks, in order; message indexes are left out.
        crc: Whether the summary has a checksum.
        described, indexes: What the summary says, once it is written.
    """

    parts: list[Any]
    crc: bool = True
    described: list[Any] = field(default_factory=list)
    indexes: list[records.ChunkIndex] = field(default_factory=list)

    def write(self, path: Path, *, summary: Iterable[Any] | None = None, **footer: int) -> Path:
        """Write it; `summary` stands in for the records of the summary."""
        data = bytearray(MAGIC)
        self.described, self.indexes = [], []
        for part in self.parts:
            if isinstance(part, records.MessageIndex):
                continue
            at = len(data)
            data += packed(part)
            if isinstance(part, records.Chunk):
                self.indexes.append(_index(part, at, len(data) - at))
            elif isinstance(part, records.Metadata):
                self.described.append(records.MetadataIndex(offset=at, length=len(data) - at, name=part.name))
            elif isinstance(part, (records.Schema, records.Channel)):
                self.described.append(part)
        data += packed(records.DataEnd(data_section_crc=0))
        start = len(data)
        data += packed(*(self.described + self.indexes if summary is None else summary))
        fields = {"summary_start": start, "summary_offset_start": 0, "summary_crc": 0} | footer
        tail = packed(records.Footer(**fields))
        if self.crc and "summary_crc" not in footer:
            tail = tail[:-4] + struct.pack("<I", zlib.crc32(bytes(data[start:]) + tail[:-4]))
        path.write_bytes(bytes(data) + tail + MAGIC)
        return path


def _index(chunk: records.Chunk, at: int, size: int) -> records.ChunkIndex:
    return records.ChunkIndex(
        chunk_start_offset=at,
        chunk_length=size,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        uncompressed_size=chunk.uncompressed_size,
    )


def rewrite(source: Path, destination: Path, **options: Any) -> Path:
    """A recording as another program would write it: one stream of chunks, messages in order of log time."""
    options = {"compression": CompressionType.ZSTD} | options
    with BytesIO(source.read_bytes()) as old, destination.open("wb") as new:
        reader, writer = make_reader(old, validate_crcs=True), Writer(new, **options)
        writer.start("", "another program")
        summary = reader.get_summary()
        assert summary
        ids = {}
        for channel in sorted(summary.channels.values(), key=lambda channel: channel.topic):
            schema = summary.schemas.get(channel.schema_id)
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id, channel.metadata)
        for _, channel, message in reader.iter_messages(log_time_order=True):
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        writer.finish()
    return destination


def with_header(path: Path, change: Callable[[dict[str, str]], dict[str, str]]) -> Path:
    """A recording whose header, which stands in it twice, has other metadata."""
    parts = data_records(path)
    for part in parts:
        if isinstance(part, records.Metadata) and part.name == "carla_recap.header":
            part.metadata = change(part.metadata)
    return Forge(parts).write(path)


def retold(path: Path, change: Callable[[str, int, int, bytes], tuple[int, int, bytes] | None]) -> Path:
    """A recording with other messages.

    Args:
        path: The recording.
        change: Is given the topic, sequence number, log time and data of a message; returns the latter three anew, or None.
    """
    parts = data_records(path)
    topics = {part.id: part.topic for part in parts if isinstance(part, records.Channel)}
    for place, part in enumerate(parts):
        if isinstance(part, records.Chunk):
            found = [(channel, change(topics[channel], *told, data)) for channel, *told, _, data in messages_in(part)]
            content = b"".join(message(channel, *told) for channel, told in found if told is not None)
            times = {"message_start_time": part.message_start_time, "message_end_time": part.message_end_time}
            parts[place] = seal(content, part.compression, **times)
    return Forge(parts).write(path)


def edited(path: Path, change: Callable[[str, int, bytes], bytes | None]) -> Path:
    """A recording whose messages have other data; None drops one."""

    def retell(topic: str, sequence: int, time: int, data: bytes) -> tuple[int, int, bytes] | None:
        body = change(topic, sequence, data)
        return None if body is None else (sequence, time, body)

    return retold(path, retell)


def message(channel: int, sequence: int, time: int, data: bytes) -> bytes:
    """A message record."""
    return struct.pack("<BQHIQQ", Opcode.MESSAGE, 22 + len(data), channel, sequence, time, time) + data
