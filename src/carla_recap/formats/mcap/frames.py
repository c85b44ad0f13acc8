"""Frames, put together from the messages of chunks.

The messages of a frame have its position in the recording as their sequence number. Those of state and of events are in
different chunks, which overlap in time; in files of other writers a frame may be spread over any number of chunks.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from carla_recap.errors import FormatError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.codec import decode
from carla_recap.formats.mcap.runs import BrokenRecords, column, message_runs
from carla_recap.formats.mcap.schema import EMPTY, FILLED, FRAME_MESSAGE, FRAME_TOPIC, FRAMELESS, RAW_MESSAGE, RAW_TOPIC
from carla_recap.model.batch import Batch, ConstantColumn
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.layout import EMPTY_LIST
from carla_recap.model.records import FRAME_END, FRAME_START

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from carla_recap.formats.mcap.index import ChunkIndex
    from carla_recap.formats.mcap.runs import MessageRun
    from carla_recap.formats.mcap.schema import ChannelSpec
    from carla_recap.model.batch import Column
    from carla_recap.model.layout import Buffer, PayloadError
    from carla_recap.model.records import RecordType, Table

MESSAGES_LIMIT: Final = 500_000
"""The most messages of frames that are not complete yet; ours are some hundreds."""
PENDING_LIMIT: Final = 256 << 20
"""The most bytes of chunks that overlap in time and are in memory at once; ours overlap by 5 s of recording."""

_PLANS: Final = 4096  # kept at once
_NO_CHANNEL: Final = -1


class Channels:
    """The channels of a file that are those of a recording."""

    def __init__(self, specs: dict[int, ChannelSpec], table: Table) -> None:
        self.specs = specs
        self.table = table
        self.types = {id: spec.type for id, spec in specs.items() if spec.type}  # of each channel that has one
        self._by_topic = {spec.topic: id for id, spec in specs.items()}
        self.frames = self.of(FRAME_TOPIC)  # the channel of the frames' own messages; -1 where the file has none
        self.raw = self.of(RAW_TOPIC)  # the channel of packets without a message of their own; -1 where the file has none

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


class MessagePacket(Packet):
    """A packet that came as a message, decoded on first use."""

    __slots__ = ("_data",)

    def __init__(self, type: RecordType, location: str, data: memoryview) -> None:
        super().__init__(type.id, type, origin=(location, None))
        self._data = data

    @property
    def payload(self) -> Buffer:
        """The bytes behind the packet header."""
        if self._payload is None:
            assert self.type
            try:
                self._payload = decode(self.type, self._data)
            except codec.WireError as error:
                raise self._broken(error) from None
        return self._payload

    def error(self, error: PayloadError) -> FormatError:
        """Return the error of a payload, kept in the message as it is, that contradicts its layout."""
        return self._broken(error)

    def _broken(self, error: ValueError) -> FormatError:
        head, (location, _) = codec.read_head(self._data), self._origin or ("", None)
        name = self.type.topic if self.type else ""
        where = f"{name} of frame {head[0]}" if head else name
        return FormatError(location, None, f"{where}: {error}")


Found = tuple[int, memoryview]  # a message: its channel, and its data


class _Plan(NamedTuple):
    """How to put a frame together."""

    preamble: bool  # whether these are packets before the first frame starts
    steps: list[Packet | int]  # its packets; of those that come as messages, the channel


class ReadSelection(NamedTuple):
    """What is read."""

    channels: set[int]
    whole: bool = False  # whether all packets are wanted, empty ones too
    sparse: bool = False  # whether frames are wanted for their messages alone; their own messages are not read
    start: float = -math.inf  # the elapsed time in seconds from which on frames are expected to be complete
    stop: float = math.inf  # the elapsed time in seconds until which they are


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
        self._stop = 0  # the position behind the last frame so far

    def add(self, chunk: ChunkIndex, data: bytes) -> None:
        """Take in the messages of a chunk, or raise `FormatError`."""
        wanted = self._selection.channels
        held = sum(run.number * len(run.slots) for run in self._runs)
        before = (-1, 0)  # sequence and time of the frame before
        try:
            for run in message_runs(data, self._channels.frames):
                messages = run.number * len(run.slots)
                held += messages
                self._allowance -= messages
                if held > MESSAGES_LIMIT:
                    raise self._too_much(chunk)
                if any(slot[0] in self._channels.specs for slot in run.slots):
                    if before[0] == run.sequence and before[1] != run.time:
                        if not self._lenient:
                            text = f"the messages at position {run.sequence} have several log times"
                            raise FormatError(self._location, chunk.offset, text)
                        run = run._replace(time=before[1])
                    before = run.sequence, run.time
                is_listed = not chunk.channels or chunk.channels.issuperset(slot[0] for slot in run.slots)
                if not is_listed or not chunk.start <= run.time <= chunk.end:
                    text = "a chunk has messages of channels or times that it has not in the index: the index is wrong"
                    raise FormatError(self._location, chunk.offset, text)
                if slots := tuple(slot for slot in run.slots if slot[0] in wanted):
                    self._runs.append(run._replace(slots=slots))
        except BrokenRecords as error:
            raise FormatError(self._location, chunk.offset, f"damaged chunk: {error}") from None
        if self._allowance < 0:
            raise FormatError(self._location, chunk.offset, "more messages than a file of this size can mean")
        if sum(map(len, {id(run.data): run.data for run in self._runs}.values())) > PENDING_LIMIT:
            raise self._too_much(chunk)

    def complete(self, horizon: int | None) -> Iterator[Batch]:
        """Yield the frames that are complete, in order: those before the first log time in ns of chunks to come, if any."""
        ready, rest = [], []
        for run in self._runs:
            count = run.number if horizon is None else run.number_before(horizon)
            if count:
                ready.append(run.part(0, count))
            if count < run.number:
                rest.append(run.part(count, run.number))
        self._runs = rest
        for runs in _of_same_frames(ready):
            first = runs[0]
            if first.sequence < self._stop and not self._lenient:
                text = f"messages of frame {first.sequence} come after those of frame {self._stop - 1}"
                raise FormatError(self._location, None, f"{text}; 'carla-recap recover' saves what it can")
            self._stop = first.sequence + first.number
            alone = len(runs) == 1 and first.number > 1 and not self._selection.sparse
            if alone and (batch := self._alike(first)) is not None:
                yield batch
                continue
            for row in range(first.number):
                try:
                    found = [(slot[0], run.message(row, slot)) for run in runs for slot in run.slots]
                    yield Batch.of(self._frame(first.sequence + row, found))
                except FormatError:
                    if not self._lenient:
                        raise

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
            head = run.bytes_at(own[1], codec.HEAD.size)
            if any((run.bytes_at(offset, codec.HEAD.size) != head).any() for _, offset, _ in run.slots):
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
        is_plain = not plan.preamble and slots.keys() == {self._channels.frames}
        return None if not is_plain else Batch(run.sequence, heads["frame"], heads["elapsed"], heads["duration"], columns)

    def _frame(self, index: int, found: list[Found]) -> Frame:
        """Return the frame of some messages."""
        waiting: dict[int, list[memoryview]] = {}  # by channel, the first one last
        for channel, data in reversed(found):
            waiting.setdefault(channel, []).append(data)
        own, read = waiting.get(self._channels.frames), self._selection
        if read.sparse or (own is None and (self._lenient or self._channels.frames not in self._channels.specs)):
            return self._frame_of_messages(index, found)
        if own is None:
            frame = self._frame_of_messages(index, found)
            if frame.elapsed < read.start or frame.elapsed >= read.stop:
                return frame  # its own message may be in a chunk that is not read
            raise FormatError(self._location, None, f"the messages at position {index} have no frame")
        id, elapsed, duration, *kept = self._read_frame(own[-1])
        plan, raw = self._plan(*kept), self._channels.raw
        packets: list[Packet] = []
        for step in plan.steps:
            if isinstance(step, Packet):
                packets.append(step)
            elif messages := waiting.get(step):
                packets.append(self._raw_packet(messages) if step == raw else self._packet(step, messages.pop()))
        if not self._lenient and (fault := self._fault(index, plan, waiting)):
            raise FormatError(self._location, None, f"frame {id} {fault}; 'carla-recap recover' saves what it can")
        if not self._lenient and any(_is_of_another(data, id, elapsed) for _, data in found):
            raise FormatError(self._location, None, f"frame {id} has messages of another frame or time")
        if len(packets) < len(plan.steps) and not (elapsed < read.start or elapsed >= read.stop < math.inf):
            self._warn(id)
        return Frame(index, id, elapsed, duration, packets, preamble=plan.preamble)

    def _fault(self, index: int, plan: _Plan, left: dict[int, list[memoryview]]) -> str:
        """Return how a frame contradicts what it says of itself, in words, given the messages that are in no packet."""
        left[self._channels.frames].pop()
        if any(left.values()):
            return "has messages that are not among its packets"
        return "has no start, and is not the first one" if plan.preamble and index else ""

    def _frame_of_messages(self, index: int, found: list[Found]) -> Frame:
        """Return a frame without its own message, which is not read, or lost."""
        packets: list[Packet] = [self._packet(*each) for each in found if each[0] in self._channels.types]
        channel, data = found[0]
        head = codec.read_head(data)
        if head is None:
            spec = self._channels.specs[channel]
            message = parsed(self._location, spec.module, spec.message, data)
            head = message.frame, message.elapsed
        return Frame(index, *head, math.nan, packets)

    def _packet(self, channel: int, data: memoryview) -> Packet:
        return MessagePacket(self._channels.types[channel], self._location, data)

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

    def _raw_packet(self, waiting: list[memoryview]) -> Packet:
        """Return a packet of raw pieces, and take these out of those that wait."""
        message = parsed(self._location, "raw_packet", RAW_MESSAGE, waiting.pop())
        pieces = [message.data]
        missing = message.size - len(message.data)
        while missing > 0 and waiting:
            pieces.append(parsed(self._location, "raw_packet", RAW_MESSAGE, waiting.pop()).data)
            missing -= len(pieces[-1])
        if not FRAME_START < message.id <= 0xFF:
            raise FormatError(self._location, None, f"expected a raw packet of an id from 1 to 255, found {message.id}")
        table = self._channels.table
        type = table[message.id] if message.id < len(table) else None
        return Packet(message.id, type, b"".join(pieces), origin=(self._location, None))


def _is_of_another(data: memoryview, id: int, elapsed: float) -> bool:
    """Return whether a message says, at its start, that it is of another frame."""
    head = codec.read_head(data)
    return head is not None and (head[0] != id or (head[1] != elapsed and not math.isnan(elapsed)))


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
