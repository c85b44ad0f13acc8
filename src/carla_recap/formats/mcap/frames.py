"""Frames, put together from the messages of chunks.

The messages of a frame have its position in the recording as their sequence number. Those of state and of events are in
different chunks, which overlap in time; in files of other writers a frame may be spread over any number of chunks.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import defaultdict
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from carla_recap.errors import FormatError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.codec import decode, records_codec
from carla_recap.formats.mcap.runs import BrokenRecords, column, message_runs
from carla_recap.formats.mcap.schema import EMPTY, FILLED, FRAME_MESSAGE, FRAME_TOPIC, FRAMELESS, RAW_MESSAGE, RAW_TOPIC
from carla_recap.model.batch import Batch, ConstantColumn
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.layout import EMPTY_LIST, pack
from carla_recap.model.records import FRAME_END, FRAME_START

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

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

    def __init__(self, channel: int, type: RecordType | None, location: str) -> None:
        self.channel = channel
        self.type = type
        self.location = location
        self.messages: list[memoryview] = []

    @cached_property
    def records(self) -> list[NDArray[np.void]] | None:
        """The records of all messages; None where each message is to be decoded by itself."""
        return records_codec(self.type).decode(self.messages) if self.type is not None and self.type.fixed else None


class MessagePacket(Packet):
    """A packet that came as a message, decoded on first use."""

    __slots__ = ("_index", "_source")

    def __init__(self, source: ChannelMessages, index: int) -> None:
        assert source.type is not None
        self.id, self.type = source.type.id, source.type
        self._payload = self._records = self._part = None
        self._origin = source.location, None
        self._source = source
        self._index = index

    @property
    def payload(self) -> Buffer:
        """The bytes behind the packet header."""
        if self._payload is None:
            together = self._source.records
            assert self.type
            try:
                if together is not None:
                    self._payload = pack(self.type, together[self._index])
                else:
                    self._payload = decode(self.type, self._source.messages[self._index])
            except codec.WireError as error:
                raise self._broken(error) from None
        return self._payload

    @property
    def records(self) -> Records:
        """The records."""
        together = self._source.records
        return super().records if together is None else together[self._index]

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
        steps: Its packets; of those that come as messages, the channel.
    """

    preamble: bool
    steps: list[Packet | int]


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
    """Puts the frames of a read together, of at most `allowance` messages.

    `warn` is called with the id of a frame without all of its messages; with `lenient`, frames that contradict their schema
    are left out.
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
        self._runs: list[MessageRun] = []  # of frames that may have further messages, in the order of the file
        self._plans: dict[tuple[bytes, bytes], _Plan] = {}

    def add(self, chunks: list[tuple[ChunkIndex, bytes]]) -> None:
        """Take in the messages of some chunks, or raise `FormatError`."""
        wanted = self._selection.channels
        held = sum(run.number * len(run.slots) for run in self._runs)
        for chunk, data in chunks:
            try:
                for run in message_runs(data, self._channels.frames):
                    messages = run.number * len(run.slots)
                    held += messages
                    self._allowance -= messages
                    if held > MESSAGES_LIMIT:
                        raise self._too_much(chunk)
                    if slots := tuple(slot for slot in run.slots if slot[0] in wanted):
                        self._runs.append(run._replace(slots=slots))
            except BrokenRecords as error:
                raise FormatError(self._location, chunk.offset, f"damaged chunk: {error}") from None
        if self._allowance < 0:
            raise FormatError(self._location, chunks[-1][0].offset, "more messages than a file of this size can mean")
        if sum(map(len, {id(run.data): run.data for run in self._runs}.values())) > PENDING_LIMIT:
            raise self._too_much(chunks[-1][0])

    def complete(self, horizon: int | None) -> Iterator[Batch]:
        """Yield the frames that are complete, in order: those before the first log time in ns of chunks to come, if any are.

        Raises:
            FormatError: A frame contradicts its schema.
        """
        ready, rest = [], []
        for run in self._runs:
            count = run.number if horizon is None else run.number_before(horizon)
            if count:
                ready.append(run.part(0, count))
            if count < run.number:
                rest.append(run.part(count, run.number))
        self._runs = rest
        sources: dict[int, ChannelMessages] = {}
        found: list[tuple[int, Batch | list[Found]]] = []
        for runs in _of_same_frames(ready):
            alone = len(runs) == 1 and runs[0].number > 1 and not self._selection.sparse
            batch = self._alike(runs[0]) if alone else None
            found += self._split(runs, sources) if batch is None else [(batch.index, batch)]
        for sequence, each in found:
            try:
                yield each if isinstance(each, Batch) else Batch.of(self._frame(sequence, each))
            except FormatError:
                if not self._lenient:
                    raise

    def _split(self, runs: list[MessageRun], sources: dict[int, ChannelMessages]) -> Iterator[tuple[int, list[Found]]]:
        """Yield the number of each frame of some runs, and its messages, after adding these to those of their channels."""
        for row in range(runs[0].number):
            found: list[Found] = []
            for run in runs:
                start = run.start + row * run.stride
                for channel, offset, size in run.slots:
                    source = sources.get(channel)
                    if source is None:
                        type = self._channels.types.get(channel)
                        source = sources[channel] = ChannelMessages(channel, type, self._location)
                    found.append((source, len(source.messages)))
                    source.messages.append(run.data[start + offset : start + offset + size])
            yield runs[0].sequence + row, found

    def _too_much(self, chunk: ChunkIndex) -> FormatError:
        limits = f"{PENDING_LIMIT} bytes or {MESSAGES_LIMIT} messages"
        return FormatError(self._location, chunk.offset, f"more than {limits} of chunks overlap in time")

    # --- frames --------------------------------------------------------------------------------------------------------

    def _alike(self, run: MessageRun) -> Batch | None:
        """Return the frames of a run as a batch; None where they have to be put together one by one."""
        slots = {slot[0]: slot for slot in run.slots}
        own = slots.get(self._channels.frames)
        if own is None or own[2] < codec.FRAME_HEAD.itemsize or len(slots) < len(run.slots):
            return None
        heads = run.view(codec.FRAME_HEAD, own[1])[:, 0]
        columns: list[Column] = []
        try:
            found = codec.read_frame(run.message(0, own))
            if found is None or not codec.have_heads(heads):
                return None
            plan = self._plan(*found[3:])
            for step in plan.steps:
                if isinstance(step, Packet):
                    columns.append(ConstantColumn(step, run.number))
                elif step in slots and step != self._channels.raw:
                    columns.append(column(self._channels.types[step], run, slots.pop(step)))
                else:
                    return None
        except ValueError:
            return None
        return None if plan.preamble else Batch(run.sequence, heads["frame"], heads["elapsed"], heads["duration"], columns)

    def _frame(self, index: int, found: list[Found]) -> Frame:
        """Return the frame of some messages."""
        waiting: dict[int, list[Found]] = {}  # by channel, the first one last
        for each in reversed(found):
            waiting.setdefault(each[0].channel, []).append(each)
        own, read = waiting.get(self._channels.frames), self._selection
        if own is None or read.sparse:
            return self._frame_of_messages(index, found)
        id, elapsed, duration, *kept = self._read_frame(_data(own[-1]))
        plan, raw = self._plan(*kept), self._channels.raw
        packets: list[Packet] = []
        for step in plan.steps:
            if isinstance(step, Packet):
                packets.append(step)
            elif messages := waiting.get(step):
                packets.append(self._raw_packet(messages) if step == raw else MessagePacket(*messages.pop()))
        if len(packets) < len(plan.steps) and not (elapsed < read.start or elapsed >= read.stop < math.inf):
            self._warn(id)
        return Frame(index, id, elapsed, duration, packets, preamble=plan.preamble)

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

    def _read_frame(self, data: memoryview) -> tuple[int, float, float, bytes, bytes]:
        """Return what the message of a frame says; see `codec.read_frame`."""
        found = codec.read_frame(data)
        if found is None:
            message = parsed(self._location, "frame", FRAME_MESSAGE, data)
            found = message.frame, message.elapsed, message.duration, message.packets, message.filled
        return found

    def _plan(self, ids: bytes, kinds: bytes) -> _Plan:
        """Return how to put a frame of some packets together."""
        plan = self._plans.get((ids, kinds))
        if plan is None:
            if len(self._plans) > _PLANS:
                self._plans.clear()
            steps = [self._step(id, kind) for id, kind in zip(ids, kinds, strict=False) if id != FRAME_START]
            read = self._selection
            kept = [step for step in steps if read.whole or (isinstance(step, int) and step in read.channels)]
            plan = self._plans[ids, kinds] = _Plan(not ids.startswith(bytes((FRAME_START,))), kept)
        return plan

    def _step(self, id: int, kind: int) -> Packet | int:
        table = self._channels.table
        type: RecordType | None = table[id] if id < len(table) else None
        if kind == EMPTY:
            return Packet(id, type, b"" if id == FRAME_END else EMPTY_LIST)
        if kind == FILLED and type is not None:
            return self._channels.of(type.topic)
        return self._channels.raw

    def _raw_packet(self, waiting: list[Found]) -> Packet:
        """Return a packet of raw pieces, and take these out of those that wait."""
        message = parsed(self._location, "raw_packet", RAW_MESSAGE, _data(waiting.pop()))
        pieces = [message.data]
        missing = message.size - len(message.data)
        while missing > 0 and waiting:
            pieces.append(parsed(self._location, "raw_packet", RAW_MESSAGE, _data(waiting.pop())).data)
            missing -= len(pieces[-1])
        if not FRAME_START < message.id <= 0xFF:
            raise FormatError(self._location, None, f"expected a raw packet of an id from 1 to 255, found {message.id}")
        table = self._channels.table
        type = table[message.id] if message.id < len(table) else None
        return Packet(message.id, type, b"".join(pieces), origin=(self._location, None))


def _of_same_frames(runs: list[MessageRun]) -> Iterator[list[MessageRun]]:
    """Cut runs at each other's ends; yield the pieces of the same frames together, in the order of the frames."""
    ends = sorted({end for run in runs for end in (run.sequence, run.sequence + run.number)})
    pieces: defaultdict[int, list[MessageRun]] = defaultdict(list)
    for run in runs:
        if run.number == 1:
            pieces[run.sequence].append(run)
            continue
        first, last = bisect_left(ends, run.sequence), bisect_left(ends, run.sequence + run.number)
        for start, stop in pairwise(ends[first : last + 1]):
            pieces[start].append(run.part(start - run.sequence, stop - run.sequence))
    return (pieces[start] for start in sorted(pieces))


def channel_messages(location: str, chunk: ChunkIndex, data: bytes, channel: int) -> Iterator[memoryview]:
    """Yield the messages of a channel in a chunk, or raise `FormatError`."""
    try:
        for run in message_runs(data, _NO_CHANNEL):
            slots = [slot for slot in run.slots if slot[0] == channel]
            yield from (run.message(row, slot) for row in range(run.number) for slot in slots)
    except BrokenRecords as error:
        raise FormatError(location, chunk.offset, f"damaged chunk: {error}") from None


def parsed(location: str, module: str, name: str, data: Buffer) -> Any:
    """Return a message, parsed by protobuf, or raise `FormatError`; see `codec.parse`."""
    try:
        return codec.parse(module, name, data)
    except codec.WireError as error:
        raise FormatError(location, None, str(error)) from None


def _data(found: Found) -> memoryview:
    source, index = found
    return source.messages[index]
