"""Who stood still, since when, and for how long."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.queries.answer import Answer, readable
from carla_recap.queries.roster import Roster

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.frame import Frame

_LOOK_AHEAD: Final = 1.0  # seconds
_ROUNDING: Final = 1e-6  # more than sums of the lengths of frames ever differ by, as a share
_TRUE: Final = b"\1"  # in an array of booleans
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


def blocked(source: Reader, min_time: float = 30.0, min_distance: float = 10.0, *, compat: bool = False) -> Blocked:
    """The actors that stood still.

    An actor stands still while it stays within a distance of the place where it last moved to. Everything
    that has a recorded transform counts: vehicles, walkers, props, the spectator.

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
        for frame in source.frames(_TYPES):
            watch.frame(frame)
        return Blocked(watch.finish(), source, compat=compat)


@dataclass(slots=True)
class _Actor:
    """An actor: the place where it last moved to, and its stretch, of duration 0 where there is none."""

    id: int
    type_id: str
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    start: float = 0.0
    duration: float = 0.0

    def row(self) -> BlockedRow:
        x, y, z = self.place
        return BlockedRow(self.start, self.duration, self.id, self.type_id, x, y, z)


class _Watch:
    """Follows the actors through the frames.

    The actors of a transforms packet are taken together as a `_Group`, which is kept for as long as the
    packets list the same ids.

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
        self._rows: list[BlockedRow] = []
        self._group: _Group | None = None
        self._rounds: tuple[bytes, list[NDArray[np.intp]]] = (b"", [])  # of the ids of the last packet

    def frame(self, frame: Frame) -> None:
        """Take in a frame."""
        for packet in frame.packets:
            assert packet.type is not None
            if packet.type.name == "transforms":
                self._move(frame, packet.records)  # type: ignore[arg-type]
                continue
            self._put_back()
            if packet.type.name == "spawned":
                for spawn in packet.records:
                    self._roster.spawn(spawn.id, _Actor(spawn.id, readable(spawn.type_id)))
            else:
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    self._destroy(id)

    def finish(self) -> list[BlockedRow]:
        """All stretches that are long enough."""
        self._put_back()
        left = [actor.row() for actor in self._roster.actors.values() if actor.duration >= self._min_time]
        if self._compat:
            # CARLA goes through a hash table, whose latest entry comes first.
            return sorted(self._rows + left[::-1], key=lambda row: -row.duration)
        return sorted(self._rows + left, key=lambda row: (-row.duration, row.start, row.id))

    def _destroy(self, id: int) -> None:
        actor = self._roster.destroy(id)
        if actor and actor.duration >= self._min_time and not self._compat:
            self._rows.append(actor.row())

    def _move(self, frame: Frame, records: NDArray[np.void]) -> None:
        if not len(records):
            return
        length = frame.duration if self._compat or frame.duration > 0.0 else 0.0
        ids = records["id"]
        key = ids.tobytes()
        group = self._group
        if group is None or group.key != key:
            if key != self._rounds[0]:
                self._rounds = key, _rounds(ids) if self._compat else [_latest(ids)]
            if len(self._rounds[1][0]) < len(ids):
                self._move_repeated(frame.elapsed, length, records)
                return
            group = self._take_out(key, ids)
        ended = group.move(records, frame.elapsed, length)
        if ended:
            self._rows += [row for _, row in ended]

    def _move_repeated(self, elapsed: float, length: float, records: NDArray[np.void]) -> None:
        """Take in a packet that lists actors repeatedly, as some builds do.

        The last record of each counts; in CARLA's queries, the first one does, then the second.
        """
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
        known = self._roster.actors
        actors = [known.get(id) or known.setdefault(id, _Actor(id, "")) for id in ids.tolist()]
        self._group = _Group(key, actors, self._min_time, self._square_of_reach)
        return self._group

    def _put_back(self) -> None:
        if self._group:
            self._group.put_back()
            self._group = None


class _Group:
    """The actors that a transforms packet lists, all different, through packets that list the same.

    What an actor that stands has stood so far follows from when it last moved, and is summed up only when it
    is asked for.

    Args:
        key: Their ids, as bytes.
        actors: The actors.
        min_time: The shortest stretch to tell of, in seconds.
        square_of_reach: See `_square_of_reach`.
    """

    def __init__(self, key: bytes, actors: list[_Actor], min_time: float, square_of_reach: np.floating[Any]) -> None:
        self.key = key
        self._actors = actors
        self._min_time = min_time
        self._places = np.array([actor.place for actor in actors], square_of_reach.dtype).T.copy()
        self._elapsed, self._lengths = array("d"), array("d")  # of the packets so far
        # The first packet from which on a stretch's duration may come back to 0.
        self._first_odd = 0 if any(actor.duration < 0.0 for actor in actors) else None
        self._moved_at = np.full(len(actors), -1)  # the packet in which each last moved
        # A clock that only goes forward: no stretch is longer than the time on it since the actor moved.
        self._clock = 0.0
        self._clocks = array("d")  # after each packet
        # Who may have stood for long, until the clock shows a time.
        self._suspects = np.zeros(len(actors), np.bool_)
        self._suspects_until = -1.0
        # Results go to arrays that are there already: numpy takes half the time then, for so few actors.
        self._square_of_reach = np.full(len(actors), square_of_reach)
        self._now, self._squares = np.empty((2, *self._places.shape), square_of_reach.dtype)
        self._moves, self._ends = np.empty((2, len(actors)), np.bool_)

    def put_back(self) -> None:
        """Bring the actors up to date."""
        for number, (actor, place) in enumerate(zip(self._actors, self._places.T.tolist(), strict=True)):
            self._update(number)
            actor.place = tuple(place)

    def move(self, records: NDArray[np.void], elapsed: float, length: float) -> list[tuple[int, BlockedRow]]:
        """Take in where the actors are in a frame.

        Args:
            records: The transforms.
            elapsed: When the frame begins, in seconds.
            length: How long it is, in seconds.

        Returns:
            The stretches that ended and are long enough, each with its record's number.
        """
        now, squares, moves, ends = self._now, self._squares, self._moves, self._ends
        now[0] = records["x"]
        now[1] = records["y"]
        now[2] = records["z"]
        np.subtract(now, self._places, out=squares)
        np.multiply(squares, squares, out=squares)
        square = squares[0]
        np.add(square, squares[1], out=square)
        np.add(square, squares[2], out=square)
        np.less(square, self._square_of_reach, out=moves)
        np.logical_not(moves, out=moves)  # so that what is not a number moves
        if not self._clock < self._suspects_until:
            self._suspect()
        np.logical_and(moves, self._suspects, out=ends)
        ended = self._end(ends.nonzero()[0].tolist()) if _TRUE in ends.tobytes() else []
        number = len(self._lengths)
        np.putmask(self._moved_at, moves, number)
        np.copyto(self._places, now, where=moves)
        if length > 0.0:
            self._clock += length
        elif self._first_odd is None:
            self._first_odd = number
        self._elapsed.append(elapsed)
        self._lengths.append(length)
        self._clocks.append(self._clock)
        return ended

    def _suspect(self) -> None:
        """Find who may have stood long enough before the clock has gone on for the time to look ahead."""
        self._suspects_until = self._clock + _LOOK_AHEAD
        before = [-max(actor.duration, 0.0) for actor in self._actors]
        origins = np.where(self._moved_at < 0, before, np.append(self._clocks, 0.0)[self._moved_at])
        # The clock has other roundings than the sum of a stretch, which decides in the end.
        margin = _ROUNDING * (1.0 + self._suspects_until)
        self._suspects = ~(self._suspects_until - origins < self._min_time - margin)

    def _end(self, numbers: list[int]) -> list[tuple[int, BlockedRow]]:
        """The stretches of some actors that move, where they are long enough."""
        rows = []
        for number in numbers:
            actor = self._actors[number]
            self._update(number)
            if actor.duration >= self._min_time:
                actor.place = tuple(self._places[:, number].tolist())
                rows.append((number, actor.row()))
            self._suspects[number] = self._min_time <= 2.0 * _LOOK_AHEAD
        return rows

    def _update(self, number: int) -> None:
        """Sum up what an actor has stood, packet by packet, as CARLA does: the sum depends on the order."""
        actor, first = self._actors[number], int(self._moved_at[number]) + 1
        if first:
            actor.duration = 0.0
        at = len(self._lengths) if self._first_odd is None else max(self._first_odd, first)
        if at > first:
            if actor.duration == 0.0:
                actor.start = self._elapsed[first]
            lengths = np.frombuffer(self._lengths)[first:at]
            actor.duration = np.add.accumulate(np.append(actor.duration, lengths))[-1].item()
        for place in range(at, len(self._lengths)):
            if actor.duration == 0.0:
                actor.start = self._elapsed[place]
            actor.duration += self._lengths[place]


def _rounds(ids: NDArray[np.uint32]) -> list[NDArray[np.intp]]:
    """The places of the first record of each id, of the second one, and so on."""
    order = np.argsort(ids, kind="stable")
    ranks = np.arange(len(ids))
    first = np.append(True, np.diff(ids[order]) != 0)
    number = np.empty_like(ranks)
    number[order] = ranks - np.maximum.accumulate(np.where(first, ranks, 0))
    return np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])


def _latest(ids: NDArray[np.uint32]) -> NDArray[np.intp]:
    """The places of the last record of each id."""
    _, behind = np.unique(ids[::-1], return_index=True)
    return np.sort(len(ids) - 1 - behind)


def _square_of_reach(distance: float, real: np.dtype[Any]) -> np.floating[Any]:
    """The smallest square whose root is not below a distance.

    To compare squares with it is as good, to the last bit, as to compare their roots with the distance, in
    the precision of the file's lengths, which is that of CARLA's arithmetic.
    """
    zero, infinity = real.type(0.0), real.type(math.inf)
    square = np.square(real.type(max(distance, 0.0)))
    while square > zero and np.sqrt(np.nextafter(square, zero)).item() >= distance:
        square = np.nextafter(square, zero)
    while square < infinity and np.sqrt(square).item() < distance:
        square = np.nextafter(square, infinity)
    return square  # type: ignore[no-any-return]
