"""Writes recordings as MCAP: state, events and further topics in chunks of their own.

Chunks are compressed while the next frames are taken in.
"""

from __future__ import annotations

from collections import Counter
from functools import cache, partial
from math import ceil, isnan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, RecapError, RecordError
from carla_recap.formats.base import Topic, Writer
from carla_recap.formats.mcap import codec, schema
from carla_recap.formats.mcap.codec import encode, encode_rows, records_codec
from carla_recap.formats.mcap.container import ChunkBuilder, ChunkedFile, schema_of
from carla_recap.formats.mcap.digest import Digest
from carla_recap.formats.mcap.index import CHANNELS_LIMIT
from carla_recap.model.batch import Batch, ConstantColumn
from carla_recap.model.frame import Extent, Frame, Header, Packet
from carla_recap.model.layout import EMPTY_LIST, OBJECTS_LIMIT, Framing, PayloadError, check
from carla_recap.model.lives import HERO
from carla_recap.model.records import FRAME_END, FRAME_START, Group
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.model.batch import Column
    from carla_recap.model.layout import Buffer

CHUNK_SIZE: Final = 1 << 20
CHUNK_SECONDS: Final = 5
CHUNK_FRAMES: Final = 5_000  # of recordings whose clock stands still
FRAME_SIZE: Final = 16 << 20
"""The bytes of one frame at which a chunk is cut: what is much larger could not be read."""
FURTHER_CHUNK_SIZE: Final = 4 << 20
"""The bytes at which a chunk of further topics is cut."""
FURTHER_CHUNK_SECONDS: Final = 30
"""The seconds of a chunk of further topics; in a live file, they are `CHUNK_SECONDS`."""
FURTHER_OPEN_LIMIT: Final = 64 << 20
"""The most bytes of all chunks of further topics that are being filled; beyond them, the largest is cut."""
MESSAGE_LIMIT: Final = 48 << 20
"""The largest message of a further topic, in bytes: what is much larger could not be read."""
LEVEL: Final = 3
_HEADER: Final = np.dtype([*schema.MESSAGE_DTYPE.descr, *codec.HEAD_DTYPE.descr])  # of each message: `MESSAGE`, `codec.HEAD`
_DURATION: Final = _HEADER.itemsize + 1  # the offset of the duration in a frame's own message


class _FurtherTopic(NamedTuple):
    """A further topic: its channel, and the group whose chunks have its messages, by the group's name or the topic's."""

    channel: int
    group: tuple[str, str]


class McapWriter(ChunkedFile, Writer):
    """Writes a recording, and beside it further topics, such as those of sensors; see `AtomicFile`.

    If it is `live`, every chunk is written when it is cut, so that a crash loses no more than 5 s of recording.
    """

    def __init__(self, path: Path | str, header: Header, *, live: bool = False, force: bool = True) -> None:
        self.without_events = header.without_events
        self._header_metadata = {schema.HEADER_METADATA: schema.checked(schema.header_metadata(header))}
        if header.parameters:
            self._header_metadata[schema.PARAMETERS_METADATA] = schema.checked(schema.parameters_metadata(header))
        specs = schema.channel_specs(header.table)
        topics = [Topic(spec.topic, spec.message, partial(_schema, spec.module, spec.message)) for spec in specs]
        super().__init__(path, topics, level=LEVEL, live=live, force=force)
        self._by_topic = {spec.topic: id for id, spec in enumerate(specs, 1)}
        self._frame_channel, self._raw_channel, self._tail_channel = (
            self._by_topic[topic] for topic in (schema.FRAME_TOPIC, schema.RAW_TOPIC, schema.TAIL_TOPIC)
        )
        self._channel_of = {spec.type.id: id for id, spec in enumerate(specs, 1) if spec.type}
        self._chunks = {group: ChunkBuilder() for group in Group}
        self._further: dict[str, _FurtherTopic] = {}
        self._further_chunks: dict[tuple[str, str], ChunkBuilder] = {}
        self._further_span = (CHUNK_SECONDS if live else FURTHER_CHUNK_SECONDS) * schema.SECOND
        self._further_counts: Counter[str] = Counter()
        self._further_size = 0  # bytes of the chunks of further topics
        self._clock = schema.LogClock(header)
        self._sequence = -1
        self._time = self._span = 0  # of the latest frame, and by how much the clock has gone since a cut, in ns
        self._cut_at_frame = 0
        self._extent = Extent()
        self._heroes: dict[int, None] = {}
        self._additional = False
        self._digest = Digest(header.table)
        self._template: FrameTemplate | None = None
        if live:
            for topic in topics:
                topic.schema()  # takes long once; frames are not to wait for it
        self._begin(self._write_header)

    def write(self, frame: Frame) -> None:
        """Add a frame; a `FormatError` if a packet contradicts its layout."""
        self._check_open()
        times = self._clock.times(frame.elapsed)
        self._begin_frame(times[1])
        if not frame.preamble:
            self._extent = Extent(self._extent.frames + 1, frame.id, frame.elapsed)
        head = codec.head(frame.id, frame.elapsed)
        start = b"" if frame.preamble else bytes((FRAME_START,))
        packets = start + bytes([packet.id for packet in frame.packets])
        kinds = start + bytes([self._add(packet, head, times) for packet in frame.packets])
        body = codec.frame_body(frame.duration, packets, kinds)
        self._chunks[Group.STATE].add(self._frame_channel, self._sequence, times, head, body)
        self._digest.batch(Batch.of(frame), self._sequence)
        self._add_digest(self._digest.take(), head, times)
        self._cut_large()

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch; see `write`."""
        self._check_open()
        template = self._template_of(batch) if len(batch) > 1 else None
        rows = template.encode(batch) if template else None
        times = self._clock.times_of(batch.elapsed) if rows is not None else None
        if template is None or rows is None or times is None:
            for frame in batch:
                self.write(frame)
            return
        start = 0
        while start < len(batch):
            start += self._write_rows(batch[start:], template, rows[start:], times[start:])

    def _write_rows(self, batch: Batch, template: FrameTemplate, rows: NDArray[np.uint8], times: NDArray[np.uint64]) -> int:
        """Add as many frames of a batch as belong in the same chunk; return their number."""
        self._begin_frame(int(times[0, 0]))
        chunk = self._chunks[Group.STATE]
        room = max(1, ceil((CHUNK_SIZE - chunk.size) / template.size))
        count = min(room, len(batch), self._cut_at_frame - self._sequence)
        cut_at = np.uint64(self._time - self._span + CHUNK_SECONDS * schema.SECOND)
        count = max(1, int(np.searchsorted(times[:count, 0], cut_at)))
        index = template.number(rows[:count], self._sequence, times[:count])
        chunk.add_records([rows[:count].reshape(-1).data], index, int(times[0, 0]), int(times[count - 1, 0]))
        part = batch[:count]
        self._digest.batch(part, self._sequence)
        self._sequence += count - 1
        self._span += int(times[count - 1, 0]) - self._time
        self._time = int(times[count - 1, 0])
        last, elapsed = part.id[-1].item(), part.elapsed[-1].item()
        self._extent = Extent(self._extent.frames + count, last, elapsed)
        self._additional = self._additional or template.additional
        time, publish_time = times[count - 1].tolist()
        self._add_digest(self._digest.take(), codec.head(last, elapsed), (time, publish_time))
        self._cut_large()
        return count

    def write_tail(self, piece: bytes) -> None:
        """Add bytes behind the last complete packet."""
        self._check_open()
        time = self._clock.next()
        self._sequence += 1
        self._chunks[Group.STATE].add(self._tail_channel, self._sequence, (time, time), b"", codec.tail(piece))
        self._cut(Group.STATE)

    # --- further topics ------------------------------------------------------------------------------------------------

    def add_topic(self, topic: Topic, *, group: str = "") -> None:
        """Add a further topic, at any time before its first message.

        Topics of the same group share chunks, as those with few and small messages should; "" means chunks of its own. To
        read a topic, the chunks of its group are decompressed. A `RecapError` says that the file has a topic of that name,
        or as many as a file can have.
        """
        self._check_open()
        if topic.name in self._by_topic:
            raise RecapError(f"{self.path}: has a topic {topic.name!r:.200} already")
        if len(self._topics) >= CHANNELS_LIMIT:
            raise RecapError(f"{self.path}: has {CHANNELS_LIMIT} topics, which is the most of a file")
        self._topics.append(topic)
        channel = self._by_topic[topic.name] = len(self._topics)
        self._further[topic.name] = _FurtherTopic(channel, (group, "" if group else topic.name))
        self._declare(channel)
        if self._live:
            self._sync()

    def write_message(self, topic: str, elapsed: float, body: Buffer) -> None:
        """Add an encoded message of a topic that was added, at some elapsed seconds; those of a topic in order of time.

        A `RecapError` says that there is no such topic, or that MCAP has no such time, a `RecordError` that it is too large.
        """
        self._check_open()
        further, time = self._further.get(topic), self._clock.at(elapsed)
        if further is None:
            raise RecapError(f"{self.path}: no topic {topic!r:.200} was added")
        if time is None:
            raise RecapError(f"{self.path}: a message of {topic} at {elapsed} s, which is no time of a recording")
        data = bytes(body)
        if len(data) > MESSAGE_LIMIT:
            raise RecordError(f"{self.path}: a message of {topic} of {len(data)} bytes; at most {MESSAGE_LIMIT} are written")
        chunk = self._further_chunks.get(further.group)
        if chunk is not None and (chunk.size + len(data) > FURTHER_CHUNK_SIZE or time >= chunk.start + self._further_span):
            self._cut_further(further.group)
            chunk = None
        if chunk is None:
            chunk = self._further_chunks[further.group] = ChunkBuilder()
        before = chunk.size
        chunk.add(further.channel, self._further_counts[topic], (time, time), b"", data)
        self._further_counts[topic] += 1
        self._further_size += chunk.size - before
        if chunk.size >= FURTHER_CHUNK_SIZE:
            self._cut_further(further.group)
        elif self._further_size > FURTHER_OPEN_LIMIT:
            self._cut_further(max(self._further_chunks, key=lambda group: self._further_chunks[group].size))

    def _cut_further(self, group: tuple[str, str]) -> None:
        """Cut the chunk of a group of further topics."""
        chunk = self._further_chunks.pop(group)
        self._further_size -= chunk.size
        self._add_chunk(chunk)

    # --- frames to messages --------------------------------------------------------------------------------------------

    def _begin_frame(self, time: int) -> None:
        """Count a frame; cut the chunks where the clock has gone on, or back, by enough."""
        self._sequence += 1
        self._span += abs(time - self._time)
        self._time = time
        if self._span >= CHUNK_SECONDS * schema.SECOND or self._sequence >= self._cut_at_frame:
            for group in Group:
                self._cut(group)
            for further in [*self._further_chunks] if self._live else ():
                self._cut_further(further)
            self._span = 0
            self._cut_at_frame = self._sequence + CHUNK_FRAMES

    def _template_of(self, batch: Batch) -> FrameTemplate | None:
        """Return the template of the frames of a batch, if they have one."""
        if not has_template(batch):
            return None
        if self._template is None or self._template.key != template_key(batch):
            self._template = FrameTemplate(self._channel_of, self._frame_channel, batch)
        return self._template

    def _add(self, packet: Packet, head: bytes, times: tuple[int, int]) -> int:
        """Add a packet's messages; return how it is recorded: `EMPTY`, `FILLED` or `RAW`."""
        type, id, payload = packet.type, packet.id, packet.payload
        if type is not None:
            self._additional = self._additional or type.additional
            if payload is EMPTY_LIST or payload == EMPTY_LIST or (id == FRAME_END and not payload):
                return schema.EMPTY
        if type is None or type.opaque or not type.topic or len(payload) > OBJECTS_LIMIT:
            return self._add_raw(packet, head, times)
        chunk, channel = self._chunks[type.group], self._channel_of[id]
        try:
            body = encode(type, payload)
            if (type.fixed or type.name == "spawned") and (surplus := check(type, payload)):
                self._digest.found_irregular(type)
                if type.fixed:
                    packet.warn_of(surplus)
        except PayloadError as error:
            raise packet.error(error) from None
        if len(head) + len(body) > OBJECTS_LIMIT:
            return self._add_raw(packet, head, times)
        chunk.add(channel, self._sequence, times, head, body)
        self._cut_within_frame(type.group)
        if type.name == "spawned":
            self._heroes |= {actor.id: None for actor in packet.records if actor.attribute("role_name") == HERO}
        return schema.FILLED

    def _add_raw(self, packet: Packet, head: bytes, times: tuple[int, int]) -> int:
        """Add a packet in pieces of its bytes."""
        self._digest.found_irregular(packet.type)
        for body in codec.raw_bodies(packet.id, packet.payload):
            self._chunks[Group.STATE].add(self._raw_channel, self._sequence, times, head, body)
            self._cut_within_frame(Group.STATE)
        return schema.RAW

    def _add_digest(self, found: Iterable[tuple[str, bytes]], head: bytes, times: tuple[int, int]) -> None:
        """Add messages of the digest, by topic."""
        for topic, body in found:
            self._chunks[Group.EVENTS].add(self._by_topic[topic], self._sequence, times, head, body)
            self._cut_within_frame(Group.EVENTS)

    def _cut_large(self) -> None:
        """Cut the chunks that are large enough."""
        for group, chunk in self._chunks.items():
            if chunk.size >= CHUNK_SIZE:
                self._cut(group)

    def _cut_within_frame(self, group: Group) -> None:
        """Cut a group's chunk, should a single frame make it too large to be read."""
        if self._chunks[group].size >= FRAME_SIZE:
            self._cut(group)

    # --- the file ------------------------------------------------------------------------------------------------------

    def _write_header(self) -> None:
        self._write_start()
        for name, values in self._header_metadata.items():
            self._write_metadata(name, values)
        if self._live:
            self._sync()

    def _cut(self, group: Group) -> None:
        """Cut the chunk of a group, which is then compressed."""
        chunk = self._chunks[group]
        if not chunk.is_empty:
            self._chunks[group] = ChunkBuilder()
            self._add_chunk(chunk, at_end=group is Group.EVENTS)

    def _finish(self) -> None:
        rest = list(self._digest.finish())
        if rest:
            self._sequence += 1
            time = self._clock.next()
            self._add_digest(rest, codec.head(self._extent.last_id, self._extent.duration), (time, time))
        for group in Group:
            self._cut(group)
        for further in [*self._further_chunks]:
            self._cut_further(further)
        self._write_chunks(0)
        events_at = self._write_held()
        # Again, so that a reader that has the end of the file needs nothing from its start.
        for name, values in self._header_metadata.items():
            self._write_metadata(name, values)
        self._write_metadata(schema.EXTENT_METADATA, schema.checked(self._extent_metadata(events_at)))
        super()._finish()

    def _extent_metadata(self, events_at: int | None) -> dict[str, str]:
        duration = float(self._extent.duration)
        return {
            "frames": str(self._extent.frames),
            "last_frame": str(self._extent.last_id),
            "duration": number(duration) if isnan(duration) else repr(duration),
            "hero_ids": ",".join(map(str, self._heroes)),
            "additional_data": str(int(self._additional)),
            "steady_clock": str(int(self._clock.steady)),
            **({schema.EVENTS_AT: str(events_at)} if events_at is not None else {}),
            **({schema.WITHOUT_EVENTS: "1"} if self.without_events else {}),
            **self._digest.metadata(),
        }


@cache
def _schema(module: str, message: str) -> bytes:
    return schema_of(codec.message_class(module, message))


# --- many frames at once -----------------------------------------------------------------------------------------------


class FrameTemplate:
    """The messages of frames that differ in nothing but their numbers, made of a batch of them; see `has_template`."""

    def __init__(self, channels: Mapping[int, int], frame_channel: int, batch: Batch) -> None:
        self.key = template_key(batch)  # what batches with the same template have in common
        # Whether some packets are such as CARLA writes only when it records additional data.
        self.additional = any(column.type is not None and column.type.additional for column in batch.columns)
        self.offsets: list[tuple[int, int]] = []  # channel and offset of each message
        bodies: list[tuple[int, bytes]] = []
        for column in _filled(batch):
            type = column.type
            assert type is not None
            if type.fixed:
                bodies.append((channels[column.id], records_codec(type).blank(column.records.shape[1])))
            else:
                bodies.append((channels[column.id], encode(type, column.packet(0).payload)))
        ids = bytes((FRAME_START, *(column.id for column in batch.columns)))
        kinds = bytes((FRAME_START, *(schema.EMPTY if _is_empty(column) else schema.FILLED for column in batch.columns)))
        frame = codec.frame_body(0.0, ids, kinds)
        template = bytearray()
        for channel, body in (*bodies, (frame_channel, frame)):
            self.offsets.append((channel, len(template)))
            length = schema.MESSAGE_FIELDS + codec.HEAD.size + len(body)
            template += schema.MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, 0, 0) + codec.head(0, 0.0) + body
        self.size = len(template)  # the bytes of all messages of a frame
        self._template = np.frombuffer(bytes(template), np.uint8)

    def encode(self, batch: Batch) -> NDArray[np.uint8] | None:
        """Return the messages of a batch, (frames, bytes), without sequence numbers and times.

        None where the messages of the frames have other sizes after all.
        """
        rows = np.empty((len(batch), self.size), np.uint8)
        rows[:] = self._template
        ends = [offset for _, offset in self.offsets[1:]]
        for column, (_, offset), end in zip(_filled(batch), self.offsets, ends, strict=False):
            type = column.type
            assert type is not None
            if type.fixed:
                form = records_codec(type)
                form.fill(_fields(rows, form.wire, offset + _HEADER.itemsize, column.records.shape[1]), column.records)
                continue
            bodies = encode_rows(type, column.payloads(len(batch)))
            if bodies is None or offset + _HEADER.itemsize + bodies.shape[1] != end:
                return None
            rows[:, offset + _HEADER.itemsize : end] = bodies
        for _, offset in self.offsets:
            headers = _fields(rows, _HEADER, offset)
            headers["frame"] = batch.id
            headers["elapsed"] = batch.elapsed
        _fields(rows, np.dtype([("duration", "<f8")]), offset + _DURATION)["duration"] = batch.duration
        return rows

    def number(self, rows: NDArray[np.uint8], sequence: int, times: NDArray[np.uint64]) -> dict[int, NDArray[np.uint64]]:
        """Give messages of frames, (frames, bytes), their sequence numbers and log and publish times in ns, (frames, 2).

        Return the index of the messages, see `ChunkBuilder.add_records`.
        """
        index = {}
        numbers = np.arange(sequence, sequence + len(rows))
        entries = np.empty((len(rows), 2), np.uint64)
        entries[:, 0] = times[:, 0]
        entries[:, 1] = np.arange(0, rows.nbytes, self.size)
        for channel, offset in self.offsets:
            headers = _fields(rows, schema.MESSAGE_DTYPE, offset)
            headers["sequence"] = numbers
            headers["log_time"], headers["publish_time"] = times.T
            index[channel] = entries + np.array([0, offset], np.uint64)
        return index


def has_template(batch: Batch) -> bool:
    """Return whether the messages of all frames of a batch can be written at once."""
    ids = [column.id for column in _filled(batch)]
    if batch.preamble or len(set(ids)) < len(ids):
        return False
    return all(map(_is_regular, _filled(batch)))


def template_key(batch: Batch) -> tuple[tuple[int, int], ...]:
    """Return what batches with the same template have in common."""
    return tuple((column.id, -1 if _is_empty(column) else column.size) for column in batch.columns)


def _fields(rows: NDArray[np.uint8], dtype: np.dtype[np.void], offset: int, count: int | None = None) -> NDArray[np.void]:
    """Return structures at the same offset in all rows: one in each, (rows,), or some in each, (rows, count)."""
    shape, strides = (len(rows),), (rows.shape[1],)
    if count is not None:
        return np.ndarray((*shape, count), dtype, rows, offset, (*strides, dtype.itemsize))
    return np.ndarray(shape, dtype, rows, offset, strides)


def _filled(batch: Batch) -> list[Column]:
    return [column for column in batch.columns if not _is_empty(column)]


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
            return encode_rows(type, column.payloads(1)) is not None
        form, records = records_codec(type), column.records
        return form.payload_size(records.shape[1]) == column.size and form.fits(records)
    except (PayloadError, FormatError):
        return False
