"""Writes recordings as MCAP: state and events in chunks of their own, compressed while the next frames are taken in."""

from __future__ import annotations

from functools import cache, partial
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.chunk import ChunkBuilder, FrameTemplate, has_template, template_key
from carla_recap.formats.mcap.codec import encode, records_codec
from carla_recap.formats.mcap.digest import Digest
from carla_recap.formats.mcap.file import ChunkedFile, Topic
from carla_recap.formats.mcap.schema import (
    EMPTY,
    EVENTS_AT,
    EXTENT_METADATA,
    FILLED,
    FRAME_TOPIC,
    HEADER_METADATA,
    RAW,
    RAW_TOPIC,
    SECOND,
    TAIL_TOPIC,
    LogClock,
    channel_specs,
    checked,
    header_metadata,
)
from carla_recap.model.frame import Extent, Frame, Header, Packet
from carla_recap.model.layout import EMPTY_LIST, OBJECTS_LIMIT, PayloadError, check
from carla_recap.model.records import FRAME_END, FRAME_START, Group

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch

CHUNK_SIZE: Final = 1 << 20
CHUNK_SECONDS: Final = 5
CHUNK_FRAMES: Final = 5_000  # of recordings whose clock stands still
FRAME_SIZE: Final = 16 << 20
"""The bytes of one frame at which a chunk is cut: what is much larger could not be read."""
LEVEL: Final = 3


class McapWriter(ChunkedFile):
    """Writes a recording.

    Args:
        path: The destination.
        header: The header.
        live: Write every chunk when it is cut, so that a crash loses no more than 5 s of recording; see `AtomicFile`.
        force: See `AtomicFile`.

    Raises:
        RecapError: The destination cannot be written to.
    """

    def __init__(self, path: Path | str, header: Header, *, live: bool = False, force: bool = True) -> None:
        self._header_metadata = checked(header_metadata(header))
        specs = channel_specs(header.table)
        topics = [Topic(spec.topic, spec.message, partial(_schema, spec.module, spec.message)) for spec in specs]
        super().__init__(path, topics, level=LEVEL, live=live, force=force)
        self._by_topic = {spec.topic: id for id, spec in enumerate(specs, 1)}
        self._frame_channel, self._raw_channel, self._tail_channel = (
            self._by_topic[topic] for topic in (FRAME_TOPIC, RAW_TOPIC, TAIL_TOPIC)
        )
        self._channel_of = {spec.type.id: id for id, spec in enumerate(specs, 1) if spec.type}
        self._chunks = {group: ChunkBuilder() for group in Group}
        self._clock = LogClock(header)
        self._sequence = -1
        self._cut_at = self._cut_at_frame = 0
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
        """Add a frame.

        Raises:
            RecapError: The disk is full, or broken.
            FormatError: A packet contradicts its layout.
        """
        self._check_open()
        times = self._clock.times(frame.elapsed)
        self._begin_frame(times[0])
        if not frame.preamble:
            self._extent = Extent(self._extent.frames + 1, frame.id, frame.elapsed)
        head = codec.head(frame.id, frame.elapsed)
        start = b"" if frame.preamble else bytes((FRAME_START,))
        packets = start + bytes([packet.id for packet in frame.packets])
        kinds = start + bytes([self._add(packet, head, times) for packet in frame.packets])
        body = codec.frame_body(frame.duration, packets, kinds)
        self._chunks[Group.STATE].add(self._frame_channel, self._sequence, times, head, body)
        self._digest.frame(frame, self._sequence)
        self._add_digest(self._digest.take(), head, times)
        self._cut_large()

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch.

        Raises:
            RecapError: The disk is full, or broken.
            FormatError: A packet contradicts its layout.
        """
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
        count = max(1, int(np.searchsorted(times[:count, 0], self._cut_at)))
        index = template.number(rows[:count], self._sequence, times[:count])
        chunk.add_records([rows[:count].reshape(-1).data], index, int(times[0, 0]), int(times[count - 1, 0]))
        part = batch[:count]
        self._digest.batch(part, self._sequence)
        self._sequence += count - 1
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

    # --- frames to messages --------------------------------------------------------------------------------------------

    def _begin_frame(self, time: int) -> None:
        """Count a frame; cut the chunks where it is late enough."""
        self._sequence += 1
        if time >= self._cut_at or self._sequence >= self._cut_at_frame:
            for group in Group:
                self._cut(group)
            self._cut_at = time + CHUNK_SECONDS * SECOND
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
                return EMPTY
        if type is None or type.opaque or not type.topic or len(payload) > OBJECTS_LIMIT:
            return self._add_raw(packet, head, times)
        chunk, channel = self._chunks[type.group], self._channel_of[id]
        size = records_codec(type).body_size(payload) if type.fixed else None
        if size is not None:
            chunk.add(channel, self._sequence, times, head, b"")
            chunk.encode_later(type, payload, size)
            self._cut_within_frame(type.group)
            return FILLED
        try:
            if type.fixed:
                packet.warn_of(check(type, payload))
                self._digest.found_irregular(type)
            body = encode(type, payload)
        except PayloadError as error:
            raise packet.error(error) from None
        if len(head) + len(body) > OBJECTS_LIMIT:
            return self._add_raw(packet, head, times)
        chunk.add(channel, self._sequence, times, head, body)
        self._cut_within_frame(type.group)
        if type.name == "spawned":
            self._heroes |= {actor.id: None for actor in packet.records if actor.attribute("role_name") == "hero"}
        return FILLED

    def _add_raw(self, packet: Packet, head: bytes, times: tuple[int, int]) -> int:
        """Add a packet in pieces of its bytes."""
        self._digest.found_irregular(packet.type)
        for body in codec.raw_bodies(packet.id, packet.payload):
            self._chunks[Group.STATE].add(self._raw_channel, self._sequence, times, head, body)
            self._cut_within_frame(Group.STATE)
        return RAW

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
        self._write_metadata(HEADER_METADATA, self._header_metadata)
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
        self._write_chunks(0)
        events_at = self._write_held()
        # Again, so that a reader that has the end of the file needs nothing from its start.
        self._write_metadata(HEADER_METADATA, self._header_metadata)
        self._write_metadata(EXTENT_METADATA, checked(self._extent_metadata(events_at)))
        super()._finish()

    def _extent_metadata(self, events_at: int | None) -> dict[str, str]:
        return {
            "frames": str(self._extent.frames),
            "last_frame": str(self._extent.last_id),
            "duration": repr(float(self._extent.duration)),
            "hero_ids": ",".join(map(str, self._heroes)),
            "additional_data": str(int(self._additional)),
            "steady_clock": str(int(self._clock.steady)),
            **({EVENTS_AT: str(events_at)} if events_at is not None else {}),
            **self._digest.metadata(),
        }


@cache
def _schema(module: str, message: str) -> bytes:
    """Return a message's schema: the descriptors of all files that it needs."""
    from mcap_protobuf.schema import build_file_descriptor_set

    return build_file_descriptor_set(codec.message_class(module, message)).SerializeToString()
