"""Who stood still, since when, and for how long."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.queries.answer import Answer, readable
from carla_recap.queries.roster import Roster

if TYPE_CHECKING:
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
        watch = _Watch(min_time, _square_of_reach(min_distance, real), compat=compat)
        for frame in source.frames(_TYPES, sparse=True):
            watch.frame(frame)
        return Blocked(watch.finish(), source, compat=compat)


@dataclass(slots=True)
class _Actor:
    id: int
    type_id: str
    slot: int  # its column of the state

    def row(self, state: NDArray[np.float64]) -> BlockedRow:
        x, y, z, start, duration = state[:, self.slot].tolist()
        return BlockedRow(start, duration, self.id, self.type_id, x, y, z)


# The rows of the state: the place where an actor last moved to, and its stretch, of duration 0 where there is none.
_PLACE: Final = slice(0, 3)
_START: Final = 3
_DURATION: Final = 4
_STATE_ROWS: Final = 5


class _Watch:
    """Follows the actors through the frames.

    The state of each actor is a column of one array. The actors of a transforms packet are taken out of it as a
    `_Group`, which is kept for as long as the packets list the same ids.

    Args:
        min_time: The shortest stretch to tell of, in seconds.
        square_of_reach: See `_square_of_reach`.
        compat: Answer as CARLA does.
    """

    def __init__(self, min_time: float, square_of_reach: np.floating[Any], *, compat: bool) -> None:
        self._min_time = min_time
        self._square_of_reach = square_of_reach
        self._compat = compat
        self._roster = Roster[_Actor](compat=compat)
        self._state = np.zeros((_STATE_ROWS, 64))
        self._free = list(range(64))
        self._rows: list[BlockedRow] = []
        self._group: _Group | None = None
        self._rounds: tuple[bytes, list[NDArray[np.intp]]] = (b"", [])  # of the ids of the last packet

    def frame(self, frame: Frame) -> None:
        """Take in a frame."""
        for packet in frame.packets:
            assert packet.type is not None
            if packet.type.name == "transforms":
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
        left = [actor.row(self._state) for actor in self._roster.actors.values() if self._is_long(actor)]
        if self._compat:
            # CARLA goes through a hash table, whose latest entry comes first.
            return sorted(self._rows + left[::-1], key=lambda row: -row.duration)
        return sorted(self._rows + left, key=lambda row: (-row.duration, row.start, row.id))

    def _is_long(self, actor: _Actor) -> bool:
        return bool(self._state[_DURATION, actor.slot] >= self._min_time)

    def _spawn(self, spawn: Spawn) -> None:
        known = self._roster.actors.get(spawn.id)
        if known:
            self._free.append(known.slot)
        self._roster.spawn(spawn.id, self._new(spawn.id, readable(spawn.type_id)))

    def _destroy(self, id: int) -> None:
        actor = self._roster.destroy(id)
        if actor:
            if self._is_long(actor) and not self._compat:
                self._rows.append(actor.row(self._state))
            self._free.append(actor.slot)

    def _new(self, id: int, type_id: str) -> _Actor:
        if not self._free:
            count = self._state.shape[1]
            self._state = np.concatenate((self._state, np.zeros_like(self._state)), axis=1)
            self._free = list(range(count, 2 * count))
        slot = self._free.pop()
        self._state[:, slot] = 0.0
        return _Actor(id, type_id, slot)

    def _move(self, frame: Frame, records: NDArray[np.void]) -> None:
        length = frame.duration if self._compat or frame.duration > 0.0 else 0.0
        ids = records["id"]
        key = ids.tobytes()
        group = self._group
        if group is None or group.key != key:
            if key != self._rounds[0]:
                self._rounds = key, _rounds(ids)
            if len(self._rounds[1]) > 1:
                self._move_repeated(frame.elapsed, length, records)
                return
            group = self._take_out(key, ids)
        ended = group.move(records, frame.elapsed, length)
        if ended:
            self._rows += [row for _, row in ended]

    def _move_repeated(self, elapsed: float, length: float, records: NDArray[np.void]) -> None:
        """Take in a packet that lists actors repeatedly: the first record of each, then the second ones, and so on."""
        ended = []
        for places in self._rounds[1]:
            part = records[places]
            key = part["id"].tobytes()
            group = self._group
            if group is None or group.key != key:
                group = self._take_out(key, part["id"])
            ended += [(places[number], row) for number, row in group.move(part, elapsed, length)]
        self._rows += [row for _, row in sorted(ended, key=lambda item: item[0])]

    def _take_out(self, key: bytes, ids: NDArray[np.uint32]) -> _Group:
        self._put_back()
        actors = []
        for id in ids.tolist():
            actor = self._roster.actors.get(id)
            if actor is None:
                actor = self._roster.actors[id] = self._new(id, "")
            actors.append(actor)
        self._group = _Group(key, actors, self._state, self._min_time, self._square_of_reach)
        return self._group

    def _put_back(self) -> None:
        if self._group:
            self._group.put_back(self._state)
            self._group = None


class _Group:
    """The actors that a transforms packet lists, all different.

    Args:
        key: Their ids, as bytes.
        actors: The actors.
        state: The state of all actors, from which theirs is copied; here, the durations of those that do not stand are
            without meaning.
        min_time: The shortest stretch to tell of, in seconds.
        square_of_reach: See `_square_of_reach`.
    """

    def __init__(
        self,
        key: bytes,
        actors: list[_Actor],
        state: NDArray[np.float64],
        min_time: float,
        square_of_reach: np.floating[Any],
    ) -> None:
        self.key = key
        self._actors = actors
        self._slots = np.array([actor.slot for actor in actors], np.intp)
        self._state = state[:, self._slots]
        self._place = self._state[_PLACE].astype(square_of_reach.dtype)
        self._start = self._state[_START]
        self._duration = self._state[_DURATION]
        self._stood = self._duration != 0.0
        self._careful = bool((self._duration < 0.0).any())
        self._min_time = min_time
        # Results go to arrays that are there already: that halves the time that numpy takes for so few actors.
        self._square_of_reach = np.full_like(self._place[0], square_of_reach)
        self._now = np.empty_like(self._place)
        self._squares = np.empty_like(self._place)
        self._x2, self._y2, self._z2 = self._squares
        self._still, self._flags = np.empty((2, len(actors)), np.bool_)

    def put_back(self, state: NDArray[np.float64]) -> None:
        """Copy the actors' state back into that of all actors."""
        self._state[_PLACE] = self._place
        self._duration[~self._stood] = 0.0
        state[:, self._slots] = self._state

    def move(self, records: NDArray[np.void], elapsed: float, length: float) -> list[tuple[int, BlockedRow]]:
        """Take in where the actors are in a frame.

        Args:
            records: The transforms.
            elapsed: When the frame begins, in seconds.
            length: How long it is, in seconds.

        Returns:
            The stretches that ended and are long enough, each with its record's number.
        """
        now, square, duration = self._now, self._x2, self._duration
        still, stood, flags = self._still, self._stood, self._flags
        now[0] = records["x"]
        now[1] = records["y"]
        now[2] = records["z"]
        np.subtract(now, self._place, out=self._squares)
        np.multiply(self._squares, self._squares, out=self._squares)
        np.add(square, self._y2, out=square)
        np.add(square, self._z2, out=square)
        np.less(square, self._square_of_reach, out=still)
        ended = []
        changed = np.not_equal(still, stood, out=flags).nonzero()[0]
        if len(changed):
            stops = still[changed]
            begins = changed[stops]
            self._start[begins] = elapsed
            duration[begins] = 0.0
            ended = self._rows(changed[~stops])
        moves = np.logical_not(still, out=flags)
        if self._min_time <= 0.0:
            duration[~stood] = 0.0
            ended = self._rows(moves.nonzero()[0])
        np.copyto(self._place, now, where=moves)
        duration += length
        # A stretch whose duration is back at 0 begins anew; with lengths above 0, there is none.
        self._careful = self._careful or not length > 0.0
        if self._careful:
            still &= duration != 0.0
        self._still, self._stood = stood, still
        return ended

    def _rows(self, ends: NDArray[np.intp]) -> list[tuple[int, BlockedRow]]:
        rows = []
        for number in ends[self._duration[ends] >= self._min_time].tolist():
            actor, place = self._actors[number], self._place[:, number].tolist()
            start, duration = self._start[number].item(), self._duration[number].item()
            rows.append((number, BlockedRow(start, duration, actor.id, actor.type_id, *place)))
        return rows


def _rounds(ids: NDArray[np.uint32]) -> list[NDArray[np.intp]]:
    """The places of the first record of each id, of the second one, and so on."""
    order = np.argsort(ids, kind="stable")
    ranks = np.arange(len(ids))
    first = np.append(True, np.diff(ids[order]) != 0)
    number = np.empty_like(ranks)
    number[order] = ranks - np.maximum.accumulate(np.where(first, ranks, 0))
    return np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])


def _square_of_reach(distance: float, real: np.dtype[Any]) -> np.floating[Any]:
    """The smallest square whose root is not below a distance.

    To compare squares with it is as good, to the last bit, as to compare roots with the distance, in the precision of the
    file's lengths, which is that of CARLA's arithmetic.
    """
    zero, infinity = real.type(0.0), real.type(math.inf)
    square = np.square(real.type(max(distance, 0.0)))
    while square > zero and np.sqrt(np.nextafter(square, zero)).item() >= distance:
        square = np.nextafter(square, zero)
    while square < infinity and np.sqrt(square).item() < distance:
        square = np.nextafter(square, infinity)
    return square  # type: ignore[no-any-return]
