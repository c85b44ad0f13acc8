"""Reads recordings from MCAP by the index: a query touches the chunks that hold its channels, and nothing else.

Every chunk's checksum is checked, and no chunk is larger in memory than `CHUNK_LIMIT`.
"""

from __future__ import annotations

import itertools
import math
import warnings
from bisect import bisect_left
from collections import deque
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, NotARecording, RecapWarning
from carla_recap.formats.mcap import messages
from carla_recap.formats.mcap.fixed import Payloads, fixed_codec
from carla_recap.formats.mcap.runs import BrokenRecords, column, message_runs
from carla_recap.formats.mcap.schema import (
    EMPTY,
    EXPORT_METADATA,
    EXTENT_METADATA,
    FILLED,
    FRAME_MESSAGE,
    FRAME_TOPIC,
    HEADER_METADATA,
    RAW_MESSAGE,
    RAW_TOPIC,
    RECORD,
    STRETCHES,
    STRETCHES_MESSAGE,
    STRETCHES_TOPIC,
    TAIL_MESSAGE,
    TAIL_TOPIC,
    ChannelSpec,
    LogClock,
    channel_specs,
    parse_extent,
    parse_header,
    unchecked,
)
from carla_recap.formats.mcap.source import METADATA_LIMIT, Chunk, Source, Summary, open_chunk, parse_record, read_summary
from carla_recap.formats.mcap.variable import decode, decode_records
from carla_recap.model.batch import Batch, ConstantColumn, within
from carla_recap.model.frame import SAME_TIME, Extent, Frame, Header, Packet
from carla_recap.model.layout import EMPTY_LIST, Buffer, Records
from carla_recap.model.records import FRAME_END, FRAME_START, RecordType
from carla_recap.model.stationary import BlockedRow

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from carla_recap.formats.mcap.runs import MessageRun
    from carla_recap.model.batch import Column

MESSAGES_LIMIT: Final = 500_000
"""How many messages are held at once, in frames that are not complete yet; ours are some hundreds."""
PENDING_LIMIT: Final = 256 << 20
"""How many bytes of chunks that overlap in time are held at once; ours overlap by 5 s of recording."""

_PLANS: Final = 4096  # ways to put a frame together that are remembered
_NO_CHANNEL: Final = -1

BLOCK_SIZE: Final = 256 << 10
"""Chunks that are smaller than this, in bytes, are taken several at a time."""

Found = tuple["ChannelMessages", int]  # a message: those of its channel, and its index among them
Gathered = list[Found]  # the messages of one frame, in file order
Plan = tuple[bool, list[Any]]  # whether packets are a preamble; each packet, or the channel to take it from
Pending = dict[int, tuple[int, Gathered]]  # index of a frame → its log time and messages


class _Held(NamedTuple):
    """Chunks of which some frames are not complete yet: the log time of the last frame, bytes, messages."""

    last: int
    size: int
    messages: int


class ChannelMessages:
    """The messages of a channel in a chunk; those whose records have one size are decoded together."""

    __slots__ = ("_decoded", "_payloads", "channel", "messages", "path", "type")

    def __init__(self, channel: int, type: RecordType | None, path: Path) -> None:
        self.channel = channel
        self.type = type
        self.path = path
        self.messages: list[memoryview] = []
        self._payloads: Payloads | None = None
        self._decoded = False

    @property
    def payloads(self) -> Payloads | None:
        """All payloads; None where each message is to be decoded by itself."""
        if not self._decoded:
            self._decoded = True
            if self.type is not None and self.type.fixed:
                self._payloads = fixed_codec(self.type).decode(self.messages)
        return self._payloads


class _Plans:
    """How to put frames together, by what they say of their packets.

    Args:
        make: Makes a plan.
        wanted: The channels that are read.
        whole: Whether all packets are wanted.
    """

    def __init__(self, make: Callable[[bytes, set[int], bool], Plan], wanted: set[int], *, whole: bool) -> None:
        self._make = make
        self._wanted = wanted
        self._whole = whole
        self._known: dict[bytes, Plan] = {}

    def of(self, packets: bytes) -> Plan:
        """Return the plan for what `messages.frame_packets` wrote."""
        plan = self._known.get(packets)
        if plan is None:
            if len(self._known) > _PLANS:
                self._known.clear()
            plan = self._known[packets] = self._make(packets, self._wanted, self._whole)
        return plan


class MessagePacket(Packet):
    """A packet that came as a message, decoded when asked for."""

    __slots__ = ("_batch", "_index")

    def __init__(self, type: RecordType, batch: ChannelMessages, index: int) -> None:
        self.id = type.id
        self.type = type
        self._batch = batch
        self._index = index
        self._payload = self._records = None
        self._place = (batch.path, None)

    @property
    def payload(self) -> Buffer:
        """The bytes behind the packet header.

        Raises:
            FormatError: The message contradicts its schema.
        """
        if self._payload is None:
            payloads = self._batch.payloads
            if payloads is not None:
                return payloads.payload(self._index)
            assert self.type
            try:
                self._payload = decode(self.type, self._batch.messages[self._index])
            except messages.WireError as error:
                raise self._broken(error) from None
        return self._payload

    @property
    def records(self) -> Records:
        """The records.

        Raises:
            FormatError: The message contradicts its schema.
        """
        if self._records is None:
            payloads = self._batch.payloads
            if payloads is not None:
                return payloads.records(self._index)
            assert self.type
            try:
                if not self.type.fixed:
                    self._records = decode_records(self.type, self._batch.messages[self._index])
            except messages.WireError as error:
                raise self._broken(error) from None
        return super().records

    def _broken(self, error: messages.WireError) -> FormatError:
        head = messages.read_head(self._batch.messages[self._index])
        name = self.type.topic if self.type else ""
        return FormatError(self._batch.path, None, f"{name} of frame {head[0]}: {error}" if head else f"{name}: {error}")


class McapReader:
    """Reads a recording from MCAP.

    Args:
        path: The file.
        summary: What the file holds, where that is known better than by the file itself.
        header: Its header, where the file has none.
        salvage: Leave out frames that contradict their schema.

    Raises:
        NotARecording: It is no MCAP file, or none with a recording.
        FormatError: It is damaged, or was never finished.
    """

    def __init__(
        self, path: Path | str, *, summary: Summary | None = None, header: Header | None = None, salvage: bool = False
    ) -> None:
        self.path = Path(path)
        self._salvage = salvage
        self._source = Source(path)
        self._warned: set[str] = set()
        try:
            self._summary = summary or read_summary(self._source)
            self.header = header or self._read_header()
            self._extent = self._read_extent()
            self._steady = self.metadata.get("steady_clock") == "1"
        except BaseException:
            self._source.close()
            raise
        self._channels = _match(self._summary, channel_specs(self.header.table))
        self._types = {id: spec.type for id, spec in self._channels.items() if spec.type}
        self._by_topic = {spec.topic: id for id, spec in self._channels.items()}
        self._frame_channel = self._by_topic.get(FRAME_TOPIC, _NO_CHANNEL)
        self._raw_channel = self._by_topic.get(RAW_TOPIC, _NO_CHANNEL)

    @property
    def bytes_read(self) -> int:
        """How much of the file was read so far."""
        return self._source.bytes_read

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of the recording as a whole, beyond the header; empty where it does not."""
        return self._read_metadata(EXTENT_METADATA) or {}

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    def frames(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Frame]:
        """Stream the frames; see `Reader.frames`. With `sparse`, durations are unknown (NaN)."""
        for batch in self.batches(types, sparse=sparse, start=start, stop=stop):
            for frame in batch:
                yield frame
                self._source.check_open()

    def batches(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Batch]:
        """Stream the frames in batches; see `Reader.batches`. With `sparse`, durations are unknown (NaN)."""
        self._source.check_open()
        start, stop = start - SAME_TIME, stop - SAME_TIME
        wanted = self._wanted(types, spine=not sparse)
        chunks = self._chunks(wanted, start, stop)
        plans = _Plans(self._plan, wanted, whole=types is None)
        batches = self._gather(chunks, wanted, None if sparse else plans, (start, stop))
        for batch in within(batches, start, stop):
            yield batch
            self._source.check_open()

    def frame_at(self, elapsed: float) -> Frame | None:
        """The last frame that begins at or before a time; see `Reader.frame_at`."""
        elapsed += SAME_TIME
        found = None
        spine = self._wanted((), spine=True)
        plans = _Plans(self._plan, spine, whole=False)
        time = LogClock(self.header).at(elapsed)
        chunks = self._chunks(spine)
        if time is not None and self._steady:
            apart = all(a.end < b.start for a, b in itertools.pairwise(chunks))
            chunks = [chunk for chunk in chunks if chunk.start <= time]
            if apart:
                # Of a chunk that begins at that very nanosecond, the frame may still come later.
                chunks = chunks[max(sum(chunk.start < time for chunk in chunks) - 1, 0) :]
        for batch in self._gather(chunks, spine, plans):
            earlier = np.flatnonzero(batch.elapsed <= elapsed)
            if len(earlier):
                found = batch.frame(int(earlier[-1]))
        if found is None:
            return None
        for frame in self.frames(start=found.elapsed):
            if frame.index == found.index:
                return frame
        raise FormatError(self.path, None, f"frame {found.id} is in no chunk of its time: the index is wrong")

    def extent(self) -> Extent:
        """How far the recording goes."""
        if self._extent is None:
            extent = Extent()
            for frame in self.frames(()):
                if not frame.preamble:
                    extent = Extent(extent.frames + 1, frame.id, frame.elapsed)
            self._extent = extent
        return self._extent

    def tail(self) -> Iterator[bytes]:
        """The bytes behind the last complete packet, in pieces."""
        return (bytes(message.data) for message in self._messages(TAIL_TOPIC, "tail", TAIL_MESSAGE))

    def stretches(self, min_time: float, min_distance: float) -> list[BlockedRow] | None:
        """The stretches in which actors stood still, read from the events; see `Reader.stretches`."""
        least, distance, count = _summed_up(self.metadata)
        if min_time < least or min_distance != distance:
            return None
        messages = self._messages(STRETCHES_TOPIC, "stretches", STRETCHES_MESSAGE)
        rows = [row for message in messages for row in message.stretches]
        if len(rows) != count:  # another program has left some out
            return None
        return [
            BlockedRow(row.start, row.duration, row.id, row.type_id, row.x, row.y, row.z)
            for row in rows
            if row.duration >= min_time
        ]

    def _messages(self, topic: str, module: str, name: str) -> Iterator[Any]:
        """Yield the messages of a topic that no frame holds."""
        self._source.check_open()
        channel = self._by_topic.get(topic)
        wanted = set() if channel is None else {channel}
        for chunk in self._chunks(wanted) if wanted else []:
            gathered: Pending = {}
            self._scatter(self._runs_in(chunk, self._open(chunk)), wanted, gathered)
            for _, found in gathered.values():
                yield from (self._parse(module, name, _message(one)) for one in found)

    # --- what the file says of itself ----------------------------------------------------------------------------------

    def _read_metadata(self, name: str) -> dict[str, str] | None:
        offset = self._summary.metadata.get(name)
        if offset is None:
            return None
        content = self._source.record(offset, Opcode.METADATA, f"the metadata {name}", METADATA_LIMIT)
        try:
            return unchecked(parse_record(Opcode.METADATA, content)[1])
        except ValueError as error:
            raise FormatError(self.path, offset, f"broken MCAP metadata {name!r}: {error}") from None

    def _read_header(self) -> Header:
        metadata = self._read_metadata(HEADER_METADATA)
        if metadata is None and EXPORT_METADATA in self._summary.metadata:
            raise NotARecording(self.path, "is an export for a viewer; the recording that it was made from was expected")
        if metadata is None:
            raise NotARecording(self.path, f"holds no recording (MCAP metadata {HEADER_METADATA!r} is missing)")
        try:
            return parse_header(metadata)
        except (KeyError, ValueError) as error:
            raise FormatError(self.path, None, f"broken MCAP metadata {HEADER_METADATA!r}: {error}") from None

    def _read_extent(self) -> Extent | None:
        metadata = self._read_metadata(EXTENT_METADATA)
        try:
            return parse_extent(metadata) if metadata else None
        except (KeyError, ValueError) as error:
            raise FormatError(self.path, None, f"broken MCAP metadata {EXTENT_METADATA!r}: {error}") from None

    # --- chunks to messages --------------------------------------------------------------------------------------------

    def _wanted(self, types: Iterable[str] | None, *, spine: bool) -> set[int]:
        """The channels to read."""
        if types is None:
            return {id for id, spec in self._channels.items() if spec.topic not in (TAIL_TOPIC, STRETCHES_TOPIC)}
        names = {self.header.table.named(name).name for name in types}
        wanted = {id for id, type in self._types.items() if type.name in names}
        if spine:
            wanted |= {self._frame_channel} & self._channels.keys()
        return wanted

    def _chunks(self, wanted: set[int], start: float = -math.inf, stop: float = math.inf) -> list[Chunk]:
        """The chunks that hold wanted channels within a time, in order of time."""
        clock = LogClock(self.header)
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

    def _opened(self, chunks: list[Chunk], *, ahead: bool) -> Iterator[bytes]:
        """The records of some chunks; `ahead`: the next one is unpacked while this one is used."""
        if not ahead or len(chunks) < 2:
            yield from map(self._open, chunks)
            return
        from concurrent.futures import ThreadPoolExecutor  # a small recording has no second chunk

        with ThreadPoolExecutor(1, "carla-recap-reader") as pool:
            coming = pool.submit(self._open, chunks[0])
            for chunk in chunks[1:]:
                opened = coming.result()
                coming = pool.submit(self._open, chunk)
                yield opened
            yield coming.result()

    def _open(self, chunk: Chunk) -> bytes:
        data = self._source.read(chunk.offset, chunk.length, "a chunk")
        opcode, size = RECORD.unpack_from(data) if len(data) >= RECORD.size else (0, 0)
        if opcode != Opcode.CHUNK or RECORD.size + size != chunk.length:
            raise FormatError(self.path, chunk.offset, f"a chunk of {chunk.length} bytes was expected")
        try:
            return open_chunk(memoryview(data)[RECORD.size :])[2]
        except ValueError as error:
            raise FormatError(
                self.path, chunk.offset, f"damaged chunk: {error}; 'carla-recap recover' saves the rest"
            ) from None

    def _blocks(self, chunks: list[Chunk], *, ahead: bool) -> Iterator[list[tuple[Chunk, bytes]]]:
        """Chunks with their records; small ones several at a time."""
        block: list[tuple[Chunk, bytes]] = []
        size = 0
        for chunk, data in zip(chunks, self._opened(chunks, ahead=ahead), strict=True):
            block.append((chunk, data))
            size += len(data)
            if size >= BLOCK_SIZE:
                yield block
                block, size = [], 0
        if block:
            yield block

    def _runs_in(self, chunk: Chunk, data: bytes) -> Iterator[MessageRun]:
        """Yield the frames of a chunk's records, those together that are alike."""
        try:
            yield from message_runs(data, self._frame_channel)
        except BrokenRecords as error:
            raise FormatError(self.path, chunk.offset, f"damaged chunk: {error}") from None

    def _scatter(self, runs: Iterable[MessageRun], wanted: set[int], pending: Pending) -> int:
        """Add the messages of runs to those of their frames, one by one; return how many that were."""
        found: dict[int, ChannelMessages] = {}
        for run in runs:
            places = [place for place in run.slots if place[0] in wanted]
            for row in range(run.count if places else 0):
                for place in places:
                    channel = place[0]
                    if channel not in found:
                        found[channel] = ChannelMessages(channel, self._types.get(channel), self.path)
                    of_channel = found[channel]
                    item = of_channel, len(of_channel.messages)
                    of_channel.messages.append(run.message(row, place))
                    sequence = run.sequence + row
                    if sequence in pending:
                        pending[sequence][1].append(item)
                    else:
                        pending[sequence] = (int(run.times[row]), [item])
        return sum(len(of_channel.messages) for of_channel in found.values())

    def _gather(
        self,
        chunks: list[Chunk],
        wanted: set[int],
        plans: _Plans | None,
        period: tuple[float, float] = (-math.inf, math.inf),
    ) -> Iterator[Batch]:
        """Yield the frames in order; chunks may overlap in time.

        Args:
            chunks: The chunks, in order of time.
            wanted: The channels to read.
            plans: How to put frames together; None: of each message that there is, without the frames' own.
            period: Elapsed times in seconds within which frames are expected to be complete.
        """
        pending: Pending = {}
        waiting: list[tuple[MessageRun, Batch]] = []
        held: list[_Held] = []
        # A message takes 16 bytes in the index alone: a file with many more of them than bytes was made to cost time.
        allowance = 2 * MESSAGES_LIMIT + self._source.size // 4
        place = 0
        for block in self._blocks(chunks, ahead=plans is not None):
            messages = 0
            single: list[MessageRun] = []
            for chunk, data in block:
                for run in self._runs_in(chunk, data):
                    messages += run.count * len(run.slots)
                    batch = self._alike(run, plans) if plans is not None and run.count > 1 else None
                    if batch is None:
                        single.append(run)
                    else:
                        waiting.append((run, batch))
                    if messages > MESSAGES_LIMIT:
                        raise self._too_much(chunk)
            self._scatter(single, wanted, pending)
            waiting = self._apart(waiting, wanted, pending)
            latest = max((time for time, _ in pending.values()), default=0)
            latest = max(latest, *(int(run.times[-1]) for run, _ in waiting)) if waiting else latest
            held.append(_Held(latest, sum(len(data) for _, data in block), messages))
            allowance -= messages
            if allowance < 0:
                raise FormatError(self.path, block[-1][0].offset, "more messages than a file of this size can mean")
            if sum(h.size for h in held) > PENDING_LIMIT or sum(h.messages for h in held) > MESSAGES_LIMIT:
                raise self._too_much(block[-1][0])
            place += len(block)
            horizon = chunks[place].start if place < len(chunks) else None
            ready: list[tuple[int, Batch | None]] = [
                (sequence, None) for sequence, (time, _) in pending.items() if horizon is None or time < horizon
            ]
            ready += self._complete(waiting, horizon)
            for sequence, alike in sorted(ready, key=itemgetter(0)):
                if alike is not None:
                    yield alike
                    continue
                try:
                    yield self._single(sequence, pending.pop(sequence)[1], plans, period)
                except FormatError:
                    if not self._salvage:
                        raise
            held = [h for h in held if horizon is not None and h.last >= horizon]

    def _apart(
        self, waiting: list[tuple[MessageRun, Batch]], wanted: set[int], pending: Pending
    ) -> list[tuple[MessageRun, Batch]]:
        """Return the batches none of whose frames has messages elsewhere; the frames of the others become pending."""
        twice, stop = set(), -1
        for run, _ in sorted(waiting, key=lambda each: each[0].sequence):
            if run.sequence < stop:  # another run has the frame, too, as of a chunk that is there twice
                twice.add(id(run))
            stop = max(stop, run.sequence + run.count)
        self._scatter([run for run, _ in waiting if id(run) in twice], wanted, pending)
        waiting = [each for each in waiting if id(each[0]) not in twice]
        if not pending:
            return waiting
        numbers = sorted(pending)
        kept = []
        for run, batch in waiting:
            first = bisect_left(numbers, run.sequence)
            if first < len(numbers) and numbers[first] < run.sequence + run.count:
                self._scatter([run], wanted, pending)
            else:
                kept.append((run, batch))
        return kept

    @staticmethod
    def _complete(waiting: list[tuple[MessageRun, Batch]], horizon: int | None) -> list[tuple[int, Batch]]:
        """Take the frames that begin before a time out of those that wait."""
        ready, rest = [], []
        for run, batch in waiting:
            count = run.count if horizon is None else int(np.searchsorted(run.times, horizon))
            if count:
                ready.append((run.sequence, batch[:count] if count < run.count else batch))
            if count < run.count:
                rest.append((run.after(count), batch[count:]))
        waiting[:] = rest
        return ready

    def _alike(self, run: MessageRun, plans: _Plans) -> Batch | None:
        """Return the frames of a run as a batch; None where they have to be put together one by one."""
        spines = [place for place in run.slots if place[0] == self._frame_channel]
        start = messages.HEAD.size + messages.FRAME_BODY.size
        if len(spines) != 1 or spines[0][2] < start:
            return None
        frames = run.view(messages.FRAME_HEAD, spines[0][1])[:, 0]
        if not messages.have_heads(frames):
            return None
        preamble, plan = plans.of(bytes(run.message(0, spines[0])[start:]))
        if preamble:
            return None
        of_channel = {place[0]: place for place in run.slots}
        columns: list[Column] = []
        for step in plan:
            if not isinstance(step, int):
                columns.append(ConstantColumn(step, run.count))
                continue
            if step not in of_channel or step == self._raw_channel or sum(place[0] == step for place in run.slots) > 1:
                return None
            try:
                columns.append(column(self._types[step], run, of_channel.pop(step)))
            except ValueError:
                return None
        return Batch(run.sequence, frames["frame"], frames["elapsed"], frames["duration"], columns)

    def _single(self, index: int, gathered: Gathered, plans: _Plans | None, period: tuple[float, float]) -> Batch:
        """Return a frame as a batch of its own."""
        return Batch.of(self._headless(index, gathered) if plans is None else self._frame(index, gathered, plans, period))

    def _too_much(self, chunk: Chunk) -> FormatError:
        limits = f"{PENDING_LIMIT} bytes or {MESSAGES_LIMIT} messages"
        return FormatError(self.path, chunk.offset, f"more than {limits} of chunks overlap in time")

    # --- messages to frames --------------------------------------------------------------------------------------------

    def _frame(self, index: int, gathered: Gathered, plans: _Plans, period: tuple[float, float]) -> Frame:
        """Return a frame of the messages that were gathered, which are expected to be all there within a period."""
        queues: dict[int, deque[Found]] = {}
        for found in gathered:
            channel = found[0].channel
            if channel in queues:
                queues[channel].append(found)
            else:
                queues[channel] = deque((found,))
        if self._frame_channel not in queues:
            return self._headless(index, gathered)
        spine = _message(queues[self._frame_channel][0])
        id, elapsed, duration, preamble, plan = self._read_spine(spine, plans)
        packets: list[Packet] = []
        lost = False
        for step in plan:
            if step.__class__ is not int:
                packets.append(step)
                continue
            queue = queues.get(step)
            if not queue:
                lost = True
            elif step == self._raw_channel:
                packets.append(self._raw_packet(queue))
            else:
                packets.append(MessagePacket(self._types[step], *queue.popleft()))
        if lost and not (elapsed < period[0] or elapsed >= period[1] < math.inf):
            self._warn_lost(id)
        return Frame(index, id, elapsed, duration, packets, preamble=preamble)

    def _headless(self, index: int, gathered: Gathered) -> Frame:
        """A frame without its own message: left out by a sparse read, or lost."""
        packets: list[Packet] = [
            MessagePacket(batch.type, batch, place) for batch, place in gathered if batch.type is not None
        ]
        first = _message(gathered[0])
        id, elapsed = messages.read_head(first) or self._slow_head(gathered[0][0].channel, first)
        return Frame(index, id, elapsed, math.nan, packets)

    def _read_spine(self, data: memoryview, plans: _Plans) -> tuple[int, float, float, bool, list[Any]]:
        """Return id, elapsed and duration of a `Frame`; whether it is a preamble; and the plan to put it together."""
        fast = messages.read_frame(data)
        if fast is None:
            message = self._parse("frame", FRAME_MESSAGE, data)
            id, elapsed, duration = message.frame, message.elapsed, message.duration
            rest = messages.frame_packets(message.packets, message.filled)
        else:
            id, elapsed, duration, rest = fast
        return id, elapsed, duration, *plans.of(rest)

    def _plan(self, rest: bytes, wanted: set[int], whole: bool) -> tuple[bool, list[Any]]:
        """Whether packets are a preamble; and for each of them that is wanted, itself, or the channel to take it from."""
        try:
            message = messages.parse("frame", FRAME_MESSAGE, rest)
        except messages.WireError as error:
            raise FormatError(self.path, None, str(error)) from None
        ids, kinds = message.packets, message.filled
        steps = [self._step(id, kind) for id, kind in zip(ids, kinds, strict=False) if id != FRAME_START]
        kept = [step for step in steps if whole or (isinstance(step, int) and step in wanted)]
        return not ids.startswith(bytes((FRAME_START,))), kept

    def _step(self, id: int, kind: int) -> Packet | int:
        table = self.header.table
        type: RecordType | None = table[id] if id < len(table) else None
        if kind == EMPTY:
            return Packet(id, type, b"" if id == FRAME_END else EMPTY_LIST)
        if kind == FILLED and type is not None:
            return self._by_topic.get(type.topic, _NO_CHANNEL)
        return self._raw_channel

    def _raw_packet(self, queue: deque[Found]) -> Packet:
        message = self._parse("raw_packet", RAW_MESSAGE, _message(queue.popleft()))
        pieces = [message.data]
        missing = message.size - len(message.data)
        while missing > 0 and queue:
            pieces.append(self._parse("raw_packet", RAW_MESSAGE, _message(queue.popleft())).data)
            missing -= len(pieces[-1])
        if not FRAME_START < message.id <= 0xFF:
            raise FormatError(self.path, None, f"a raw packet of id {message.id}; 1 to 255 were expected")
        table = self.header.table
        type = table[message.id] if message.id < len(table) else None
        return Packet(message.id, type, b"".join(pieces), place=(self.path, None))

    def _slow_head(self, channel: int, data: memoryview) -> tuple[int, float]:
        spec = self._channels[channel]
        message = self._parse(spec.module, spec.message, data)
        return message.frame, message.elapsed

    def _parse(self, module: str, name: str, data: memoryview) -> Any:
        try:
            return messages.parse(module, name, data)
        except messages.WireError as error:
            raise FormatError(self.path, None, str(error)) from None

    def _warn_lost(self, frame: int) -> None:
        if "lost" not in self._warned:
            self._warned.add("lost")
            warnings.warn(
                f"{self.path}: messages of frame {frame}, and maybe of others, are missing",
                RecapWarning,
                stacklevel=2,
            )


def _message(found: Found) -> memoryview:
    batch, index = found
    return batch.messages[index]


def _summed_up(metadata: dict[str, str]) -> tuple[float, float, int]:
    """From how many seconds and cm on stretches are summed up, and how many there are."""
    try:
        least, distance, count = metadata[STRETCHES].split()
        return float(least), float(distance), int(count)
    except (KeyError, ValueError):
        return math.inf, math.nan, 0


def _match(summary: Summary, specs: list[ChannelSpec]) -> dict[int, ChannelSpec]:
    """The file's channels that are ours, by id."""
    known = {(spec.topic, spec.message): spec for spec in specs}
    found: dict[int, ChannelSpec] = {}
    for id, channel in summary.channels.items():
        spec = known.pop((channel.topic, summary.schemas.get(channel.schema, "")), None)
        if spec is not None and channel.encoding == "protobuf":
            found[id] = spec
    return found
