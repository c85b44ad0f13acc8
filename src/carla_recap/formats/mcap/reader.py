"""Reads recordings from MCAP by the index: a query reads the chunks of its channels, and nothing else.

Every chunk's checksum is checked, and no chunk is larger in memory than `CHUNK_LIMIT`.
"""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import replace
from functools import cached_property, partial
from os import PathLike
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, NotARecording, RecapWarning
from carla_recap.formats.base import DigestPart, Reader
from carla_recap.formats.mcap import schema
from carla_recap.formats.mcap.codec import WireError, decode_records
from carla_recap.formats.mcap.frames import MESSAGES_LIMIT, Channels, FrameAssembler, ReadSelection, channel_messages, parsed
from carla_recap.formats.mcap.index import METADATA_LIMIT, open_chunk, parse_metadata, read_record, read_summary
from carla_recap.formats.sources import LocalSource
from carla_recap.model.frame import SAME_TIME, Extent, Frame, Header

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from carla_recap.formats.base import FurtherTopic, PartName, TopicMessage
    from carla_recap.formats.mcap.index import ChunkIndex, Summary
    from carla_recap.formats.mcap.topics import FurtherTopics
    from carla_recap.formats.sources import ByteSource
    from carla_recap.model.batch import Batch
    from carla_recap.model.records import RecordType

T = TypeVar("T")

_ROWS: Final = 100_000  # of a part of the digest; a larger file may have more, as far as its bytes can mean them
_LIMITS: Final = {schema.STATIONARY: 2, schema.BRAKING: 1, schema.CONTACTS: 0}  # numbers before that of the rows
_RULES: Final = {schema.STATIONARY: schema.STATIONARY_RULE, schema.BRAKING: schema.BRAKING_RULE}


class McapReader(Reader):
    """Reads a recording from MCAP: from a path, or from a source, which `close` closes.

    Summary and header are given where they are known better than by the file itself. If it is `lenient`, frames that
    contradict their schema are left out. A `NotARecording` is no MCAP file, or none with a recording; a `FormatError` says
    that it is damaged, or was never finished.
    """

    def __init__(
        self,
        file: Path | str | ByteSource,
        *,
        summary: Summary | None = None,
        header: Header | None = None,
        lenient: bool = False,
    ) -> None:
        self._source: ByteSource = LocalSource(file) if isinstance(file, str | PathLike) else file
        self.path, self.location = self._source.path, self._source.location
        self._lenient = lenient
        try:
            self._summary = summary or read_summary(self._source)
            self.header = header or self._read_header()
            self._extent = self._read_extent()
            told = self.metadata
            self._steady = told.get("steady_clock") == "1"
            if told.get(schema.WITHOUT_EVENTS) == "1":
                self.header = replace(self.header, without_events=True)
                text = "was recovered without all of its events: spawns, collisions and others may be missing"
                warnings.warn(f"{self.location}: {text}", RecapWarning, stacklevel=2)
        except BaseException:
            self._source.close()
            raise
        self._channels = Channels(_match(self._summary, schema.channel_specs(self.header.table)), self.header.table)
        packets = self._channels.wanted(None, frames=True)
        if packets and not lenient and self._channels.frames not in packets:
            self._source.close()
            raise FormatError(
                self.location, None, "the channel of its frames is missing; 'carla-recap recover' saves what it can"
            )

    @property
    def is_empty(self) -> bool:
        """Whether the file has no chunks."""
        return not self._summary.chunks

    @property
    def bytes_read(self) -> int:
        """How much of the file was read so far."""
        return self._source.bytes_read

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of the recording as a whole, beyond the header; empty where it does not."""
        return self._read_metadata(schema.EXTENT_METADATA) or {}

    def _batches(self, types: Collection[str] | None, start: float, stop: float, *, sparse: bool) -> Iterator[Batch]:
        # If the clock goes back, the first frame of the part, or at its stop, may hold no wanted packet.
        sparse = sparse and (self._steady or (start == -math.inf and stop == math.inf))
        wanted = self._channels.wanted(types, frames=not sparse)
        selection = ReadSelection(wanted, types is None, sparse, start, stop)
        return self._assemble(self._chunks(wanted, start, stop), selection)

    def frame_at(self, elapsed: float) -> Frame | None:
        """Return the frame at a time; see `Reader.frame_at`."""
        elapsed += SAME_TIME
        found = None
        wanted = self._channels.wanted((), frames=True)
        time = schema.LogClock(self.header).at(elapsed)
        chunks = self._chunks(wanted)
        if time is not None and self._steady:
            apart = all(a.end < b.start for a, b in itertools.pairwise(chunks))
            chunks = [chunk for chunk in chunks if chunk.start <= time]
            if apart:
                # Of a chunk that begins at that very nanosecond, the frame may still come later.
                chunks = chunks[max(sum(chunk.start < time for chunk in chunks) - 1, 0) :]
        for batch in self._assemble(chunks, ReadSelection(wanted)):
            later = np.flatnonzero(batch.elapsed > elapsed)
            count = int(later[0]) if len(later) else len(batch)
            if count:
                found = batch.frame(count - 1)
            if count < len(batch):
                break
        if found is None or math.isnan(elapsed):
            return None
        for frame in self.frames(start=-math.inf if math.isnan(found.elapsed) else found.elapsed):
            if frame.index == found.index:
                return frame
        raise FormatError(self.location, None, f"frame {found.id} is in no chunk of its time: the index is wrong")

    def extent(self) -> Extent:
        """Return how far the recording goes."""
        if self._extent is None:
            extent = Extent()
            for frame in self.frames(()):
                if not frame.preamble:
                    extent = Extent(extent.frames + 1, frame.id, frame.elapsed)
            self._extent = extent
        return self._extent

    def tail(self) -> Iterator[bytes]:
        """Yield the bytes behind the last complete packet, in pieces."""
        messages = self._messages(schema.TAIL_TOPIC)
        return (bytes(parsed(self.location, "tail", schema.TAIL_MESSAGE, message).data) for message in messages)

    def digest(self, part: PartName) -> DigestPart | None:
        """Return a part of the digest, read from the events; see `Reader.digest`."""
        type = next(each for each in schema.DIGEST if each.name == part)
        try:
            numbers = tuple(float(number) for number in self.metadata[part].split())
        except (KeyError, ValueError):
            return None
        limits, rule = _LIMITS[type], [_RULES[type]] if type in _RULES else []
        if len(numbers) <= limits or [*numbers[limits + 1 :]] != rule or numbers[limits] > _ROWS + self._source.size // 4:
            return None
        return DigestPart(numbers[:limits], partial(self._listed, type, numbers[limits]))

    def further_topics(self) -> dict[str, FurtherTopic]:
        """Return the topics beside those of a recording; see `Reader.further_topics`."""
        self._source.check_open()
        return self._further.topics

    def further_messages(
        self,
        topics: Collection[str] | None = None,
        start: float = -math.inf,
        stop: float = math.inf,
        *,
        in_order: bool = True,
    ) -> Iterator[TopicMessage]:
        """Yield the messages of further topics; see `Reader.further_messages`."""
        self._source.check_open()
        return self._further.messages(topics, start, stop, in_order=in_order)

    def latest_messages(self, topics: Collection[str], elapsed: float) -> list[TopicMessage]:
        """Return the latest message of each of some further topics; see `Reader.latest_messages`."""
        self._source.check_open()
        return self._further.latest(topics, elapsed)

    @cached_property
    def _further(self) -> FurtherTopics:
        from carla_recap.formats.mcap.topics import FurtherTopics

        own, matched = {spec.topic for spec in schema.channel_specs(self.header.table)}, self._channels.specs
        return FurtherTopics(self._source, self._summary, own, matched, schema.LogClock(self.header), self._opened)

    def _listed(self, type: RecordType, count: float) -> list[Any] | None:
        """Return the rows of a part of the digest; None if some are missing, or have no checksum, as of another program."""
        rows = list[Any]()
        try:
            for message in self._messages(type.topic, checked=True):
                rows += decode_records(type, bytes(message))
                if len(rows) > count:
                    break
        except WireError as error:
            raise FormatError(self.location, None, str(error)) from None
        return rows if len(rows) == count else None

    def _messages(self, topic: str, *, checked: bool = False) -> Iterator[memoryview]:
        """Yield the messages of a topic that belong to no frame; `checked`: those with a checksum alone."""
        self._source.check_open()
        channel = self._channels.of(topic)
        chunks = self._chunks({channel}) if channel in self._channels.specs else []
        spans = [(chunk.offset, chunk.length) for chunk in chunks]
        for chunk, data in zip(chunks, self._source.read_ranges(spans, "a chunk"), strict=True):
            records = self._open(chunk, data)
            if checked and not schema.CHUNK.unpack_from(data, schema.RECORD.size)[3]:
                continue
            yield from channel_messages(self.location, chunk, records, channel)

    # --- what the file says of itself ----------------------------------------------------------------------------------

    def _read_metadata(self, name: str) -> dict[str, str] | None:
        offset = self._summary.metadata.get(name)
        if offset is None:
            return None
        content = read_record(self._source, offset, Opcode.METADATA, f"the metadata {name}", METADATA_LIMIT)
        try:
            return schema.unchecked(parse_metadata(content)[1])
        except ValueError as error:
            raise FormatError(self.location, offset, f"broken MCAP metadata {name!r}: {error}") from None

    def _read_header(self) -> Header:
        metadata = self._read_metadata(schema.HEADER_METADATA)
        if metadata is None and schema.EXPORT_METADATA in self._summary.metadata:
            raise NotARecording(self.location, "expected a recording, found an export for a viewer that was made from one")
        if metadata is None:
            raise NotARecording(self.location, f"holds no recording (MCAP metadata {schema.HEADER_METADATA!r} is missing)")
        try:
            header = schema.parse_header(metadata)
        except (KeyError, ValueError) as error:
            raise FormatError(self.location, None, f"broken MCAP metadata {schema.HEADER_METADATA!r}: {error}") from None
        return replace(header, parameters=self._read_metadata(schema.PARAMETERS_METADATA) or {})

    def _read_extent(self) -> Extent | None:
        metadata = self._read_metadata(schema.EXTENT_METADATA)
        try:
            return schema.parse_extent(metadata) if metadata else None
        except (KeyError, ValueError) as error:
            raise FormatError(self.location, None, f"broken MCAP metadata {schema.EXTENT_METADATA!r}: {error}") from None

    # --- chunks --------------------------------------------------------------------------------------------------------

    def _chunks(self, wanted: set[int], start: float = -math.inf, stop: float = math.inf) -> list[ChunkIndex]:
        """Return the chunks with wanted channels within a time, in order of time."""
        clock = schema.LogClock(self.header)
        first = clock.at(start) if start > -math.inf and self._steady else None
        last = clock.at(stop) if stop < math.inf and self._steady else None
        chunks = [c for c in self._summary.chunks if not c.channels or not wanted.isdisjoint(c.channels)]
        if first is None and last is None:
            return chunks
        hit = [c for c in chunks if (first is None or c.end >= first) and (last is None or c.start <= last)]
        if not hit:
            return []
        # Every frame that begins in one of these is whole in those that overlap them.
        from_time, until = hit[0].start, max(c.end for c in hit)
        return [c for c in chunks if c.end >= from_time and c.start <= until]

    def _opened(self, chunks: list[ChunkIndex], *, whole: bool = True) -> Iterator[bytes]:
        """Yield the records of some chunks; see `ByteSource.read_ranges`."""
        spans = [(chunk.offset, chunk.length) for chunk in chunks]
        return map(self._open, chunks, self._source.read_ranges(spans, "a chunk", whole=whole))

    def _open(self, chunk: ChunkIndex, data: bytes) -> bytes:
        """Return the records of a chunk, from its bytes in the file."""
        opcode, size = schema.RECORD.unpack_from(data) if len(data) >= schema.RECORD.size else (0, 0)
        if opcode != Opcode.CHUNK or schema.RECORD.size + size != chunk.length:
            raise FormatError(self.location, chunk.offset, f"expected a chunk of {chunk.length} bytes, found another record")
        try:
            return open_chunk(memoryview(data)[schema.RECORD.size :])[2]
        except ValueError as error:
            raise FormatError(
                self.location, chunk.offset, f"damaged chunk: {error}; 'carla-recap recover' saves the rest"
            ) from None

    def _assemble(self, chunks: list[ChunkIndex], selection: ReadSelection) -> Iterator[Batch]:
        """Yield the frames of some chunks, in order."""
        # A message takes 16 bytes in the index alone: a file with many more of them than bytes was made to cost time.
        allowance = 2 * MESSAGES_LIMIT + self._source.size // 4
        warn, lenient = self._warn_of_lost, self._lenient
        frames = FrameAssembler(self.location, self._channels, selection, allowance, warn, lenient=lenient)
        horizons = [*(chunk.start for chunk in chunks[1:]), None]
        for chunk, horizon, data in zip(chunks, horizons, self._opened(chunks, whole=selection.sparse), strict=False):
            frames.add(chunk, data)
            yield from frames.complete(horizon)

    def _warn_of_lost(self, frame: int) -> None:
        if not self.lost_messages:
            self.lost_messages = True
            warnings.warn(
                f"{self.location}: messages of frame {frame}, and maybe of others, are missing",
                RecapWarning,
                stacklevel=2,
            )


def _match(summary: Summary, specs: list[schema.ChannelSpec]) -> dict[int, schema.ChannelSpec]:
    """Return the file's channels that are those of a recording, by id."""
    known = {(spec.topic, spec.message): spec for spec in specs}
    found: dict[int, schema.ChannelSpec] = {}
    for id, channel in summary.channels.items():
        spec = known.pop((channel.topic, summary.schemas.get(channel.schema, "")), None)
        if spec is not None and channel.encoding == "protobuf":
            found[id] = spec
    return found
