"""Who stood still, since when, and for how long."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.queries.answer import Answer, readable
from carla_recap.queries.roster import Roster

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.frame import Frame
    from carla_recap.records import Spawn

_TYPES: Final = ("spawned", "destroyed", "transforms")


@dataclass(frozen=True, slots=True)
class BlockedRow:
    """A stretch of time in which an actor stayed where it was.

    Attributes:
        start: When it began, in seconds since the recording began.
        duration: How long it lasted, in seconds.
        id: The actor.
        type_id: Its blueprint, such as `vehicle.audi.tt`; empty for an actor whose spawn is not recorded.
        x: Where it stood, in cm, left-handed.
        y: The same, to the right.
        z: The same, upwards.
    """

    start: float
    duration: float
    id: int
    type_id: str
    x: float
    y: float
    z: float


class Blocked(Answer[BlockedRow]):
    """The stretches in which actors of a recording stood still, the longest first."""

    row_type = BlockedRow


def blocked(
    source: Reader, min_time: float = 30.0, min_distance: float = 10.0, *, compat: bool = False
) -> Blocked:
    """The actors that stood still.

    An actor stands still while it stays within a distance of the place where it last moved to. Everything with a
    recorded transform counts: vehicles, walkers, props, the spectator.

    Args:
        source: The recording.
        min_time: The shortest stretch to tell of, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        compat: Answer as CARLA 0.9.16 does, with its slips.

    Raises:
        FormatError: The file contradicts its format.
    """
    real = source.header.table.named("transforms").dtype["x"]
    with np.errstate(all="ignore"):
        watch = _Watch(real, min_time, min_distance, compat=compat)
        for frame in source.frames(_TYPES, sparse=True):
            watch.frame(frame)
        return Blocked(watch.finish(), source, compat=compat)


@dataclass(slots=True)
class _Actor:
    slot: int
    type_id: str


# The rows of the state: the place where an actor last moved to, and the stretch since then, of duration 0 if there is none.
_PLACE: Final = slice(0, 3)
_START: Final = 3
_DURATION: Final = 4
_STATE_ROWS: Final = 5


class _Watch:
    """Follows the actors through the frames.

    The state of each actor is a column of one array, its slot. The actors of a transforms packet are taken out of it as a
    `_Group`, which is kept for as long as packets list the same ids.
    """

    def __init__(self, real: np.dtype[Any], min_time: float, min_distance: float, *, compat: bool) -> None:
        self._min_time = min_time
        self._reach = _not_below(min_distance, real)
        self._compat = compat
        self._roster = Roster[_Actor](compat=compat)
        self._state = np.zeros((_STATE_ROWS, 64))
        self._free = list(range(self._state.shape[1]))
        self._rows: list[BlockedRow] = []
        self._group: _Group | None = None

    def frame(self, frame: Frame) -> None:
        """Take in a frame."""
        for packet in frame.packets:
            assert packet.type is not None
            if packet.type.name == "transforms":
                assert isinstance(packet.records, np.ndarray)
                self._move(frame, packet.records)
                continue
            self._put_back()
            if packet.type.name == "spawned":
                for spawn in packet.records:
                    self._spawn(spawn)
            else:
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    self._destroy(id)

    def finish(self) -> list[BlockedRow]:
        """All stretches that are long enough."""
        self._put_back()
        left = list(self._roster.actors.items())
        if not self._compat:
            rows = [*self._rows, *self._long_enough(left)]
            return sorted(rows, key=lambda row: (-row.duration, row.start, row.id))
        # CARLA goes through a hash table, whose latest entry comes first.
        return sorted([*self._rows, *self._long_enough(left[::-1])], key=lambda row: -row.duration)

    def _spawn(self, spawn: Spawn) -> None:
        known = self._roster.actors.get(spawn.id)
        slot = known.slot if known else self._take_slot()
        self._state[:, slot] = 0.0
        self._roster.spawn(spawn.id, _Actor(slot, readable(spawn.type_id)))

    def _destroy(self, id: int) -> None:
        actor = self._roster.destroy(id)
        if actor:
            if not self._compat:
                self._rows += self._long_enough([(id, actor)])
            self._free.append(actor.slot)

    def _take_slot(self) -> int:
        if not self._free:
            count = self._state.shape[1]
            self._state = np.concatenate((self._state, np.zeros_like(self._state)), axis=1)
            self._free = list(range(count, 2 * count))
        slot = self._free.pop()
        self._state[:, slot] = 0.0
        return slot

    def _long_enough(self, actors: list[tuple[int, _Actor]]) -> Iterator[BlockedRow]:
        for id, actor in actors:
            x, y, z, start, duration = self._state[:, actor.slot].tolist()
            if duration >= self._min_time:
                yield BlockedRow(start, duration, id, actor.type_id, x, y, z)

    def _move(self, frame: Frame, records: NDArray[np.void]) -> None:
        ids = records["id"]
        key = ids.tobytes()
        length = frame.duration if self._compat or frame.duration > 0 else 0.0
        if self._group is None or key != self._group.key:
            self._put_back()
            numbers = ids.tolist()
            if len(set(numbers)) < len(numbers):
                self._move_repeated(frame, length, records)
                return
            self._group = self._take_out(key, numbers)
        moved = self._group.move(records, frame.elapsed, length, self._min_time)
        self._rows += [row for _, row in moved]

    def _move_repeated(self, frame: Frame, length: float, records: NDArray[np.void]) -> None:
        """A packet that lists actors several times: first the first records of all, then the second ones, and so on."""
        moved = []
        for places in _rounds(records["id"]):
            part = records[places]
            self._group = self._take_out(b"", part["id"].tolist())
            for place, row in self._group.move(part, frame.elapsed, length, self._min_time):
                moved.append((int(places[place]), row))
            self._put_back()
        self._rows += [row for _, row in sorted(moved, key=lambda item: item[0])]

    def _take_out(self, key: bytes, ids: list[int]) -> _Group:
        actors = []
        for id in ids:
            actor = self._roster.actors.get(id)
            if actor is None:
                actor = self._roster.actors[id] = _Actor(self._take_slot(), "")
            actors.append(actor)
        slots = np.array([actor.slot for actor in actors], np.intp)
        return _Group(key, ids, actors, slots, self._state[:, slots], self._reach)

    def _put_back(self) -> None:
        if self._group:
            self._group.state[_PLACE] = self._group.place
            self._state[:, self._group.slots] = self._group.state
            self._group = None


class _Group:
    """Some actors, all different, in the order in which packets list them.

    Args:
        key: The ids, as bytes.
        ids: The ids.
        actors: The actors.
        slots: The columns of the whole state that they come from.
        state: These columns.
        reach: The distance at which an actor has moved, in cm; in the precision of lengths in the file, in which CARLA
            works out distances.
    """

    def __init__(
        self,
        key: bytes,
        ids: list[int],
        actors: list[_Actor],
        slots: NDArray[np.intp],
        state: NDArray[np.float64],
        reach: np.floating[Any],
    ) -> None:
        self.key = key
        self.slots = slots
        self.state = state
        self.place = state[_PLACE].astype(reach.dtype)
        self._ids = ids
        self._actors = actors
        self._start = state[_START]
        self._duration = state[_DURATION]
        self._now = np.empty_like(self.place)
        self._squares = np.empty_like(self.place)
        self._x2, self._y2, self._z2 = self._squares
        self._none = np.zeros_like(self._duration)
        self._still, self._flags = np.empty((2, len(ids)), np.bool_)

    def move(self, records: NDArray[np.void], elapsed: float, length: float) -> list[tuple[int, BlockedRow]]:
        """Take in where the actors are in a frame.

        Args:
            records: The transforms.
            elapsed: When the frame begins, in seconds.
            length: How long it is, in seconds.

        Returns:
            The stretches that ended and are long enough, each with its record's number.
        """
        now, distance, still, flags, duration = self._now, self._x2, self._still, self._flags, self._duration
        now[0] = records["x"]
        now[1] = records["y"]
        now[2] = records["z"]
        np.subtract(now, self.place, out=self._squares)
        np.multiply(self._squares, self._squares, out=self._squares)
        np.add(self._x2, self._y2, out=distance)
        np.add(distance, self._z2, out=distance)
        np.less(distance, self._reach, out=still)
        np.equal(duration, self._none, out=flags)
        np.logical_and(flags, still, out=flags)
        if _any(flags):
            self._start[flags] = elapsed
        moves = np.logical_not(still, out=still)
        if not _any(moves):
            duration += length
            return []
        np.greater_equal(duration, self._min_time, out=flags)
        np.logical_and(flags, moves, out=flags)
        ended = [(number, self._row(number)) for number in np.flatnonzero(flags).tolist()] if _any(flags) else []
        duration += length
        duration[moves] = 0.0
        np.copyto(self.place, now, where=moves)
        return ended

    def _row(self, number: int) -> BlockedRow:
        place = self.place[:, number].tolist()
        start, duration = float(self._start[number]), float(self._duration[number])
        return BlockedRow(start, duration, self._ids[number], self._actors[number].type_id, *place)


def _rounds(ids: NDArray[np.uint32]) -> list[NDArray[np.intp]]:
    """The places of the first record of each id, of the second one, and so on."""
    order = np.argsort(ids, kind="stable")
    ranks = np.arange(len(ids))
    first = np.append(True, np.diff(ids[order]) != 0)
    number = np.empty_like(ranks)
    number[order] = ranks - np.maximum.accumulate(np.where(first, ranks, 0))
    return np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])


def _square_of_reach(distance: float, real: np.dtype[Any]) -> np.floating[Any]:
    """The smallest square whose root, as computed in some precision, is not below a distance."""
    zero, infinity = real.type(0.0), real.type(math.inf)
    square = np.square(real.type(max(distance, 0.0)))
    while square > zero and float(np.sqrt(np.nextafter(square, zero))) >= distance:
        square = np.nextafter(square, zero)
    while float(np.sqrt(square)) < distance and square < infinity:
        square = np.nextafter(square, infinity)
    return square


def _any(flags: NDArray[np.bool_]) -> bool:
    """`flags.any()`, several times as fast for a few hundred."""
    return b"\1" in flags.tobytes()
