"""Frames, put together from the messages of chunks.

The messages of a frame have its position in the recording as their sequence number. Those of state and of events are in
different chunks, which overlap in time; in files of other writers a frame may be spread over any number of chunks.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import FormatError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.codec import decode, records_codec
from carla_recap.formats.mcap.runs import BrokenRecords, column, message_runs
from carla_recap.formats.mcap.schema import (
    EMPTY,
    FILLED,
    FRAME_MESSAGE,
    FRAME_TOPIC,
    FRAMELESS,
    RAW_MESSAGE,
    RAW_TOPIC,
)
from carla_recap.model.batch import Batch, ConstantColumn
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.layout import EMPTY_LIST
from carla_recap.model.records import FRAME_END, FRAME_START

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from carla_recap.formats.mcap.codec import Payloads
    from carla_recap.formats.mcap.index import ChunkIndex
    from carla_recap.formats.mcap.runs import MessageRun
    from carla_recap.formats.mcap.schema import ChannelSpec
    from carla_recap.model.batch import Column
    from carla_recap.model.layout import Buffer, PayloadError, Records
    from carla_recap.model.records import RecordType, Table

MESSAGES_LIMIT: Final = 500_000
"""The most messages of frames that are not complete yet; ours are some hundreds."""
PENDING_LIMIT: Final = 256 << 20
"""The most bytes of chunks that overlap in time and are in memory at once; ours overlap by 5 s of recording."""

_PLANS: Final = 4096  # kept at once
_NO_CHANNEL: Final = -1


class Channels:
    """The channels of a file that are those of a recording.

    Args:
        specs: The channels by id.
        table: The record types of the recording.

    Attributes:
        frames: The channel of the frames' own messages; -1 where the file has none.
        raw: The channel of packets without a message of their own; -1 where the file has none.
        types: The record type of each channel that has one.
    """

    def __init__(self, specs: dict[int, ChannelSpec], table: Table) -> None:
        self.specs = specs
        self.table = table
        self.types = {id: spec.type for id, spec in specs.items() if spec.type}
        self._by_topic = {spec.topic: id for id, spec in specs.items()}
        self.frames = self.of(FRAME_TOPIC)
        self.raw = self.of(RAW_TOPIC)

    def of(self, topic: str) -> int:
        """Return the channel of a topic; -1 where the file has none."""
        return self._by_topic.get(topic, _NO_CHANNEL)

    def wanted(self, types: Iterable[str] | None, *, frames: bool) -> set[int]:
        """Return the channels of some record types, and of the frames' own messages; of all packets for None."""
        if types is None:
            return {id for id, spec in self.specs.items() if spec.topic not in FRAMELESS}
        names = {self.table.named(name).name for name in types}
        wanted = {id for id, type in self.types.items() if type.name in names}
        return wanted | ({self.frames} & self.specs.keys()) if frames else wanted


class ChannelMessages:
    """The messages of a channel in some chunks; those whose records have one size are decoded together."""

    __slots__ = ("channel", "decoded", "location", "messages", "payloads", "type")

    def __init__(self, channel: int, type: RecordType | None, location: str) -> None:
        self.channel = channel
        self.type = type
        self.location = location
        self.messages: list[memoryview] = []
        self.payloads: Payloads | None = None
        self.decoded = False

    def decode(self) -> Payloads | None:
        """Return all payloads; None where each message is to be decoded by itself."""
        if not self.decoded:
            self.decoded = True
            if self.type is not None and self.type.fixed:
                self.payloads = records_codec(self.type).decode(self.messages)
        return self.payloads


class MessagePacket(Packet):
    """A packet that came as a message, decoded on first use."""

    __slots__ = ("_index", "_source")

    def __init__(self, source: ChannelMessages, index: int) -> None:
        type = source.type
        assert type is not None
        self.id = type.id
        self.type = type
        self._source = source
        self._index = index
        self._payload = self._records = None
        self._origin = (source.location, None)

    @property
    def payload(self) -> Buffer:
        """The bytes behind the packet header.

        Raises:
            FormatError: The message contradicts its schema.
        """
        if self._payload is None:
            payloads = self._source.payloads or self._source.decode()
            if payloads is not None:
                return payloads.payload(self._index)
            assert self.type
            try:
                self._payload = decode(self.type, self._source.messages[self._index])
            except codec.WireError as error:
                raise self._broken(error) from None
        return self._payload

    @property
    def records(self) -> Records:
        """The records.

        Raises:
            FormatError: The message contradicts its schema.
        """
        if self._records is None:
            payloads = self._source.payloads or self._source.decode()
            if payloads is not None:
                return payloads.records(self._index)
            assert self.type
            if self._payload is None:
                self._records = codec.decode_objects(self.type, self._source.messages[self._index])
        return super().records

    def error(self, error: PayloadError) -> FormatError:
        """Return the error of a payload, kept in the message as it is, that contradicts its layout."""
        return self._broken(error)

    def _broken(self, error: ValueError) -> FormatError:
        head = codec.read_head(self._source.messages[self._index])
        name = self.type.topic if self.type else ""
        where = f"{name} of frame {head[0]}" if head else name
        return FormatError(self._source.location, None, f"{where}: {error}")


Found = tuple[ChannelMessages, int]  # a message: those of its channel, and its index among them


class _Plan(NamedTuple):
    """How to put a frame together.

    Attributes:
        preamble: Whether these are packets before the first frame starts.
        packets: The packets; None for each that comes as a message.
        steps: The index of each of these, and its channel.
    """

    preamble: bool
    packets: list[Packet | None]
    steps: list[tuple[int, int]]


class _PendingChunks(NamedTuple):
    """Chunks of which some frames are not complete yet.

    Attributes:
        last: The log time of the last frame, in ns.
        size: Bytes of their records.
        messages: The number of messages.
    """

    last: int
    size: int
    messages: int


class ReadSelection(NamedTuple):
    """What is read.

    Attributes:
        channels: The channels.
        whole: Whether all packets are wanted, empty ones too.
        sparse: Whether frames are wanted for their messages alone; their own messages are not read.
        start: The elapsed time in seconds from which on frames are expected to be complete.
        stop: The elapsed time in seconds until which they are.
    """

    channels: set[int]
    whole: bool = False
    sparse: bool = False
    start: float = -math.inf
    stop: float = math.inf


class FrameAssembler:
    """Puts the frames of a read together.

    Args:
        location: The path or URL of the file, for messages.
        channels: The channels of the file.
        selection: What is read.
        allowance: The most messages that are accepted.
        warn: Called with the id of a frame of which messages are missing.
        lenient: Leave out frames that contradict their schema.
    """

    def __init__(
        self,
        location: str,
        channels: Channels,
        selection: ReadSelection,
        allowance: int,
        warn: Callable[[int], None],
        *,
        lenient: bool = False,
    ) -> None:
        self._location = location
        self._channels = channels
        self._selection = selection
        self._allowance = allowance
        self._warn = warn
        self._lenient = lenient
        self._pending: dict[int, tuple[int, list[Found]]] = {}  # by sequence number: log time and messages
        self._waiting: list[tuple[MessageRun, Batch]] = []
        self._blocks: list[_PendingChunks] = []
        self._plans: dict[bytes, _Plan] = {}

    def add(self, chunks: list[tuple[ChunkIndex, bytes]]) -> None:
        """Take in the messages of some chunks.

        Raises:
            FormatError: The chunks are damaged, or more of them overlap than fit in memory.
        """
        count = 0
        single: list[MessageRun] = []
        for chunk, data in chunks:
            for run in self._runs(chunk, data):
                count += run.number * len(run.slots)
                batch = self._alike(run) if run.number > 1 and not self._selection.sparse else None
                if batch is None:
                    single.append(run)
                else:
                    self._waiting.append((run, batch))
                if count > MESSAGES_LIMIT:
                    raise self._too_much(chunk)
        self._split(single)
        self._resolve()
        last = max((time for time, _ in self._pending.values()), default=0)
        last = max(last, *(int(run.times[-1]) for run, _ in self._waiting)) if self._waiting else last
        self._blocks.append(_PendingChunks(last, sum(len(data) for _, data in chunks), count))
        self._allowance -= count
        chunk = chunks[-1][0]
        if self._allowance < 0:
            raise FormatError(self._location, chunk.offset, "more messages than a file of this size can mean")
        blocks = self._blocks
        if sum(b.size for b in blocks) > PENDING_LIMIT or sum(b.messages for b in blocks) > MESSAGES_LIMIT:
            raise self._too_much(chunk)

    def complete(self, horizon: int | None) -> Iterator[Batch]:
        """Yield the frames that are complete, in order.

        Args:
            horizon: The first log time in ns of the chunks that are still to come; None if none are.

        Raises:
            FormatError: A frame contradicts its schema.
        """
        ready: list[tuple[int, Batch | None]] = [
            (sequence, None) for sequence, (time, _) in self._pending.items() if horizon is None or time < horizon
        ]
        ready += self._complete_batches(horizon)
        for sequence, batch in sorted(ready, key=itemgetter(0)):
            if batch is not None:
                yield batch
                continue
            try:
                yield Batch.of(self._frame(sequence, self._pending.pop(sequence)[1]))
            except FormatError:
                if not self._lenient:
                    raise
        self._blocks = [block for block in self._blocks if horizon is not None and block.last >= horizon]

    # --- messages ------------------------------------------------------------------------------------------------------

    def _runs(self, chunk: ChunkIndex, data: bytes) -> Iterator[MessageRun]:
        try:
            yield from message_runs(data, self._channels.frames)
        except BrokenRecords as error:
            raise FormatError(self._location, chunk.offset, f"damaged chunk: {error}") from None

    def _split(self, runs: Iterable[MessageRun]) -> None:
        """Add the messages of runs to those of their frames, one by one."""
        found: dict[int, ChannelMessages] = {}
        pending, wanted = self._pending, self._selection.channels
        for run in runs:
            slots = [slot for slot in run.slots if slot[0] in wanted]
            if not slots:
                continue
            data, start = run.data, run.start
            for sequence, time in enumerate(run.times.tolist() if run.number > 1 else [run.time], run.sequence):
                of_frame: list[Found] = []
                for channel, offset, size in slots:
                    source = found.get(channel)
                    if source is None:
                        source = found[channel] = ChannelMessages(channel, self._channels.types.get(channel), self._location)
                    of_frame.append((source, len(source.messages)))
                    source.messages.append(data[start + offset : start + offset + size])
                if sequence in pending:
                    pending[sequence][1].extend(of_frame)
                else:
                    pending[sequence] = time, of_frame
                start += run.stride

    def _resolve(self) -> None:
        """Split the batches some of whose frames have messages elsewhere, too."""
        twice, stop = set(), -1
        for run, _ in sorted(self._waiting, key=lambda each: each[0].sequence):
            if run.sequence < stop:  # another run has the frame, too, as of a chunk that is in the file twice
                twice.add(id(run))
            stop = max(stop, run.sequence + run.number)
        self._split([run for run, _ in self._waiting if id(run) in twice])
        waiting = [each for each in self._waiting if id(each[0]) not in twice]
        numbers = sorted(self._pending)
        self._waiting = []
        for run, batch in waiting:
            first = bisect_left(numbers, run.sequence)
            if first < len(numbers) and numbers[first] < run.sequence + run.number:
                self._split([run])
            else:
                self._waiting.append((run, batch))

    def _complete_batches(self, horizon: int | None) -> list[tuple[int, Batch]]:
        """Take the frames that begin before a time out of those that wait."""
        ready, rest = [], []
        for run, batch in self._waiting:
            count = run.number if horizon is None else int(np.searchsorted(run.times, horizon))
            if count:
                ready.append((run.sequence, batch[:count] if count < run.number else batch))
            if count < run.number:
                rest.append((run.after(count), batch[count:]))
        self._waiting = rest
        return ready

    def _too_much(self, chunk: ChunkIndex) -> FormatError:
        limits = f"{PENDING_LIMIT} bytes or {MESSAGES_LIMIT} messages"
        return FormatError(self._location, chunk.offset, f"more than {limits} of chunks overlap in time")

    # --- frames --------------------------------------------------------------------------------------------------------

    def _alike(self, run: MessageRun) -> Batch | None:
        """Return the frames of a run as a batch; None where they have to be put together one by one."""
        channels = self._channels
        slots = {slot[0]: slot for slot in run.slots}
        counts = Counter(slot[0] for slot in run.slots)
        own = slots.get(channels.frames)
        start = codec.FRAME_HEAD.itemsize
        if own is None or own[2] < start or counts[channels.frames] > 1:
            return None
        heads = run.view(codec.FRAME_HEAD, own[1])[:, 0]
        if not codec.have_heads(heads):
            return None
        plan = self._plan(bytes(run.message(0, own)[start:]))
        steps = [channel for _, channel in plan.steps]
        if plan.preamble or channels.raw in steps or len({*steps}) < len(steps) or any(counts[step] != 1 for step in steps):
            return None
        columns: list[Column] = [ConstantColumn(packet, run.number) for packet in plan.packets if packet is not None]
        try:
            for position, channel in plan.steps:
                columns.insert(position, column(channels.types[channel], run, slots[channel]))
        except ValueError:
            return None
        return Batch(run.sequence, heads["frame"], heads["elapsed"], heads["duration"], columns)

    def _frame(self, index: int, found: list[Found]) -> Frame:
        """Return the frame of some messages."""
        first = {each[0].channel: each for each in reversed(found)}
        own = first.get(self._channels.frames)
        if own is None or self._selection.sparse:
            return self._frame_of_messages(index, found)
        rest: dict[int, list[Found]] = {}  # what comes after the first message of each channel, in reverse order
        for each in reversed(found) if len(first) < len(found) else ():
            if each is not first[each[0].channel]:
                rest.setdefault(each[0].channel, []).append(each)
        id, elapsed, duration, plan = self._read_frame(_data(own))
        packets = plan.packets.copy()
        for position, channel in plan.steps:
            message = first.pop(channel, None)
            if message is None:
                continue
            if channel == self._channels.raw:
                packets[position] = self._raw_packet(message, rest.get(channel, []))
            else:
                packets[position] = MessagePacket(*message)
            if rest and rest.get(channel):
                first[channel] = rest[channel].pop()
        whole, read = [packet for packet in packets if packet is not None], self._selection
        if len(whole) < len(packets) and not (elapsed < read.start or elapsed >= read.stop < math.inf):
            self._warn(id)
        return Frame(index, id, elapsed, duration, whole, preamble=plan.preamble)

    def _frame_of_messages(self, index: int, found: list[Found]) -> Frame:
        """Return a frame without its own message, which is not read, or lost."""
        packets: list[Packet] = [MessagePacket(source, row) for source, row in found if source.type is not None]
        data = _data(found[0])
        head = codec.read_head(data)
        if head is None:
            spec = self._channels.specs[found[0][0].channel]
            message = parsed(self._location, spec.module, spec.message, data)
            head = message.frame, message.elapsed
        return Frame(index, *head, math.nan, packets)

    def _read_frame(self, data: memoryview) -> tuple[int, float, float, _Plan]:
        """Return id, elapsed and duration of a `Frame`, and the plan to put it together."""
        found = codec.read_frame(data)
        if found is None:
            message = parsed(self._location, "frame", FRAME_MESSAGE, data)
            packets = codec.frame_packets(message.packets, message.filled)
            found = message.frame, message.elapsed, message.duration, packets
        id, elapsed, duration, packets = found
        return id, elapsed, duration, self._plan(packets)

    def _plan(self, packets: bytes) -> _Plan:
        """Return the plan for what `codec.frame_packets` wrote."""
        plan = self._plans.get(packets)
        if plan is None:
            if len(self._plans) > _PLANS:
                self._plans.clear()
            found = codec.read_frame_packets(packets)
            if found is None:
                message = parsed(self._location, "frame", FRAME_MESSAGE, packets)
                found = message.packets, message.filled
            ids, kinds = found
            steps = [self._step(id, kind) for id, kind in zip(ids, kinds, strict=False) if id != FRAME_START]
            kept = [
                step
                for step in steps
                if self._selection.whole or (isinstance(step, int) and step in self._selection.channels)
            ]
            plan = self._plans[packets] = _Plan(
                not ids.startswith(bytes((FRAME_START,))),
                [None if isinstance(step, int) else step for step in kept],
                [(position, step) for position, step in enumerate(kept) if isinstance(step, int)],
            )
        return plan

    def _step(self, id: int, kind: int) -> Packet | int:
        table = self._channels.table
        type: RecordType | None = table[id] if id < len(table) else None
        if kind == EMPTY:
            return Packet(id, type, b"" if id == FRAME_END else EMPTY_LIST)
        if kind == FILLED and type is not None:
            return self._channels.of(type.topic)
        return self._channels.raw

    def _raw_packet(self, first: Found, rest: list[Found]) -> Packet:
        """Return a packet of raw pieces, and take those after the first one out of the rest."""
        message = parsed(self._location, "raw_packet", RAW_MESSAGE, _data(first))
        pieces = [message.data]
        missing = message.size - len(message.data)
        while missing > 0 and rest:
            pieces.append(parsed(self._location, "raw_packet", RAW_MESSAGE, _data(rest.pop())).data)
            missing -= len(pieces[-1])
        if not FRAME_START < message.id <= 0xFF:
            raise FormatError(self._location, None, f"a raw packet of id {message.id}; 1 to 255 were expected")
        table = self._channels.table
        type = table[message.id] if message.id < len(table) else None
        return Packet(message.id, type, b"".join(pieces), origin=(self._location, None))


def channel_messages(location: str, chunk: ChunkIndex, data: bytes, channel: int) -> Iterator[memoryview]:
    """Yield the messages of a channel in a chunk.

    Raises:
        FormatError: The chunk is damaged.
    """
    try:
        for run in message_runs(data, _NO_CHANNEL):
            slots = [slot for slot in run.slots if slot[0] == channel]
            yield from (run.message(row, slot) for row in range(run.number) for slot in slots)
    except BrokenRecords as error:
        raise FormatError(location, chunk.offset, f"damaged chunk: {error}") from None


def parsed(location: str, module: str, name: str, data: Buffer) -> Any:
    """Return a message, parsed by protobuf; see `codec.parse`.

    Raises:
        FormatError: It is none of that name, or too large to parse.
    """
    try:
        return codec.parse(module, name, data)
    except codec.WireError as error:
        raise FormatError(location, None, str(error)) from None


def _data(found: Found) -> memoryview:
    source, index = found
    return source.messages[index]
