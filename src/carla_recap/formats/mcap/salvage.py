"""Finds what is whole in an MCAP file that is damaged, or whose writer died: its chunks, each known good by its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from mcap import records
from mcap.opcode import Opcode

from carla_recap.errors import FormatError
from carla_recap.formats.mcap.container import (
    CHUNK,
    EXTENT_METADATA,
    HEADER_METADATA,
    MAGIC,
    MESSAGE,
    RECORD,
    SECOND,
    channel_specs,
    unchecked,
)
from carla_recap.formats.mcap.source import (
    CHUNK_LIMIT,
    Chunk,
    Source,
    Summary,
    open_chunk,
    parse_record,
    read_summary,
)
from carla_recap.frame import Header

DATA_END_SIZE: Final = 4
_MODEST: Final = 64 << 10
_SMALL: Final = 16 << 20  # no record but a chunk is larger
_ZSTD: Final = b"\x04\x00\x00\x00zstd"  # how the compression is named in a chunk
_ZSTD_AT: Final = RECORD.size + CHUNK.size - 4
_WINDOW: Final = 1 << 20


@dataclass
class Damage:
    """What was found broken.

    Attributes:
        chunks: Chunks that were dropped.
        bytes: Bytes that belong to nothing whole.
        finished: Whether the file has a valid end.
    """

    chunks: int = 0
    bytes: int = 0
    finished: bool = True


def salvage(source: Source) -> tuple[Summary, Damage]:
    """A summary of all that is whole in a file, whether or not it has one of its own."""
    summary, damage = Summary(), Damage()
    try:
        own = read_summary(source)
    except FormatError:
        own = Summary()
        damage.finished = False
    at = len(MAGIC) if source.read(0, min(len(MAGIC), source.size), "the magic") == MAGIC else 0
    while at < source.size and not summary.finished:
        end = _take(source, at, summary, damage)
        if end is None:
            end = _next_chunk(source, at + 1)
            damage.bytes += end - at
        at = end
    # What the file's own summary says is known good by its checksum; the scan may have missed some of it.
    summary.schemas |= own.schemas
    summary.channels |= own.channels
    met = {chunk.offset for chunk in summary.chunks}
    for offset in (chunk.offset for chunk in own.chunks if chunk.offset not in met):
        _take(source, offset, summary, Damage())
    for offset in (index.offset for name, index in own.metadata.items() if name not in summary.metadata):
        _take(source, offset, summary, Damage())
    _declare_lost(summary)
    summary.chunks.sort(key=lambda chunk: (chunk.start, chunk.offset))
    return summary, damage


def guess_header(summary: Summary) -> Header:
    """The header of a recording whose own is lost; its map is unknown."""
    wide = any(schema.name.endswith("Double") for schema in summary.schemas.values())
    return Header("", summary.chunks[0].start // SECOND if summary.chunks else 0, wide=wide)


def _declare_lost(summary: Summary) -> None:
    """Declare the channels whose declarations are lost; a channel's id says which it is."""
    specs = channel_specs(guess_header(summary).table)
    for id in {id for chunk in summary.chunks for id in chunk.channels} - summary.channels.keys():
        if 0 < id <= len(specs):
            spec = specs[id - 1]
            summary.schemas.setdefault(id, records.Schema(id=id, data=b"", encoding="protobuf", name=spec.message))
            summary.channels[id] = records.Channel(
                id=id, topic=spec.topic, message_encoding="protobuf", metadata={}, schema_id=id
            )


def _take(source: Source, at: int, summary: Summary, damage: Damage) -> int | None:
    """Add the record at a place to the summary; returns where it ends, None where there is no whole record."""
    if at + RECORD.size > source.size:
        return None
    opcode, length = RECORD.unpack(source.read(at, RECORD.size, "a record"))
    end: int = at + RECORD.size + length
    limit = CHUNK_LIMIT if opcode == Opcode.CHUNK else _SMALL
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END or length > limit or end > source.size:
        return None
    # Only chunks have a checksum: a great length of any other record is believed if another one follows.
    if opcode != Opcode.CHUNK and length > _MODEST and not _is_record(source, end):
        return None
    start = source.read(at + RECORD.size, min(length, CHUNK.size), "a record")
    plausible = opcode != Opcode.CHUNK or _looks_like_chunk(start, length)
    content = source.read(at + RECORD.size, length, "a record") if plausible else b""
    try:
        if opcode == Opcode.CHUNK:
            summary.chunks.append(_described(open_chunk(content)[2], at, end - at))
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(records.Schema, content)
            summary.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(records.Channel, content)
            summary.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            metadata = parse_record(records.Metadata, content)
            if metadata.name in (HEADER_METADATA, EXTENT_METADATA):
                unchecked(dict(metadata.metadata))
            summary.metadata[metadata.name] = records.MetadataIndex(offset=at, length=end - at, name=metadata.name)
        elif opcode == Opcode.DATA_END:
            summary.finished = length == DATA_END_SIZE
    except ValueError:
        damage.chunks += opcode == Opcode.CHUNK
        # The length may be what is broken: go on behind it only if a record stands there.
        if not _is_record(source, end):
            return None
        damage.bytes += end - at
    return end


def _looks_like_chunk(start: bytes, length: int) -> bool:
    """Whether a chunk's fixed fields make sense, before all of it is read."""
    if len(start) < CHUNK.size:
        return False
    *_, size, _, name_size = CHUNK.unpack(start)
    return bool(size <= CHUNK_LIMIT and name_size <= min(length, 16))


def _is_record(source: Source, at: int) -> bool:
    if at + RECORD.size > source.size:
        return at == source.size
    opcode, length = RECORD.unpack(source.read(at, RECORD.size, "a record"))
    return bool(Opcode.HEADER <= opcode <= Opcode.DATA_END and at + RECORD.size + length <= source.size)


def _described(data: bytes, offset: int, size: int) -> Chunk:
    """A chunk as its messages have it: what it says of its times is under no checksum."""
    channels, times, at = set(), [], 0
    while at + MESSAGE.size <= len(data):
        opcode, length, channel, _, log_time, _ = MESSAGE.unpack_from(data, at)
        if opcode == Opcode.MESSAGE:
            channels.add(channel)
            times.append(log_time)
        at += RECORD.size + length
    return Chunk(min(times, default=0), max(times, default=0), offset, size, frozenset(channels))


def _next_chunk(source: Source, at: int) -> int:
    """Where the next thing that looks like a chunk begins; the end of the file where there is none."""
    while at < source.size:
        window = source.read(at, min(_WINDOW, source.size - at), "a window")
        found = window.find(_ZSTD)
        while found >= 0:
            start = found - _ZSTD_AT
            if start >= 0 and window[start] == Opcode.CHUNK:
                return at + start
            found = window.find(_ZSTD, found + 1)
        if at + len(window) == source.size:
            break
        at += len(window) - _ZSTD_AT - len(_ZSTD)
    return source.size
