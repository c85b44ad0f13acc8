"""Stationary intervals: when, where and for how long each actor of a recording does not move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.actors import HashOrder, PresentActors
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Packet
    from carla_recap.model.records import Table

    Booleans = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]
    Positions = NDArray[np.floating[Any]]  # x, y, z along the first axis, in cm

MIN_TIME: Final = 30.0  # s
MIN_DISTANCE: Final = 10.0  # cm
TRANSFORMS: Final = "transforms"
TYPES: Final = ("spawned", "destroyed", TRANSFORMS)
"""The record types that stationary intervals are computed from."""

_WALKER: Final = "walker."
_LYING: Final = 60.0  # degrees of pitch or roll from which on a walker lies on the ground
_ROUNDING: Final = 1e-6  # a bound of the relative difference between two sums of the same durations
_FEW: Final = 4  # packets in a row that list the same actors; fewer are processed record by record
_BLOCK: Final = 192  # packets that are processed together, at most
_RECORDS: Final = 1 << 17  # records that are processed together, at most
_TIMES: Final = 1 << 16  # packets whose times are kept, at most
_SMALLEST, _LARGEST = 1e-30, 1e30  # squared limits with which no arithmetic over- or underflows unnoticed
_LAGS: Final = 6  # packets after which a slow actor has usually moved
_HOPS: Final = 16  # moves that are followed before looking for actors that have stopped
_WINDOW: Final = 32  # packets in which the next move of such an actor is looked for first


@dataclass(frozen=True, slots=True)
class BlockedRow:
    """An interval in which an actor did not move.

    Attributes:
        start: When it began, in seconds since the recording began.
        duration: How long it lasted, in seconds.
        id: The actor.
        type_id: Its blueprint, such as `vehicle.audi.tt`; empty for an actor whose spawn is not recorded.
        x: The position, in cm, left-handed.
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
    """The state of an actor: the position that it last moved to, and its current interval, of duration 0 if none."""

    id: int
    type_id: str
    anchor: tuple[float, ...] = (0.0, 0.0, 0.0)
    start: float = 0.0
    duration: float = 0.0

    def interval(self) -> BlockedRow:
        return BlockedRow(self.start, self.duration, self.id, self.type_id, *self.anchor)


class StationaryTracker:
    """Finds the stationary intervals of all actors in the frames of a recording.

    An actor is stationary while it stays within a distance of its anchor, the position that it last moved to. A walker
    that lies on the ground is not stationary. Packets in a row that list the same actors are processed together.

    Args:
        table: The record types of the recording.
        min_time: The shortest interval to report, in seconds.
        min_distance: The distance from the anchor at which an actor has moved, in cm.
        compat: Whether to reproduce the mistakes of CARLA 0.9.16.
    """

    def __init__(
        self, table: Table, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
    ) -> None:
        self._min_time = min_time
        self._limit = _squared_limit(min_distance, table.named(TRANSFORMS).dtype["x"])
        # Squares in double precision below and above which the result of single precision is certain.
        certain = _SMALLEST < self._limit < _LARGEST
        self._near = self._limit.item() * (1 - 1e-5) if certain else -1.0
        self._far = self._limit.item() * (1 + 1e-5) if certain else math.inf
        self._compat = compat
        self._present = PresentActors[_Actor](compat=compat)
        self._order = HashOrder() if compat else None
        self._intervals: list[BlockedRow] = []
        self._block = _Block(min_time, self._limit, walkers_can_lie=not compat)
        self._key = b""  # the ids of the previous packet
        self._counted = np.empty(0, np.intp)  # the indices of its records that count
        self._run = 0  # the number of packets in a row with these ids

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        columns = [column for column in batch.columns if column.type is not None and column.type.name in TYPES]
        filled = [column for column in columns if len(column.packet(0).records)] if len(batch) > 1 else columns
        moving = [column.records for column in filled if column.type is not None and column.type.name == TRANSFORMS]
        if len(batch) > 1 and len(moving) == len(filled) < 2:
            for records in moving:
                self._transforms(batch.elapsed, batch.duration, records)
        else:
            for frame in batch:
                self.frame(frame)

    def frame(self, frame: Frame, packets: Iterable[Packet] | None = None) -> None:
        """Process a frame.

        Args:
            frame: The frame.
            packets: The packets to process; None for all.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        for packet in frame.packets if packets is None else packets:
            name = packet.type.name if packet.type else ""
            if name not in TYPES or not len(packet.records):
                continue
            if name == TRANSFORMS:
                times = np.array([frame.elapsed]), np.array([frame.duration])
                self._transforms(*times, packet.records[None])  # type: ignore[call-overload]
            elif name == "spawned":
                for spawn in packet.records:
                    self._release(spawn.id)
                    self._present.spawn(spawn.id, _Actor(spawn.id, readable(spawn.type_id)))
                    if self._order is not None:
                        self._order.add(spawn.id)
            else:
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    self._destroy(id)

    def take(self) -> list[BlockedRow]:
        """Return the intervals that were found to have ended since the previous call, in order of their ends."""
        intervals, self._intervals = self._intervals, []
        return intervals

    def finish(self) -> list[BlockedRow]:
        """Return the remaining intervals: those that have ended, then those that last until the end."""
        self._follow(b"", ())
        actors = self._present.actors
        left = actors.values() if self._order is None else [actors[id] for id in self._order.ids()]
        return self.take() + [actor.interval() for actor in left if actor.duration >= self._min_time]

    def _destroy(self, id: int) -> None:
        actor = self._present.destroy(id)
        if actor is None:
            return
        self._release(actor.id)
        if self._order is not None:
            self._order.remove(actor.id)
        elif actor.duration >= self._min_time:
            self._intervals += self._block.settle()
            self._intervals.append(actor.interval())

    def _actor(self, id: int) -> _Actor:
        """Return the actor of an id; one whose spawn is not recorded begins with its first transform."""
        actor = self._present.actors.get(id)
        if actor is None:
            actor = self._present.actors[id] = _Actor(id, "")
            if self._order is not None:
                self._order.add(id)
        return actor

    def _release(self, id: int) -> None:
        """Bring an actor up to date that the block follows; the block does so no more."""
        if id in self._block:
            self._intervals += self._block.settle()
            self._block.release(id)

    def _follow(self, key: bytes, ids: Iterable[int]) -> None:
        """Let the block follow these actors and no others."""
        self._intervals += self._block.settle()
        self._block.follow(key, [self._actor(id) for id in ids])

    def _transforms(self, elapsed: Floats, duration: Floats, records: NDArray[np.void]) -> None:
        """Process the transforms of consecutive frames.

        Args:
            elapsed: The beginning of each frame, in seconds.
            duration: The length of each frame, in seconds.
            records: The transforms, (frames, transforms of each).
        """
        if not records.shape[1]:
            return
        lengths = duration if self._compat else np.fmax(duration, 0.0)
        ids = np.ascontiguousarray(records["id"])
        edges = [0, *(np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1).tolist(), len(ids)]
        for start, stop in pairwise(edges):
            self._same_actors(elapsed[start:stop], lengths[start:stop], records[start:stop], ids[start])

    def _same_actors(self, elapsed: Floats, lengths: Floats, records: NDArray[np.void], ids: NDArray[np.uint32]) -> None:
        """Process the transforms of consecutive frames that list the same actors."""
        key = ids.tobytes()
        previous = self._run
        if key != self._key:
            self._key, self._counted, self._run = key, _last_of_each(ids), 0
        self._run += len(records)
        repeated = len(self._counted) < len(ids)
        if repeated and not self._compat:  # the last record of each actor counts
            records, ids = records[:, self._counted], ids[self._counted]
        if max(previous, self._run) < _FEW or (repeated and self._compat):
            self._follow(b"", ())
            for begin, length, packet in zip(elapsed.tolist(), lengths.tolist(), records, strict=True):
                self._one_by_one(begin, length, packet)
            return
        if self._block.key != key:
            self._follow(key, ids.tolist())
        self._intervals += self._block.add(elapsed, lengths, records)

    @np.errstate(all="ignore")
    def _one_by_one(self, elapsed: float, length: float, records: NDArray[np.void]) -> None:
        """Process the transforms of a frame record by record."""
        present, near, far, min_time = self._present.actors, self._near, self._far, self._min_time
        lying = [] if self._compat else np.flatnonzero(_lies(records)).tolist()
        for row, (id, x, y, z) in enumerate(zip(*(records[name].tolist() for name in ("id", "x", "y", "z")), strict=True)):
            actor = present.get(id) or self._actor(id)
            anchor_x, anchor_y, anchor_z = actor.anchor
            dx, dy, dz = x - anchor_x, y - anchor_y, z - anchor_z
            square = dx * dx + dy * dy + dz * dz
            if (square < near or (not square > far and self._is_exactly_near((x, y, z), actor.anchor))) and not (
                row in lying and actor.type_id.startswith(_WALKER)
            ):
                if actor.duration == 0.0:
                    actor.start = elapsed
                actor.duration += length
            else:
                if actor.duration >= min_time:
                    self._intervals.append(actor.interval())
                actor.duration = 0.0
                actor.anchor = x, y, z

    def _is_exactly_near(self, position: tuple[float, ...], anchor: tuple[float, ...]) -> bool:
        here, there = np.array([position, anchor], self._limit.dtype)
        return bool(_is_near(here, there, self._limit))


class _Block:
    """Actors that are listed once each by packets in a row, and the packets that are not processed yet.

    Of an actor that has not moved for long, the duration is summed up only when it is needed. An `_Actor` here is as it
    was before the packet `_since`, without duration if it has moved.

    Args:
        min_time: The shortest interval to report, in seconds.
        limit: The squared distance at which an actor has moved, see `_squared_limit`.
        walkers_can_lie: Whether a walker on the ground is not stationary.

    Attributes:
        key: The ids that the packets list, as bytes; empty where the block does not follow all of these actors.
    """

    def __init__(self, min_time: float, limit: np.floating[Any], *, walkers_can_lie: bool) -> None:
        self._min_time = min_time
        self._limit = limit
        self._walkers_can_lie = walkers_can_lie
        self.key = b""
        self._actors: list[_Actor] = []
        self._columns: dict[int, int] = {}  # by id
        self._walkers = np.empty(0, np.intp)  # columns
        self._since = np.empty(0, np.intp)
        # A clock that never goes back: no interval is longer than the time on it since the actor moved.
        self._origins = np.empty(0)  # the clock when each actor moved
        self._paths: Positions = np.empty((3, 1, 0), limit.dtype)  # the anchors, then the packets that wait
        self._lying = np.empty((0, 0), np.bool_)  # whether walkers lie in the packets that wait
        self._elapsed, self._lengths, self._clock = np.empty(_TIMES), np.empty(_TIMES), np.zeros(_TIMES + 1)
        self._count = 0  # packets whose times are known
        self._waiting = 0  # packets

    def __contains__(self, id: int) -> bool:
        return id in self._columns

    def add(self, elapsed: Floats, lengths: Floats, records: NDArray[np.void]) -> list[BlockedRow]:
        """Add packets.

        Args:
            elapsed: The beginning of each frame, in seconds.
            lengths: The length of each frame, in seconds.
            records: The transforms, (frames, actors).

        Returns:
            The intervals that have ended, as far as packets were processed.
        """
        intervals: list[BlockedRow] = []
        start = 0
        while start < len(records):
            part = records[start : start + self._paths.shape[1] - 1 - self._waiting]
            stop = start + len(part)
            first, last = self._count, self._count + len(part)
            self._elapsed[first:last], self._lengths[first:last] = elapsed[start:stop], lengths[start:stop]
            waiting = slice(self._waiting, self._waiting + len(part))
            for axis, name in zip(self._paths[:, 1:], "xyz", strict=True):
                axis[waiting] = part[name]
            if len(self._walkers):
                self._lying[waiting] = _lies(part, self._walkers)
            start, self._count, self._waiting = stop, last, waiting.stop
            if self._waiting == self._paths.shape[1] - 1:
                intervals += self.settle()
        return intervals

    def release(self, id: int) -> None:
        """Bring an actor up to date and stop following it. No packets may wait."""
        column = self._columns.pop(id)
        self._sum_up(column, self._count)
        self._actors[column].anchor = tuple(self._paths[:, 0, column].tolist())
        self.key = b""

    def follow(self, key: bytes, actors: list[_Actor]) -> None:
        """Follow the actors that packets of a key list from now on, and no others. No packets may wait."""
        staying = np.array([self._columns.pop(actor.id, -1) for actor in actors], np.intp)
        for id in list(self._columns):
            self.release(id)
        old, new = staying[staying >= 0], np.flatnonzero(staying < 0)
        if not len(old):
            self._count = 0
        size = max(1, min(_BLOCK, _RECORDS // max(len(actors), 1)))
        paths = np.empty((3, size + 1, len(actors)), self._limit.dtype)
        since, origins = np.full(len(actors), self._count), np.empty(len(actors))
        paths[:, 0, staying >= 0] = self._paths[:, 0, old]
        since[staying >= 0], origins[staying >= 0] = self._since[old], self._origins[old]
        for column in new.tolist():
            paths[:, 0, column] = actors[column].anchor
            origins[column] = self._clock[self._count] - max(actors[column].duration, 0.0)
        self._paths, self._since, self._origins = paths, since, origins
        self.key, self._actors = key, actors
        self._columns = {actor.id: column for column, actor in enumerate(actors)}
        walkers = [column for column, actor in enumerate(actors) if actor.type_id.startswith(_WALKER)]
        self._walkers = np.array(walkers if self._walkers_can_lie else [], np.intp)
        self._lying = np.empty((size, len(self._walkers)), np.bool_)

    @np.errstate(all="ignore")
    def settle(self) -> list[BlockedRow]:
        """Process the packets that wait and return the intervals that end in them."""
        waiting, self._waiting = self._waiting, 0
        if not waiting:
            return []
        first = self._count - waiting
        times = np.fmax(self._lengths[first : self._count], 0.0)
        np.add.accumulate(np.append(self._clock[first], times), out=self._clock[first : self._count + 1])
        paths, lying = self._paths[:, : waiting + 1], self._lying[:waiting]
        near = _is_near(paths[:, 1:], paths[:, :1], self._limit)
        forced = None
        if lying.any():
            forced = np.zeros((waiting + 1, len(self._actors)), np.bool_)
            forced[1:, self._walkers] = lying
            near &= ~forced[1:]
        movers = np.flatnonzero(~near.all(axis=0))
        intervals = self._move(movers, near.take(movers, axis=1), forced) if len(movers) else []
        if self._count + _BLOCK > _TIMES:
            self._forget_times()
        return intervals

    def _move(self, movers: Indices, near: Booleans, forced: Booleans | None) -> list[BlockedRow]:
        """Process the packets that wait for some actors, and return the intervals that end in them.

        Args:
            movers: The columns of the actors that move.
            near: Where they are near to their anchors, (packets, movers).
            forced: See `_moves`, for all actors.
        """
        first = self._count - len(near)
        clock = self._clock[first : self._count + 1]
        # The clock is rounded otherwise than the sum of an interval, which decides in the end.
        least = self._min_time - _ROUNDING * (1.0 + clock[-1])
        paths = self._paths[:, : len(clock)].take(movers, axis=2)
        forced = None if forced is None else forced[:, movers]
        leaving = start = near.argmin(axis=0) + 1
        if clock[-1] - clock[0] < least:  # no interval begins and ends in these packets
            start = np.maximum(leaving, _last_leap(paths, self._limit))
        moves = _moves(paths, forced, start, self._limit)
        last = moves[-1] // len(movers)
        old = np.flatnonzero(~(clock[-1] - self._origins[movers] < least))
        intervals = []
        if len(old):
            chain = [np.zeros(len(old), np.intp), leaving[old]]
            if start is leaving:
                chain += [rows[old] // len(movers) for rows in moves[1:]]
            before, after = np.stack(chain[:-1]), np.stack(chain[1:])
            begun = np.where(before == 0, self._origins[movers[old]], clock[before])
            found = np.nonzero((after != before) & ~(clock[after - 1] - begun < least))
            ends = sorted(zip(after[found].tolist(), old[found[1]].tolist(), before[found].tolist(), strict=True))
            for end, mover, anchor in ends:
                column = int(movers[mover])
                actor = self._actors[column]
                if anchor:
                    actor.duration = 0.0
                    self._since[column] = first + anchor
                self._sum_up(column, first + end - 1)
                if actor.duration >= self._min_time:
                    actor.anchor = tuple(paths[:, anchor, mover].tolist())
                    intervals.append(actor.interval())
        self._paths[:, 0, movers] = paths[:, last, np.arange(len(movers))]
        self._since[movers] = first + last
        self._origins[movers] = clock[last]
        for column in movers.tolist():
            self._actors[column].duration = 0.0
        return intervals

    def _sum_up(self, column: int, until: int) -> None:
        """Add the lengths of the packets before one to an actor's interval, in order, so that it is rounded as CARLA's."""
        actor, since = self._actors[column], int(self._since[column])
        sums = np.add.accumulate(np.append(actor.duration, self._lengths[since:until]))
        zeros = np.flatnonzero(sums[:-1] == 0.0)
        if len(zeros):
            actor.start = self._elapsed[since + zeros[-1]].item()
        actor.duration = sums[-1].item()
        self._since[column] = until

    def _forget_times(self) -> None:
        for column in self._columns.values():
            self._sum_up(column, self._count)
            self._origins[column] = -max(self._actors[column].duration, 0.0)
        self._since[:] = 0
        self._count = 0


def _moves(paths: Positions, forced: Booleans | None, start: Indices, limit: np.floating[Any]) -> list[Indices]:
    """Return the first moves of all actors, their next moves, and so on, as flat indices; the last move is repeated.

    From each row, the next move is found for all rows at once if it comes within the next few. Actors then hop from move to
    move; where one has stopped, the rows behind are searched.

    Args:
        paths: Positions, (3, rows, actors).
        forced: Rows that are moves wherever the actor is, (rows, actors).
        start: The row of the first move of each actor.
        limit: See `_squared_limit`.
    """
    count, width = paths.shape[1:]
    wait, near = np.ones((count, width), np.uint8), np.ones((count, width), np.bool_)
    lags = min(_LAGS, count - 1)
    for lag in range(1, lags + 1):
        near[:-lag] &= _is_near(paths[:, lag:], paths[:, :-lag], limit)
        if forced is not None:
            near[:-lag] &= ~forced[lag:]
        wait += near
    wait[wait > lags] = 0
    following = np.arange(count * width) + np.multiply(wait, width, dtype=np.intp).ravel()
    paths, forced = paths.reshape(3, -1), None if forced is None else forced.ravel()
    pending = np.arange(width)
    current = start * width + pending
    moves = [current]
    while len(pending):
        hopping = True
        while hopping:
            for _ in range(_HOPS):
                current = following.take(current)
                moves.append(current)
            hopping = bool((following.take(current) != current).any())
        anchors = current[pending]
        found = _next_moves(paths, forced, anchors, width, limit)
        following[anchors] = found
        pending = pending[found != anchors]
    return moves


def _last_leap(paths: Positions, limit: np.floating[Any]) -> Indices:
    """Return the last row of each actor after a step of twice the limit: a move wherever the anchor is."""
    if not _SMALLEST < limit < _LARGEST:
        return np.zeros(paths.shape[2], np.intp)
    leaps = ~_is_near(paths[:, :0:-1], paths[:, -2::-1], limit * limit.dtype.type(4.001))
    return np.where(leaps.any(axis=0), len(leaps) - leaps.argmax(axis=0), 0)


def _next_moves(paths: Positions, forced: Booleans | None, anchors: Indices, width: int, limit: np.floating[Any]) -> Indices:
    """Return the next moves of some actors, or their anchors where there are none, as indices of flat arrays.

    Args:
        paths: Positions, (3, rows of actors).
        forced: See `_moves`.
        anchors: The index of the last move of each actor.
        width: The number of actors of a row.
        limit: See `_squared_limit`.
    """
    found = anchors.copy()
    size = paths.shape[1]
    left = np.arange(len(anchors))
    for window in (_WINDOW, size // width):
        if not len(left):
            break
        ahead = anchors[left, None] + np.arange(1, window + 1) * width
        inside = ahead < size
        ahead = np.minimum(ahead, size - 1)
        moved = ~_is_near(paths.take(ahead, axis=1), paths.take(anchors[left, None], axis=1), limit)
        if forced is not None:
            moved |= forced[ahead]
        moved &= inside
        first = moved.argmax(axis=1)
        hit = moved[np.arange(len(left)), first]
        found[left[hit]] = ahead[hit, first[hit]]
        left = left[~hit & inside[:, -1]]
    return found


def _is_near(positions: Positions, anchors: Positions, limit: np.floating[Any]) -> Booleans:
    """Return which positions are nearer to anchors than a limit, in CARLA's order of arithmetic; NaN is not near."""
    steps = positions - anchors
    steps *= steps
    squares = steps[0]
    squares += steps[1]
    squares += steps[2]
    near: Booleans = squares < limit
    return near


def _lies(records: NDArray[np.void], columns: Indices | slice = slice(None)) -> Booleans:
    """Return which transforms are turned as those of a walker that lies on the ground."""
    lies: Booleans = (np.abs(records["pitch"][..., columns]) > _LYING) | (np.abs(records["roll"][..., columns]) > _LYING)
    return lies


def _last_of_each(ids: NDArray[np.uint32]) -> Indices:
    """Return the indices of the last record of each id, ascending."""
    _, behind = np.unique(ids[::-1], return_index=True)
    return np.sort(len(ids) - 1 - behind)


@np.errstate(all="ignore")
def _squared_limit(distance: float, real: np.dtype[Any]) -> np.floating[Any]:
    """Return the smallest square whose root is not below a distance.

    To compare squares with it gives exactly the results of comparing their roots with the distance, in the precision of the
    recording's lengths, which is that of CARLA's arithmetic.
    """
    zero, infinity = real.type(0.0), real.type(math.inf)
    square = np.square(real.type(max(distance, 0.0)))
    while square > zero and np.sqrt(np.nextafter(square, zero)).item() >= distance:
        square = np.nextafter(square, zero)
    while square < infinity and np.sqrt(square).item() < distance:
        square = np.nextafter(square, infinity)
    return square  # type: ignore[no-any-return]
