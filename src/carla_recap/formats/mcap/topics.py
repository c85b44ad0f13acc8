"""Reads the further topics of a recording: what the file says of them, and their messages.

Their metadata and schemas are read when they are asked for, and their chunks are those of no query.
"""

from __future__ import annotations

import math
import struct
import warnings
from collections import Counter, defaultdict
from contextlib import suppress
from functools import cache, cached_property
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, RecapError, RecapWarning
from carla_recap.formats.base import FurtherTopic, Topic, TopicMessage
from carla_recap.formats.mcap import index
from carla_recap.formats.mcap.frames import MESSAGES_LIMIT, PENDING_LIMIT
from carla_recap.formats.mcap.schema import MAX_TIME, MESSAGE, MESSAGE_FIELDS, MESSAGE_INDEX, RECORD, LogClock
from carla_recap.model.frame import SAME_TIME
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from carla_recap.formats.mcap.index import ChannelRecord, ChunkIndex, Summary
    from carla_recap.formats.sources import ByteRange, ByteSource

_SCHEMA_LIMIT: Final = 16 << 20
"""The largest schema of a further topic that is read, in bytes."""


class _Message(NamedTuple):
    """A message in a chunk: its log time in ns, its channel, and its data."""

    time: int
    channel: int
    data: memoryview


class _Held(NamedTuple):
    """A chunk with messages that wait for others: the last of their times in ns, its bytes, and their number."""

    last: int
    size: int
    messages: int


class FurtherTopics:
    """The topics of a file that are none of a recording's own; `opened` yields the records of some chunks.

    Channels of one topic count as one where their messages have the same schema; else the first of them counts. `own` are
    the names of a recording's topics, and `matched` the channels that have them.
    """

    def __init__(
        self,
        source: ByteSource,
        summary: Summary,
        own: Collection[str],
        matched: Collection[int],
        clock: LogClock,
        opened: Callable[[list[ChunkIndex]], Iterator[bytes]],
    ) -> None:
        self._source = source
        self._summary = summary
        self._clock = clock
        self._opened = opened
        self._channels: dict[str, list[ChannelRecord]] = {}
        self._left_out: list[str] = []  # the topics of the other channels that have messages, as far as is known
        parts = [chunk.channels for chunk in summary.chunks]
        used = frozenset().union(*parts) if all(parts) else summary.channels.keys()
        for channel in summary.channels.values():
            if channel.id in matched:
                continue
            found = self._channels.get(channel.topic, [channel])
            if channel.topic in own or (channel.schema, channel.encoding) != (found[0].schema, found[0].encoding):
                self._left_out += [channel.topic] if channel.id in used else []
            else:
                self._channels.setdefault(channel.topic, []).append(channel)

    @cached_property
    def topics(self) -> dict[str, FurtherTopic]:
        """The topics by name, but for those whose schemas are damaged or too large, of which a warning says which."""
        counts, spans = (self._summary.counts, self._spans()) if self._is_indexed else self._measured()
        groups = self._groups()
        found, broken = {}, []
        for name, channels in self._channels.items():
            ids = [channel.id for channel in channels]
            known = [spans[id] for id in ids if id in spans]
            first = self._clock.elapsed(min(start for start, _ in known)) if known else None
            last = self._clock.elapsed(max(end for _, end in known)) if known else None
            count = sum(counts[id] for id in ids)
            try:
                topic = self._topic(channels[0])
            except FormatError:
                broken.append(name)
                continue
            found[name] = FurtherTopic(topic, count, first, last, groups.get(ids[0], ""))
        for what, names in (
            ("topics with damaged or too large schemas", broken),
            (
                "channels with other messages than the first one of their topics, or than those of a recording",
                self._left_out,
            ),
        ):
            if names:
                warnings.warn(f"{self._source.location}: {what} are left out: {first_of(names)}", RecapWarning, stacklevel=2)
        return found

    def messages(
        self, topics: Collection[str] | None, start: float, stop: float, *, in_order: bool
    ) -> Iterator[TopicMessage]:
        """Yield messages; see `Reader.further_messages`."""
        channels = self._channels_of(self._channels.keys() if topics is None else topics)
        return self._read(channels, start - SAME_TIME, stop - SAME_TIME, in_order=in_order)

    def latest(self, topics: Collection[str], elapsed: float) -> list[TopicMessage]:
        """Return the latest message of each topic; see `Reader.latest_messages`.

        Chunks are read from the latest one back, until those before have nothing later.
        """
        channels = self._channels_of(topics)
        end = self._clock.at(elapsed + SAME_TIME)
        if end is None and not elapsed > 0:  # before all times that MCAP has, or none
            return []
        found: dict[str, tuple[int, int, bytes]] = {}  # the time, the number of the chunk, and the data
        chunks = [chunk for chunk in self._chunks(channels) if end is None or chunk.start < end]
        for number, chunk in sorted(enumerate(chunks), key=lambda each: each[1].end, reverse=True):
            wanted = {id for id, name in channels.items() if name not in found or found[name][:2] < (chunk.end, number)}
            if chunk.channels and wanted.isdisjoint(chunk.channels):
                continue
            (data,) = self._opened([chunk])
            later: dict[str, _Message] = {}
            for message in self._messages_in(chunk, data, wanted, None, end):
                name = channels[message.channel]
                if name not in later or message.time >= later[name].time:
                    later[name] = message
            for name, (time, _, content) in later.items():
                if name not in found or (time, number) > found[name][:2]:
                    found[name] = time, number, bytes(content)
        ordered = sorted(found.items(), key=lambda item: item[1][0])
        return [TopicMessage(name, self._clock.elapsed(time), content) for name, (time, _, content) in ordered]

    def _channels_of(self, topics: Collection[str]) -> dict[int, str]:
        """Return the channels of some topics, and the topic of each."""
        for name in topics:
            if name not in self._channels:
                has = first_of(sorted(self._channels))
                raise RecapError(f"{self._source.location}: has no further topic {name!r:.200}; it has {has:.500}")
        return {channel.id: name for name in topics for channel in self._channels[name]}

    def _read(self, channels: dict[int, str], start: float, stop: float, *, in_order: bool) -> Iterator[TopicMessage]:
        first, last = self._clock.at(start), self._clock.at(stop)
        if (first is None and not start < 0) or (last is None and not stop > 0):
            return
        chunks = [
            chunk
            for chunk in self._chunks(channels)
            if (first is None or chunk.end >= first) and (last is None or chunk.start < last)
        ]
        held: list[_Held] = []
        pending: list[_Message] = []
        allowance = 2 * MESSAGES_LIMIT + self._source.size // 4
        for number, data in enumerate(self._opened(chunks), 1):
            chunk, horizon = chunks[number - 1], chunks[number].start if number < len(chunks) else None
            found = self._messages_in(chunk, data, channels, first, last)
            allowance -= len(found)
            if allowance < 0:
                raise self._damaged(chunk, "more messages than a file of this size can mean")
            if in_order and (pending or horizon is not None):
                held.append(_Held(max((message.time for message in found), default=0), len(data), len(found)))
                if sum(each.size for each in held) > PENDING_LIMIT or sum(each.messages for each in held) > MESSAGES_LIMIT:
                    limits = f"{PENDING_LIMIT} bytes or {MESSAGES_LIMIT} messages"
                    raise self._damaged(chunk, f"more than {limits} of chunks of further topics overlap in time")
                pending += found
                pending.sort(key=itemgetter(0))
                ready = sum(message.time < horizon for message in pending) if horizon is not None else len(pending)
                found, pending = pending[:ready], pending[ready:]
                held = [each for each in held if horizon is not None and each.last >= horizon]
            elif in_order:
                found.sort(key=itemgetter(0))
            for message in found:
                yield TopicMessage(channels[message.channel], self._clock.elapsed(message.time), bytes(message.data))
                self._source.check_open()

    def _messages_in(
        self, chunk: ChunkIndex, data: bytes, channels: Collection[int], first: int | None, last: int | None
    ) -> list[_Message]:
        """Return the messages of some channels in a chunk, from a log time up to another."""
        found = []
        view = memoryview(data)
        least, end = 0 if first is None else first, math.inf if last is None else last
        try:
            for opcode, start, stop in index.split_records(view):
                if opcode != Opcode.MESSAGE:
                    continue
                if stop - start < MESSAGE_FIELDS:
                    raise ValueError(f"a message of {stop - start} bytes")
                _, _, channel, _, time, _ = MESSAGE.unpack_from(view, start - RECORD.size)
                if channel in channels and least <= time < end:
                    found.append(_Message(time, channel, view[start + MESSAGE_FIELDS : stop]))
                    if len(found) > MESSAGES_LIMIT:
                        raise ValueError(f"more than {MESSAGES_LIMIT} messages")
        except ValueError as error:
            raise self._damaged(chunk, f"damaged chunk: {error}") from None
        return found

    def _damaged(self, chunk: ChunkIndex, message: str) -> FormatError:
        return FormatError(self._source.location, chunk.offset, message)

    def _chunks(self, channels: Collection[int]) -> list[ChunkIndex]:
        """Return the chunks with some channels, in order of time."""
        wanted = frozenset(channels)
        return [chunk for chunk in self._summary.chunks if not chunk.channels or not wanted.isdisjoint(chunk.channels)]

    # --- what the file says of them ------------------------------------------------------------------------------------

    def _topic(self, channel: ChannelRecord) -> Topic:
        """Return a topic; its metadata are empty where they are broken, or too large."""
        metadata: dict[str, str] = {}
        with suppress(ValueError):
            metadata = index.parse_channel_metadata(
                self._declared(self._summary.channel_spans, channel.id, index.METADATA_LIMIT)
            )
        message = self._summary.schemas.get(channel.schema, "")
        encoding = self._schema(channel.schema)[0] if message else ""
        return Topic(channel.topic, message, lambda: self._schema(channel.schema)[1], metadata, channel.encoding, encoding)

    def _schema(self, id: int) -> tuple[str, bytes]:
        """Return the encoding and the data of a schema; nothing where the file has none of that id."""
        if id not in self._summary.schema_spans:
            return "", b""
        try:
            return index.parse_schema(self._declared(self._summary.schema_spans, id, _SCHEMA_LIMIT))
        except ValueError as error:
            raise FormatError(self._source.location, None, f"schema {id}: {error}") from None

    def _declared(self, places: dict[int, ByteRange | bytes], id: int, limit: int) -> bytes:
        """Return the content of a record that declares a schema or a channel."""
        place = places.get(id, b"")
        if isinstance(place, bytes):
            return place
        if place[1] > limit:
            raise ValueError(f"expected at most {limit} bytes, found {place[1]}")
        return self._source.read(*place, "a declaration")

    def _ids(self) -> set[int]:
        return {channel.id for channels in self._channels.values() for channel in channels}

    @property
    def _is_indexed(self) -> bool:
        """Whether the file says how many messages each channel has, and which chunks have them."""
        chunks = self._summary.chunks
        return not chunks or (bool(self._summary.counts) and all(chunk.channels for chunk in chunks))

    def _measured(self) -> tuple[Counter[int], dict[int, tuple[int, int]]]:
        """Return the number of messages of each channel, and the first and last log time, of the messages themselves."""
        counts: Counter[int] = Counter()
        spans: dict[int, tuple[int, int]] = {}
        ids = self._ids()
        chunks = self._chunks(ids)
        for chunk, data in zip(chunks, self._opened(chunks), strict=True):
            for time, channel, _ in self._messages_in(chunk, data, ids, None, None):
                counts[channel] += 1
                first, last = spans.get(channel, (time, time))
                spans[channel] = min(first, time), max(last, time)
        return counts, spans

    def _spans(self) -> dict[int, tuple[int, int]]:
        """Return the first and the last log time of each channel, in ns, as the index has them."""
        ids, times_in = self._ids(), cache(self._times_in)
        first: dict[int, int] = {}
        last: dict[int, int] = {}
        for chunk in self._summary.chunks:
            for id in chunk.channels & ids:
                if id not in first or chunk.start < first[id]:
                    first[id] = min(first.get(id, MAX_TIME), times_in(chunk).get(id, (chunk.start, 0))[0])
        for chunk in sorted(self._summary.chunks, key=lambda chunk: chunk.end, reverse=True):
            for id in chunk.channels & ids:
                if id not in last or chunk.end > last[id]:
                    last[id] = max(last.get(id, 0), times_in(chunk).get(id, (0, chunk.end))[1])
        return {id: (time, last[id]) for id, time in first.items()}

    def _times_in(self, chunk: ChunkIndex) -> dict[int, tuple[int, int]]:
        """Return the first and last log time of the channels of a chunk, as the message indexes behind it have them."""
        found: dict[int, tuple[int, int]] = {}
        if len(chunk.channels) == 1:
            return found
        at = chunk.offset + chunk.length
        try:
            for _ in chunk.channels:
                content = index.read_record(self._source, at, Opcode.MESSAGE_INDEX, "a message index", index.CHUNK_LIMIT)
                at += RECORD.size + len(content)
                channel, size = MESSAGE_INDEX.unpack_from(content)
                times = np.frombuffer(content, "<u8", size // 8, MESSAGE_INDEX.size)[::2]
                if len(times):
                    found[channel] = int(times.min()), int(times.max())
        except (FormatError, ValueError, struct.error):  # it has none: what the chunk says of its times is near
            return found
        return found

    def _groups(self) -> dict[int, str]:
        """Return the name of the group of each channel that shares chunks with others."""
        near: dict[int, set[int]] = defaultdict(set)
        ids = self._ids()
        for channels in {chunk.channels & ids for chunk in self._summary.chunks}:
            for one, other in pairwise(sorted(channels)):
                near[one].add(other)
                near[other].add(one)
        groups: dict[int, str] = {}
        for least in sorted(near):
            waiting = [least]
            while waiting:
                id = waiting.pop()
                if id not in groups:
                    groups[id] = f"{least}"
                    waiting += near[id]
        return groups
