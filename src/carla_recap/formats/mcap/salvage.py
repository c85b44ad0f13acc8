"""Finds what is whole in an MCAP file that is damaged, or whose writer died: its chunks, each known good by its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from mcap import records
from mcap.opcode import Opcode

from carla_recap.errors import FormatError
from carla_recap.formats.mcap.container import (
    CHUNK,
    MAGIC,
    MESSAGE,
    RECORD,
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
    while at < source.size:
        end = _take(source, at, summary, damage)
        if end is None:
            end = _next_chunk(source, at + 1)
            damage.bytes += end - at
        at = end
        if summary.finished:
            break
    # Those of the file's own summary are known good by its checksum.
    summary.schemas |= own.schemas
    summary.channels |= own.channels
    for name, index in own.metadata.items():
        summary.metadata.setdefault(name, index)
    summary.chunks.sort(key=lambda chunk: (chunk.start, chunk.offset))
    return summary, damage


def _take(source: Source, at: int, summary: Summary, damage: Damage) -> int | None:
    """Add the record at a place to the summary; returns where it ends, None where there is no whole record."""
    if at + RECORD.size > source.size:
        return None
    opcode, length = RECORD.unpack(source.read(at, RECORD.size, "a record"))
    end: int = at + RECORD.size + length
    limit = CHUNK_LIMIT if opcode == Opcode.CHUNK else _SMALL
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END or length > limit or end > source.size:
        return None
    content = source.read(at + RECORD.size, length, "a record")
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
            summary.metadata[metadata.name] = records.MetadataIndex(offset=at, length=end - at, name=metadata.name)
        elif opcode == Opcode.DATA_END:
            summary.finished = True
    except ValueError:
        if opcode == Opcode.CHUNK:
            damage.chunks += 1
            damage.bytes += end - at
            # The length may be what is broken: go on behind it only if a record stands there.
            return end if _is_record(source, end) else None
        return None
    return end


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
