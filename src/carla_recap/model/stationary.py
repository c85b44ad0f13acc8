"""Stationary intervals: when, where and for how long each actor of a recording does not move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.lives import HashOrder, PresentActors
from carla_recap.model.segment import last_of_each, segments
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Packet
    from carla_recap.model.records import Table
    from carla_recap.util.arrays import Booleans, Floats, Ids, Indices


MIN_TIME: Final = 30.0  # s
MIN_DISTANCE: Final = 10.0  # cm
TRANSFORMS: Final = "transforms"
TYPES: Final = ("spawned", "destroyed", TRANSFORMS)
"""The record types that stationary intervals are computed from."""

_WALKER: Final = "walker."
_LYING: Final = 60.0  # degrees of pitch or roll from which on a walker lies on the ground
_FRAMES: Final = 256  # that are processed together, at most
_RECORDS: Final = 1 << 15  # that are processed together, at most, where there are several frames
_SLOTS: Final = 64  # for actors, at first


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


class StationaryTracker:
    """Finds the stationary intervals of all actors in the frames of a recording.

    An actor is stationary while it stays within a distance of its anchor, the position that it last moved to. A walker
    that lies on the ground is not stationary.

    Every actor has a slot in an array: its anchor, the start and the duration of its current interval (0 if it has none),
    and whether it can lie on the ground. The slots of the actors of a segment are taken out, carried through its frames, and
    put back.

    Args:
        table: The record types of the recording.
        min_time: The shortest interval to report, in seconds.
        min_distance: The distance from the anchor at which an actor has moved, in cm.
        compat: Whether to reproduce the mistakes of CARLA 0.9.16.
    """

    def __init__(
        self, table: Table, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
    ) -> None:
        real = table.named(TRANSFORMS).dtype["x"]
        self._min_time = min_time
        self._limit = _squared_limit(min_distance, real)
        self._compat = compat
        self._slots = PresentActors[int](compat=compat)
        self._order = HashOrder() if compat else None
        self._states = np.zeros(_SLOTS, [("anchor", real, 3), ("start", "f8"), ("duration", "f8"), ("walks", "?")])
        self._actors: list[tuple[int, str]] = []  # the id and the blueprint of the actor in each slot
        self._free: list[int] = []  # slots
        self._intervals: list[BlockedRow] = []
        self._listed = b""  # the ids of the latest segment, unless actors have come or gone since
        self._found = np.empty(0, np.intp)  # the slots of these

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
                    self._slots.spawn(spawn.id, self._add(spawn.id, readable(spawn.type_id)))
            else:
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    self._destroy(id)

    def take(self) -> list[BlockedRow]:
        """Return the intervals that have ended since the previous call, in order of their ends."""
        intervals, self._intervals = self._intervals, []
        return intervals

    def finish(self) -> list[BlockedRow]:
        """Return the remaining intervals: those that have ended, then those that last until the end."""
        slots = self._slots.actors
        left = slots.values() if self._order is None else [slots[id] for id in self._order.ids()]
        return self.take() + [self._interval(slot) for slot in left if self._states["duration"][slot] >= self._min_time]

    def _add(self, id: int, type_id: str) -> int:
        """Return the slot of a new actor, or of one that takes the place of another with its id."""
        slot = self._slots.actors.get(id)
        if slot is None:
            slot = self._free.pop() if self._free else len(self._actors)
        if slot == len(self._actors):
            self._actors.append((id, type_id))
            if slot == len(self._states):
                self._states = np.concatenate((self._states, np.zeros_like(self._states)))
        self._actors[slot] = id, type_id
        self._states[slot] = 0
        self._states["walks"][slot] = type_id.startswith(_WALKER) and not self._compat
        self._listed = b""
        if self._order is not None:
            self._order.add(id)
        return slot

    def _destroy(self, id: int) -> None:
        slot = self._slots.destroy(id)
        if slot is None:
            return
        self._listed = b""
        self._free.append(slot)
        if self._order is not None:
            self._order.remove(self._actors[slot][0])
        elif self._states["duration"][slot] >= self._min_time:
            self._intervals.append(self._interval(slot))

    def _interval(self, slot: int) -> BlockedRow:
        """Return the current interval of an actor."""
        anchor, start, duration, _ = self._states[slot].item()
        return BlockedRow(start, duration, *self._actors[slot], *map(float, anchor))

    def _slots_of(self, ids: Ids) -> Indices:
        """Return the slots of actors; one whose spawn is not recorded begins with its first transform."""
        listed = ids.tobytes()
        if listed != self._listed:
            slots = self._slots.actors
            for id in ids.tolist():
                if id not in slots:
                    slots[id] = self._add(id, "")
            self._listed, self._found = listed, np.array([slots[id] for id in ids.tolist()], np.intp)
        return self._found

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
        for segment in segments(records):
            slots = self._slots_of(segment.ids)
            times = elapsed[segment.frames], lengths[segment.frames]
            if len(set(slots.tolist())) == len(slots):
                self._intervals += (row for *_, row in self._follow(*times, segment.records, slots))
            elif self._compat:
                for begin, length, listed in zip(*times, segment.records, strict=True):
                    self._repeated(begin, length, listed, slots)
            else:  # the last record of each actor counts
                last = np.sort(last_of_each(segment.ids))
                self._intervals += (row for *_, row in self._follow(*times, segment.records[:, last], slots[last]))

    def _repeated(self, elapsed: float, length: float, records: NDArray[np.void], slots: Indices) -> None:
        """Process a frame that lists actors several times, as CARLA does: each record is another frame for its actor.

        Actors that are listed equally often are processed together: of the ids 7 8 7 9, first 8 9, then 7 and 7.
        """
        order = np.argsort(slots, kind="stable")
        _, first, counts = np.unique(slots[order], return_index=True, return_counts=True)
        found = []
        for count in np.unique(counts).tolist():
            places = order[first[counts == count] + np.arange(count)[:, None]]  # (count, actors)
            times = np.full(count, elapsed), np.full(count, length)
            ended = self._follow(*times, records[places], slots[places[0]])
            found += [(int(places[row, column]), interval) for row, column, interval in ended]
        self._intervals += (interval for _, interval in sorted(found, key=lambda row: row[0]))

    @np.errstate(all="ignore")
    def _follow(
        self, elapsed: Floats, lengths: Floats, records: NDArray[np.void], slots: Indices
    ) -> list[tuple[int, int, BlockedRow]]:
        """Carry the state of different actors through frames that list them.

        Args:
            elapsed: The beginning of each frame, in seconds.
            lengths: The length of each frame, in seconds.
            records: The transforms, (frames, actors).
            slots: The slots of the actors.

        Returns:
            The intervals that end, in order, each with its frame and the position of the actor.
        """
        if len(records) == 1:
            return self._follow_one(elapsed.item(), lengths.item(), records, slots)
        found = []
        most = max(1, min(_FRAMES, _RECORDS // len(slots)))
        if len(records) > most:
            for first in range(0, len(records), most):
                rows = slice(first, first + most)
                ended = self._follow(elapsed[rows], lengths[rows], records[rows], slots)
                found += [(first + row, column, interval) for row, column, interval in ended]
            return found
        states = self._states[slots]
        # Before the first frame, and behind each; at first, the anchors are the positions in the frames.
        anchors = np.empty((len(records) + 1, 3, len(slots)), self._limit.dtype)
        durations = np.zeros((len(records) + 1, len(slots)))
        anchors[0], durations[0] = states["anchor"].T, states["duration"]
        for axis, name in enumerate("xyz"):
            anchors[1:, axis] = records[name]
        moves = ~_carry(anchors, durations, lengths.tolist(), self._limits(records, states["walks"]))
        begins = ~moves & (durations[:-1] == 0.0)
        for row, column in np.argwhere(moves & (durations[:-1] >= self._min_time)).tolist():
            begun = np.flatnonzero(begins[:row, column])
            start = elapsed.item(begun[-1]) if len(begun) else states["start"].item(column)
            actor, anchor = self._actors[slots[column]], anchors[row, :, column].tolist()
            found.append((row, column, BlockedRow(start, durations.item(row, column), *actor, *anchor)))
        latest = len(records) - 1 - begins[::-1].argmax(axis=0)
        states["start"] = np.where(begins.any(axis=0), elapsed[latest], states["start"])
        states["anchor"], states["duration"] = anchors[-1].T, durations[-1]
        self._states[slots] = states
        return found

    def _follow_one(
        self, elapsed: float, length: float, records: NDArray[np.void], slots: Indices
    ) -> list[tuple[int, int, BlockedRow]]:
        """Carry the state of different actors through one frame, as `_follow` does, in a third of its time."""
        states = self._states[slots]
        places = np.array([records[name][0] for name in "xyz"], self._limit.dtype)
        duration = states["duration"]
        squares = np.square(places - states["anchor"].T)
        stays = squares[0] + squares[1] + squares[2] < self._limits(records, states["walks"])[0]
        ended = np.flatnonzero(~stays & (duration >= self._min_time)).tolist()
        found = [(0, column, self._interval(slots.item(column))) for column in ended]
        states["start"][stays & (duration == 0.0)] = elapsed
        states["anchor"][~stays] = places.T[~stays]
        states["duration"] = np.where(stays, duration + length, 0.0)
        self._states[slots] = states
        return found

    def _limits(self, records: NDArray[np.void], walks: Booleans) -> NDArray[Any]:
        """Return the squared distances at which actors have moved, (frames, actors): 0 for walkers on the ground."""
        limits = np.full(records.shape, self._limit)
        for name in ("pitch", "roll") if walks.any() else ():
            lying = np.abs(records[name]) > _LYING
            if lying.any():
                limits[lying & walks] = 0.0
        return limits


def _carry(anchors: NDArray[Any], durations: Floats, lengths: list[float], limits: NDArray[Any]) -> Booleans:
    """Compute anchors and durations frame by frame, in CARLA's order of arithmetic, and return which actors do not move.

    An actor at 9, 18 and 20 cm, whose anchor is 0, moves in the second of these frames, 18 cm from its anchor:
    the anchors become 0, 18 and 18 cm. An actor at no number moves, too.

    Args:
        anchors: The anchors before the first frame, and the positions in the frames, (1 + frames, 3, actors).
        durations: The durations before the first frame, and zeros, (1 + frames, actors).
        lengths: The length of each frame, in seconds.
        limits: The squared distances at which actors have moved, (frames, actors).
    """
    stays = np.empty(limits.shape, np.bool_)
    squares = np.empty_like(anchors[0])
    x, y, z = squares
    subtract, multiply, add, less, copyto = np.subtract, np.multiply, np.add, np.less, np.copyto
    before, until = anchors[0], durations[0]
    for anchor, duration, length, limit, near in zip(anchors[1:], durations[1:], lengths, limits, stays, strict=True):
        subtract(anchor, before, squares)
        multiply(squares, squares, squares)
        add(x, y, x)
        add(x, z, x)
        less(x, limit, near)
        copyto(anchor, before, where=near)
        add(until, length, duration, where=near)
        before, until = anchor, duration
    return stays


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
