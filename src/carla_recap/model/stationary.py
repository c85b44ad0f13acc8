"""Who stands still, since when, and for how long: follows the actors of a recording frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.actors import HashOrder, Roster
from carla_recap.model.batch import ConstantColumn
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Packet
    from carla_recap.model.records import Table

    Floats = NDArray[np.float64]
    _Paths = NDArray[np.floating[Any]]  # x, y, z along an axis

MIN_TIME: Final = 30.0  # s
MIN_DISTANCE: Final = 10.0  # cm
TRANSFORMS: Final = "transforms"
TYPES: Final = ("spawned", "destroyed", TRANSFORMS)
"""The record types that tell of it."""

_WALKER: Final = "walker."
_LYING: Final = 60.0  # degrees of pitch or roll: a walker that is turned farther lies
_ROUNDING: Final = 1e-6  # more than sums of the lengths of frames ever differ by, as a share
_PACKETS: Final = 64  # so many, or so many records, are taken together
_RECORDS: Final = 1 << 17
_FEW: Final = 4  # frames that list other actors than those before; fewer are followed one by one
_ROUNDS: Final = 8  # a packet that lists an actor more often than that is followed record by record


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


class Standing:
    """Follows the actors through the frames of a recording.

    An actor stands still while it stays within a distance of the place where it last moved to; a walker that lies on the
    ground does not stand. The actors of a transforms packet are taken together as a `_Group`, which is kept for as long as
    the packets list the same ids.

    Args:
        table: The record types of the recording.
        min_time: The shortest stretch to tell of, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        compat: Follow them as CARLA 0.9.16 does, with its slips.
    """

    def __init__(
        self, table: Table, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
    ) -> None:
        self._min_time = min_time
        self._square_of_reach = _square_of_reach(min_distance, table.named("transforms").dtype["x"])
        self._compat = compat
        self._roster = Roster[_Actor](compat=compat)
        self._order = HashOrder() if compat else None
        self._rows: list[BlockedRow] = []
        self._group: _Group | None = None
        self._rounds: tuple[bytes, list[NDArray[np.intp]]] = (b"", [])  # of the ids of the last packet
        self._followed_alone = b""  # the ids of the last packet that was followed without a group

    def frame(self, frame: Frame, packets: Iterable[Packet] | None = None) -> None:
        """Take in a frame.

        Args:
            frame: The frame.
            packets: Those of its packets that may tell something; None: all.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        for packet in frame.packets if packets is None else packets:
            name = packet.type.name if packet.type else ""
            if name not in TYPES or not len(packet.records):
                continue
            if name == TRANSFORMS:
                one = np.array([frame.elapsed]), np.array([frame.duration])
                self.move(*one, packet.records[None])  # type: ignore[call-overload]
                continue
            self._put_back()
            if name == "spawned":
                for spawn in packet.records:
                    self._roster.spawn(spawn.id, _Actor(spawn.id, readable(spawn.type_id)))
                    if self._order is not None:
                        self._order.add(spawn.id)
            else:
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    self._destroy(id)

    def batch(self, batch: Batch) -> None:
        """Take in the frames of a batch; see `frame`.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        telling = [column for column in batch.columns if column.type is not None and column.type.name in TYPES]
        filled = [column for column in telling if not isinstance(column, ConstantColumn)]
        moving = [column.records for column in filled if column.type is not None and column.type.name == TRANSFORMS]
        if len(batch) > 1 and len(moving) == len(filled) < 2:
            for records in moving:
                self.move(batch.elapsed, batch.duration, records)
            return
        for frame in batch:
            self.frame(frame)

    def take(self) -> list[BlockedRow]:
        """The stretches that have ended since this was last asked, in that order; some may come later."""
        rows, self._rows = self._rows, []
        return rows

    def finish(self) -> list[BlockedRow]:
        """The rest: stretches that have ended, then those that last until the end."""
        self._put_back()
        actors = self._roster.actors
        left = actors.values() if self._order is None else [actors[id] for id in self._order.ids()]
        return self.take() + [actor.row() for actor in left if actor.duration >= self._min_time]

    def _destroy(self, id: int) -> None:
        actor = self._roster.destroy(id)
        if actor is None:
            return
        if self._order is not None:
            self._order.remove(actor.id)
        elif actor.duration >= self._min_time:
            self._rows.append(actor.row())

    def _actor(self, id: int) -> _Actor:
        """Return the actor of an id; one whose spawn is not recorded begins with its first transform."""
        actor = self._roster.actors.get(id)
        if actor is None:
            actor = self._roster.actors[id] = _Actor(id, "")
            if self._order is not None:
                self._order.add(id)
        return actor

    def move(self, elapsed: Floats, duration: Floats, records: NDArray[np.void]) -> None:
        """Take in the transforms of some frames.

        Args:
            elapsed: Seconds from the beginning of the recording to each frame.
            duration: Seconds until the next one, of each.
            records: The transforms, (frames, transforms of each).
        """
        if not records.shape[1]:
            return
        lengths = duration if self._compat else np.where(duration > 0.0, duration, 0.0)
        ids = np.ascontiguousarray(records["id"])
        edges = [0, *(np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1).tolist(), len(ids)]
        for start, stop in pairwise(edges):
            self._move(elapsed[start:stop], lengths[start:stop], records[start:stop], ids[start])

    def _move(self, elapsed: Floats, lengths: Floats, records: NDArray[np.void], ids: NDArray[np.uint32]) -> None:
        """Take in the transforms of some frames that list the same actors."""
        key = ids.tobytes()
        if self._group is None or self._group.key != key:
            if key != self._rounds[0]:
                self._rounds = key, _rounds(ids) if self._compat else [_latest(ids)]
            rounds = self._rounds[1]
            if len(rounds) != 1:
                for place in range(len(records)):
                    self._move_repeated(elapsed[place : place + 1], lengths[place : place + 1], records[place], rounds)
                return
            if len(rounds[0]) < len(ids):  # the last record of each actor counts
                records = records[:, rounds[0]]
            if len(records) < _FEW and key != self._followed_alone:
                self._put_back()
                self._followed_alone = key
                for place, (begin, length) in enumerate(zip(elapsed.tolist(), lengths.tolist(), strict=True)):
                    self._move_alone(begin, length, records[place])
                return
        group = self._group_of(records[0])
        step = max(1, min(_PACKETS, _RECORDS // len(ids)))
        for at in range(0, len(records), step):
            part = slice(at, at + step)
            group.add(records[part], elapsed[part], lengths[part])
            if group.full:
                self._rows += [row for _, row in group.settle()]

    def _move_repeated(
        self, elapsed: Floats, length: Floats, records: NDArray[np.void], rounds: list[NDArray[np.intp]]
    ) -> None:
        """Follow a packet that lists actors repeatedly as CARLA does: the first record of each counts, then the second.

        Args:
            elapsed: The beginning of the frame, in seconds, (1,).
            length: The length of the frame, in seconds, (1,).
            records: The transforms.
            rounds: See `_rounds`.
        """
        if not rounds:
            self._put_back()
            self._move_one_by_one(elapsed.item(), length.item(), records)
            return
        if self._group:  # what ended in earlier frames comes before all that ends in this one
            self._rows += [row for _, row in self._group.settle()]
        ended = []
        for places in rounds:
            part = records[places]
            group = self._group_of(part)
            group.add(part[None], elapsed, length)
            ended += [(places[number], row) for number, row in group.settle()]
        self._rows += [row for _, row in sorted(ended, key=lambda item: item[0])]

    @np.errstate(all="ignore")
    def _move_one_by_one(self, elapsed: float, length: float, records: NDArray[np.void]) -> None:
        real = self._square_of_reach.dtype.type
        for id, *place in zip(*(records[name].tolist() for name in ("id", "x", "y", "z")), strict=True):
            actor = self._actor(id)
            x, y, z = (real(now) - real(before) for now, before in zip(place, actor.place, strict=True))
            if x * x + y * y + z * z < self._square_of_reach:
                if actor.duration == 0.0:
                    actor.start = elapsed
                actor.duration += length
            else:
                if actor.duration >= self._min_time:
                    self._rows.append(actor.row())
                actor.duration = 0.0
                actor.place = tuple(place)

    @np.errstate(all="ignore")
    def _move_alone(self, elapsed: float, length: float, records: NDArray[np.void]) -> None:
        """Follow a packet that lists each actor once, without a group: to make one costs more than it saves for a frame."""
        real = self._square_of_reach.dtype
        actors = [self._actor(id) for id in records["id"].tolist()]
        places = np.array([actor.place for actor in actors], real).reshape(-1, 3).T
        now = np.stack([records[name] for name in "xyz"]).astype(real, copy=False)
        steps = now - places
        still = (_squares(steps, tuple(steps)) < self._square_of_reach).tolist()
        if not self._compat:
            lies = (np.abs(records["pitch"]) > _LYING) | (np.abs(records["roll"]) > _LYING)
            for number in np.flatnonzero(lies).tolist():
                still[number] = still[number] and not actors[number].type_id.startswith(_WALKER)
        for actor, stands, place in zip(actors, still, zip(*now.tolist(), strict=True), strict=True):
            if stands:
                if actor.duration == 0.0:
                    actor.start = elapsed
                actor.duration += length
            else:
                if actor.duration >= self._min_time:
                    self._rows.append(actor.row())
                actor.duration = 0.0
                actor.place = place

    def _group_of(self, records: NDArray[np.void]) -> _Group:
        """Return the group of the actors of some transforms; it is the one that is followed from then on."""
        key = records["id"].tobytes()
        if self._group is None or self._group.key != key:
            self._put_back()
            actors = [self._actor(id) for id in records["id"].tolist()]
            walkers = [] if self._compat else [n for n, actor in enumerate(actors) if actor.type_id.startswith(_WALKER)]
            self._group = _Group(key, actors, walkers, self._min_time, self._square_of_reach)
        return self._group

    def _put_back(self) -> None:
        if self._group:
            self._rows += [row for _, row in self._group.settle()]
            self._group.put_back()
            self._group = None


class _Group:
    """The actors that a transforms packet lists, all different, through packets that list the same.

    Packets are taken in several at a time. What an actor that stands has stood so far follows from when it last
    moved, and is summed up only when it is asked for.

    Args:
        key: Their ids, as bytes.
        actors: The actors.
        walkers: The numbers of those that do not stand when they lie.
        min_time: The shortest stretch to tell of, in seconds.
        square_of_reach: See `_square_of_reach`.
    """

    def __init__(
        self, key: bytes, actors: list[_Actor], walkers: list[int], min_time: float, square_of_reach: np.floating[Any]
    ) -> None:
        self.key = key
        self._actors = actors
        self._walkers = np.array(walkers, np.intp)
        self._min_time = min_time
        self._square_of_reach = square_of_reach
        self._places = np.array([actor.place for actor in actors], square_of_reach.dtype).T.copy()
        self._waiting: list[tuple[NDArray[np.void], Floats, Floats]] = []
        self._waits = 0  # packets
        self._elapsed, self._lengths = _Series(), _Series()  # of the packets so far
        # The first packet from which on a stretch's duration may come back to 0.
        self._first_odd = 0 if any(actor.duration < 0.0 for actor in actors) else None
        self._moved_at = np.full(len(actors), -1)  # the packet in which each last moved
        # A clock that only goes forward: no stretch is longer than the time on it since the actor moved.
        self._clocks = _Series((0.0,))  # before each packet
        self._origins = np.array([-max(actor.duration, 0.0) for actor in actors])  # what it showed when each last moved

    @property
    def full(self) -> bool:
        """Whether enough packets wait to be settled."""
        return self._waits >= _PACKETS or self._waits * len(self._actors) >= _RECORDS

    def add(self, records: NDArray[np.void], elapsed: Floats, lengths: Floats) -> None:
        """Take in where the actors are in some frames.

        Args:
            records: The transforms, (frames, actors).
            elapsed: When each frame begins, in seconds.
            lengths: How long each is, in seconds.
        """
        self._waiting.append((records, elapsed, lengths))
        self._waits += len(records)

    def settle(self) -> list[tuple[int, BlockedRow]]:
        """Follow the actors through the packets that wait.

        Returns:
            The stretches that ended and are long enough, in order, each with its record's number.
        """
        if not self._waiting:
            return []
        with np.errstate(all="ignore"):
            return self._settle()

    def _settle(self) -> list[tuple[int, BlockedRow]]:
        first, count = len(self._lengths), self._waits
        paths = np.empty((3, count, len(self._actors)), self._places.dtype)
        at = 0
        for records, elapsed, lengths in self._waiting:
            for axis, name in enumerate("xyz"):
                paths[axis, at : at + len(records)] = records[name]
            at += len(records)
            self._elapsed.extend(elapsed)
            self._lengths.extend(lengths)
        lying = self._lying([records for records, _, _ in self._waiting])
        self._waiting, self._waits = [], 0
        lengths = self._lengths.values[first:]
        clock = np.add.accumulate(np.append(self._clocks.values[-1], np.fmax(lengths, 0.0)))
        self._clocks.extend(clock[1:])
        if self._first_odd is None:
            odd = np.flatnonzero(~(lengths > 0.0))
            self._first_odd = first + int(odd[0]) if len(odd) else None
        steps = paths - self._places[:, None]
        still = _squares(steps, tuple(steps)) < self._square_of_reach
        if lying is not None:
            still &= ~lying
        movers = np.flatnonzero(~still.all(axis=0))
        if not len(movers):
            return []
        paths, places = paths[:, :, movers].swapaxes(0, 1).copy(), self._places[:, movers]
        moves = np.empty((count, len(movers)), np.bool_)
        reach, steps = np.full(len(movers), self._square_of_reach), np.empty_like(places)
        axes = tuple(steps)
        for number, (now, moved) in enumerate(zip(paths, moves, strict=True)):
            np.subtract(now, places, steps)
            np.less(_squares(steps, axes), reach, moved)
            np.logical_not(moved, moved)  # so that what is not a number moves
            if lying is not None:
                moved |= lying[number, movers]
            np.copyto(places, now, where=moved)
        ended = self._end(first, movers, moves, paths)
        self._places[:, movers] = places
        return ended

    def _lying(self, blocks: list[NDArray[np.void]]) -> NDArray[np.bool_] | None:
        """Return which walkers lie on the ground, (packets, actors); None if none does."""
        if not len(self._walkers):
            return None
        pitch, roll = (np.concatenate([block[name][:, self._walkers] for block in blocks]) for name in ("pitch", "roll"))
        some = (np.abs(pitch) > _LYING) | (np.abs(roll) > _LYING)
        if not some.any():
            return None
        lying = np.zeros((len(some), len(self._actors)), np.bool_)
        lying[:, self._walkers] = some
        return lying

    def put_back(self) -> None:
        """Bring the actors up to date."""
        for number, (actor, place) in enumerate(zip(self._actors, self._places.T.tolist(), strict=True)):
            self._update(number, int(self._moved_at[number]), len(self._lengths))
            actor.place = tuple(place)

    def _end(
        self, first: int, movers: NDArray[np.intp], moves: NDArray[np.bool_], paths: _Paths
    ) -> list[tuple[int, BlockedRow]]:
        """The stretches that end within some packets, where they are long enough.

        Args:
            first: The first of the packets.
            movers: The numbers of the actors that move in any of them.
            moves: Of each packet, which of the movers move in it.
            paths: Of each packet, where the movers are.
        """
        clocks = self._clocks.values[first:]
        # The clock has other roundings than the sum of a stretch, which decides in the end.
        least = self._min_time - _ROUNDING * (1.0 + clocks[-1])
        rows = []
        for place, column, before in _stops(moves, self._origins[movers], clocks, least):
            number = int(movers[column])
            actor = self._actors[number]
            moved_at = first + before if before >= 0 else int(self._moved_at[number])
            self._update(number, moved_at, first + place)
            if actor.duration >= self._min_time:
                stood = paths[before, :, column] if before >= 0 else self._places[:, number]
                actor.place = tuple(stood.tolist())
                rows.append((number, actor.row()))
        last = len(moves) - 1 - np.argmax(moves[::-1], axis=0)
        self._moved_at[movers] = first + last
        self._origins[movers] = clocks[last + 1]
        return rows

    def _update(self, number: int, moved_at: int, until: int) -> None:
        """Sum up what an actor has stood since a packet, packet by packet, as CARLA does: the sum depends on the order."""
        actor, first = self._actors[number], moved_at + 1
        elapsed, lengths = self._elapsed.values, self._lengths.values
        if first:
            actor.duration = 0.0
        at = until if self._first_odd is None else min(max(self._first_odd, first), until)
        if at > first:
            if actor.duration == 0.0:
                actor.start = elapsed[first].item()
            actor.duration = np.add.accumulate(np.append(actor.duration, lengths[first:at]))[-1].item()
        for place in range(max(at, first), until):
            if actor.duration == 0.0:
                actor.start = elapsed[place].item()
            actor.duration += lengths[place].item()


class _Series:
    """Numbers of which there come more and more, as an array."""

    def __init__(self, values: ArrayLike = ()) -> None:
        self._room = np.empty(_PACKETS)
        self._count = 0
        self.extend(values)

    def __len__(self) -> int:
        return self._count

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers so far."""
        return self._room[: self._count]

    def extend(self, values: ArrayLike) -> None:
        """Add numbers."""
        values = np.asarray(values, np.float64)
        count = self._count + len(values)
        if count > len(self._room):
            room = np.empty(2 * count)
            room[: self._count] = self.values
            self._room = room
        self._room[self._count : count] = values
        self._count = count


def _stops(
    moves: NDArray[np.bool_], origins: NDArray[np.float64], clocks: NDArray[np.float64], least: float
) -> list[list[int]]:
    """The moves that end a stretch which may be long enough: packet, actor, packet of the move before (or -1).

    Args:
        moves: Of each packet, which actors move in it.
        origins: What the clock showed when each moved before.
        clocks: What it shows before each packet, and after the last one.
        least: How long a stretch has to be.
    """
    old = np.flatnonzero(~(clocks[-1] - origins < least))
    if not len(old):
        return []
    moves = moves[:, old]
    numbers = np.broadcast_to(np.arange(len(moves))[:, None], moves.shape)
    latest = np.maximum.accumulate(np.where(moves, numbers, -1))
    before = np.vstack((np.full_like(latest[:1], -1), latest[:-1]))
    begun = np.where(before < 0, origins[old], clocks[before + 1])
    places, columns = np.nonzero(moves & ~(clocks[:-1, None] - begun < least))
    return np.stack((places, old[columns], before[places, columns]), axis=1).tolist()  # type: ignore[no-any-return]


def _squares(steps: _Paths, axes: tuple[_Paths, ...]) -> _Paths:
    """The squares of the lengths of steps, in place of those along x; `axes` are the steps, taken apart."""
    squares, y, z = axes
    np.multiply(steps, steps, steps)
    np.add(squares, y, squares)
    return np.add(squares, z, squares)


def _rounds(ids: NDArray[np.uint32]) -> list[NDArray[np.intp]]:
    """Return the places of the first record of each id, of the second one, and so on; nothing if there are too many."""
    order = np.argsort(ids, kind="stable")
    ranks = np.arange(len(ids))
    first = np.append(True, np.diff(ids[order]) != 0)
    number = np.empty_like(ranks)
    number[order] = ranks - np.maximum.accumulate(np.where(first, ranks, 0))
    counts = np.bincount(number)
    return np.split(np.argsort(number, kind="stable"), np.cumsum(counts)[:-1]) if len(counts) <= _ROUNDS else []


def _latest(ids: NDArray[np.uint32]) -> NDArray[np.intp]:
    """The places of the last record of each id."""
    _, behind = np.unique(ids[::-1], return_index=True)
    return np.sort(len(ids) - 1 - behind)


@np.errstate(all="ignore")
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
