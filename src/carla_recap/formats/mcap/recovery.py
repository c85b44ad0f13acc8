"""Finds what is whole in an MCAP file that is damaged, or whose writer died: its chunks, each known good by its checksum."""

from __future__ import annotations

import warnings
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mcap.opcode import Opcode

from carla_recap.errors import FormatError, RecapWarning
from carla_recap.formats.mcap import index, schema
from carla_recap.model.frame import Header

if TYPE_CHECKING:
    from carla_recap.formats.sources import ByteSource

DATA_END_SIZE: Final = 4
_MODEST: Final = 64 << 10
_SMALL: Final = 16 << 20  # no record but a chunk is larger
_DECLARED: Final = 16 << 20  # bytes of declarations in chunks, which stay in memory
_FALSE_FACTOR: Final = 4  # times the size of the file: bytes read for what turns out to be no chunk
_FALSE_LEAST: Final = 16 << 20
_UNPACKED_FACTOR: Final = 1000  # times the size of the file: bytes of records that are unpacked
_UNPACKED_LEAST: Final = 512 << 20
_MESSAGES_LEAST: Final = 1_000_000
_MESSAGE_BYTES: Final = 4  # bytes of the file for each message beyond those
_ZSTD_FRAME: Final = b"\x28\xb5\x2f\xfd"  # what compressed data begin with
_ZSTD: Final = b"\x04\x00\x00\x00zstd"  # how the compression is named in a chunk
_ZSTD_AT: Final = schema.RECORD.size + schema.CHUNK.size - 4
_WINDOW: Final = 1 << 20


@dataclass
class Damage:
    """What was found broken."""

    chunks: int = 0  # chunks that were dropped
    bytes: int = 0  # bytes that belong to nothing whole
    finished: bool = True  # whether the file has a valid end


def recover_summary(source: ByteSource) -> tuple[index.Summary, Damage]:
    """Return a summary of all that is whole in a file, whether or not it has one of its own, and what is damaged."""
    scan = _Scan(source)
    summary, damage = scan.summary, scan.damage
    try:
        own = index.read_summary(source)
    except FormatError:
        own = index.Summary()
        damage.finished = False
    at = len(schema.MAGIC) if source.read(0, min(len(schema.MAGIC), source.size), "the magic") == schema.MAGIC else 0
    while at < source.size and not summary.finished:
        end = scan.take(at)
        if end is None:
            end = scan.next_chunk(at + 1)
            damage.bytes += end - at
        at = end
    # What stands in chunks, and what the file's own summary says, is known good by a checksum; the summary counts first.
    for known in (scan.in_chunks, own):
        summary.schemas |= known.schemas
        summary.channels = known.channels | {id: each for id, each in summary.channels.items() if id not in known.channels}
        summary.schema_spans |= known.schema_spans
        summary.channel_spans |= known.channel_spans
    met = {chunk.offset for chunk in summary.chunks}
    scan.damage = Damage()
    for offset in (chunk.offset for chunk in own.chunks if chunk.offset not in met):
        scan.take(offset)
    for offset in (offset for name, offset in own.metadata.items() if name not in summary.metadata):
        scan.take(offset)
    if scan.undeclared:
        text = f"{scan.undeclared} schemas and channels are left out, as they are too many or too large"
        warnings.warn(f"{source.location}: {text}", RecapWarning, stacklevel=2)
    _declare_lost(summary)
    unknown = {id for chunk in summary.chunks for id in chunk.channels} - summary.channels.keys()
    if unknown:
        text = f"messages of {len(unknown)} channels are left out, as their declarations are lost"
        warnings.warn(f"{source.location}: {text}", RecapWarning, stacklevel=2)
    summary.chunks.sort(key=lambda chunk: (chunk.start, chunk.offset))
    return summary, damage


def guess_header(summary: index.Summary) -> Header:
    """Return the header of a recording whose own is lost; its map is unknown."""
    wide = any(name.endswith("Double") for name in summary.schemas.values())
    return Header("", summary.chunks[0].start // schema.SECOND if summary.chunks else 0, wide=wide)


def _declare_lost(summary: index.Summary) -> None:
    """Declare the channels whose declarations, or those of their schemas, are lost; a channel's id says which it is."""
    used = {id for chunk in summary.chunks for id in chunk.channels}
    for id, spec in enumerate(schema.channel_specs(guess_header(summary).table), 1):
        lost = index.ChannelRecord(id, id, spec.topic, "protobuf")
        if id in used and summary.channels.get(id, lost) == lost:
            summary.schemas[id], summary.channels[id] = spec.message, lost


class _Scan:
    """Goes through a file, and takes what is whole. What it costs is in proportion to the size of the file."""

    def __init__(self, source: ByteSource) -> None:
        self.summary = index.Summary()  # what was found
        # The schemas and channels that are declared inside of chunks, as other programs write them.
        self.in_chunks = index.Summary()
        self.damage = Damage()  # what was found broken
        self._source = source
        self._window = (0, b"")  # an offset, and the bytes from there on
        self._false = _FALSE_LEAST + _FALSE_FACTOR * source.size
        self._unpacked = _UNPACKED_LEAST + _UNPACKED_FACTOR * source.size
        self._messages = _MESSAGES_LEAST + source.size // _MESSAGE_BYTES
        self._parsed = index.RECORDS_LIMIT
        self.undeclared = 0  # declarations beyond what is kept in memory, repeated ones included
        self._declared = _DECLARED
        self._declarations: set[tuple[int, bytes]] = set()

    def take(self, at: int) -> int | None:
        """Add the record at an offset to the summary; return its end, None where no whole record is found."""
        source, damage = self._source, self.damage
        if at + schema.RECORD.size > source.size:
            return None
        opcode, length = schema.RECORD.unpack(source.read(at, schema.RECORD.size, "a record"))
        end: int = at + schema.RECORD.size + length
        is_chunk = opcode == Opcode.CHUNK
        if (
            not Opcode.HEADER <= opcode <= Opcode.DATA_END
            or length > (index.CHUNK_LIMIT if is_chunk else _SMALL)
            or end > source.size
        ):
            return None
        # Only chunks have a checksum: a great length of any other record is believed if another one follows.
        if not is_chunk and length > _MODEST and not self._is_record(end):
            return None
        false = self._false
        try:
            if is_chunk:
                self._take_chunk(at, length)
            elif opcode == Opcode.DATA_END:
                self.summary.finished = length == DATA_END_SIZE
            else:
                self._take_other(opcode, at, length)
        except ValueError:
            damage.chunks += is_chunk
            # The length may be what is broken: go on behind it only if a record follows. Or if too much was read for
            # nothing: what is inside is lost then.
            spent = self._false < min(false, 0)
            if not spent and not self._is_record(end):
                return None
            damage.bytes += end - at
        return end

    def next_chunk(self, at: int) -> int:
        """Return the offset of what looks like the next chunk; the end of the file where nothing does."""
        size = self._source.size
        while at < size:
            begin, window = self._window
            if not begin <= at < begin + len(window) - _ZSTD_AT - len(_ZSTD):
                begin, window = self._window = at, self._source.read(at, min(_WINDOW, size - at), "a window")
            found = window.find(_ZSTD, at - begin + _ZSTD_AT)
            while found >= 0:
                start = found - _ZSTD_AT
                if window[start] == Opcode.CHUNK:
                    return begin + start
                found = window.find(_ZSTD, found + 1)
            if begin + len(window) == size:
                break
            at = begin + len(window) - _ZSTD_AT - len(_ZSTD)
        return size

    def _take_chunk(self, at: int, length: int) -> None:
        source, size = self._source, schema.RECORD.size + length
        unpacked = _announced(source.read(at + schema.RECORD.size, min(length, _CHUNK_HEAD), "a record"), length)
        self._false -= length
        self._unpacked -= unpacked
        if self._unpacked < 0:
            raise ValueError("more bytes of records than a file of this size can mean")
        data = index.open_chunk(source.read(at + schema.RECORD.size, length, "a record"))[2]
        chunk, messages, declarations = _described(data, at, size, self._messages)
        self._messages -= messages.total()
        for opcode, content in declarations:
            if (opcode, content) in self._declarations:
                continue
            if len(content) > self._declared or not self._parsed:
                self.undeclared += 1
                continue
            self._parsed -= 1
            self._declared -= len(content)
            self._declarations.add((opcode, content))
            with suppress(ValueError):  # a broken one costs no messages
                self.in_chunks.add(opcode, memoryview(content))
        self.summary.counts += messages
        self._false += length
        self.summary.chunks.append(chunk)

    def _take_other(self, opcode: int, at: int, length: int) -> None:
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            return
        if not self._parsed:
            self.undeclared += opcode != Opcode.METADATA
            return
        if opcode == Opcode.METADATA and length > index.METADATA_LIMIT:
            return
        self._parsed -= 1
        content = self._source.read(at + schema.RECORD.size, length, "a record")
        if opcode != Opcode.METADATA:
            self.summary.add(opcode, memoryview(content), at + schema.RECORD.size)
            return
        name, values = index.parse_metadata(content)
        if name in (schema.HEADER_METADATA, schema.EXTENT_METADATA, schema.PARAMETERS_METADATA):
            schema.unchecked(values)
        self.summary.metadata[name] = at

    def _is_record(self, at: int) -> bool:
        if at + schema.RECORD.size > self._source.size:
            return at == self._source.size
        opcode, length = schema.RECORD.unpack(self._source.read(at, schema.RECORD.size, "a record"))
        return bool(Opcode.HEADER <= opcode <= Opcode.DATA_END and at + schema.RECORD.size + length <= self._source.size)


_CHUNK_HEAD: Final = schema.CHUNK.size + 16 + schema.U64.size + len(_ZSTD_FRAME)
"""The most bytes of a chunk that stand before its records, and the first of those."""


def _announced(start: bytes, length: int) -> int:
    """Return how many bytes of records a chunk of some length announces at its start, before all of it is read."""
    if len(start) < schema.CHUNK.size:
        raise ValueError("a chunk of less than its fixed fields")
    *_, size, _, name_size = schema.CHUNK.unpack_from(start)
    at = schema.CHUNK.size + name_size
    if size > index.CHUNK_LIMIT or name_size > 16 or at + schema.U64.size > length:
        raise ValueError("fixed fields that make no sense")
    (stored,) = schema.U64.unpack_from(start, at)
    if stored != length - at - schema.U64.size:
        raise ValueError("records of another length than the chunk's")
    if stored and start[schema.CHUNK.size : at] == b"zstd" and not start[at + schema.U64.size :].startswith(_ZSTD_FRAME):
        raise ValueError("no compressed data")
    return int(size)


def _described(
    data: bytes, offset: int, size: int, most: int
) -> tuple[index.ChunkIndex, Counter[int], list[tuple[int, bytes]]]:
    """Return a chunk as its messages have it, since its times are under no checksum, and how many each channel has.

    Also return the opcodes and contents of the schemas and channels that are declared in it.
    """
    channels, times, declarations = list[int](), list[int](), list[tuple[int, bytes]]()
    for opcode, start, end in index.split_records(data):
        if not opcode or (opcode == Opcode.MESSAGE and end - start < schema.MESSAGE_FIELDS):
            raise ValueError(f"no record at byte {start} of a chunk's content")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            declarations.append((opcode, data[start:end]))
        elif opcode == Opcode.MESSAGE:
            _, _, channel, _, time, _ = schema.MESSAGE.unpack_from(data, start - schema.RECORD.size)
            channels.append(channel)
            times.append(time)
            if len(times) > most:
                raise ValueError("more messages than a file of this size can mean")
    counts = Counter(channels)
    chunk = index.ChunkIndex(min(times, default=0), max(times, default=0), offset, size, frozenset(counts))
    return chunk, counts, declarations
