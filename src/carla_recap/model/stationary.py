"""Stationary intervals: when, where and for how long each actor of a recording does not move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.lives import HashOrder, PresentActors
from carla_recap.model.segment import last_of_each, segments
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame
    from carla_recap.model.records import Table
    from carla_recap.util.arrays import Booleans, Floats, Indices

MIN_TIME: Final = 30.0  # s
MIN_DISTANCE: Final = 10.0  # cm
TRANSFORMS: Final = "transforms"
TYPES: Final = ("spawned", "destroyed", TRANSFORMS)
"""The record types that stationary intervals are computed from."""

_WALKER: Final = "walker."
_LYING: Final = 60.0  # degrees of pitch or roll from which on a walker lies on the ground
_SHORTEST: Final = math.ulp(0.0)  # s, the shortest interval, but for CARLA


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


def check_limits(min_time: float, min_distance: float) -> None:
    """Raise `RecapError` if a limit of stationary intervals is below 0 or NaN."""
    for name, value, unit in (("min_time", min_time, "s"), ("min_distance", min_distance, "cm")):
        if not value >= 0:
            raise RecapError(f"{name}: expected 0 {unit} or more, found {value:g} {unit}")


class StationaryTracker:
    """Finds the stationary intervals of all actors in the frames of a recording.

    An actor is stationary while it stays within a distance of its anchor, the position that it last moved to, at first that
    of its first transform. A walker that lies on the ground is not stationary. The shortest interval is in s, and the
    distance from the anchor at which an actor has moved in cm. `compat` reproduces the mistakes of CARLA 0.9.16, where the
    first anchor is the origin of the world, and an interval of 0 s is one, too.
    """

    def __init__(
        self, table: Table, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
    ) -> None:
        real = table.named(TRANSFORMS).dtype["x"]
        self._min_time = min_time if compat else max(min_time, _SHORTEST)
        limit: Any = real.type(min_distance)
        # CARLA compares lengths of the recording's precision with a double.
        self._limit = limit if limit.item() >= min_distance else np.nextafter(limit, real.type(math.inf))
        self._compat = compat
        self._slots = PresentActors[int](compat=compat)
        self._order = HashOrder() if compat else None
        self._actors: list[tuple[int, str]] = []  # the id and the blueprint of the actor in each slot
        self._free: list[int] = []  # slots
        # By slot: the anchor, the start and the duration of the interval (0 if there is none), whether it can lie.
        self._states = np.zeros(0, [("anchor", real, 3), ("start", "f8"), ("duration", "f8"), ("walks", "?")])
        self._intervals: list[BlockedRow] = []

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch."""
        if len(batch) > 1:
            columns = [
                each for each in batch.columns if each.type and each.type.name in TYPES and len(each.packet(0).records)
            ]
            if [each.type.name for each in columns if each.type] in ([], [TRANSFORMS]):
                for column in columns:
                    self._transforms(batch.elapsed, batch.duration, column.records)
                return
        for frame in batch:
            self.frame(frame)

    def frame(self, frame: Frame) -> None:
        """Process a frame."""
        for packet in frame.packets:
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
        elif not self._compat and self._states["duration"][slot] >= self._min_time:
            self._intervals.append(self._interval(slot))
        if slot == len(self._actors):
            self._actors.append((id, type_id))
        if slot == len(self._states):
            self._states = np.concatenate((self._states, np.zeros(slot + 1, self._states.dtype)))
        self._actors[slot] = id, type_id
        walks = type_id.startswith(_WALKER) and not self._compat
        self._states[slot] = (0.0 if self._compat else math.nan, 0.0, 0.0, walks)
        if self._order is not None:
            self._order.add(id)
        return slot

    def _destroy(self, id: int) -> None:
        slot = self._slots.destroy(id)
        if slot is None:
            return
        self._free.append(slot)
        if self._order is not None:
            self._order.remove(self._actors[slot][0])
        elif self._states["duration"][slot] >= self._min_time:
            self._intervals.append(self._interval(slot))

    def _interval(self, slot: int) -> BlockedRow:
        """Return the current interval of an actor."""
        anchor, start, duration, _ = self._states[slot].item()
        return BlockedRow(start, duration, *self._actors[slot], *map(float, anchor))

    def _slot_of(self, id: int) -> int:
        """Return the slot of an actor; one whose spawn is not recorded begins with its first transform."""
        slots = self._slots.actors
        if id not in slots:
            slots[id] = self._add(id, "")
        return slots[id]

    def _transforms(self, elapsed: Floats, duration: Floats, records: NDArray[np.void]) -> None:
        """Process the transforms of consecutive frames, (frames, transforms of each), with times and durations in s."""
        if not records.shape[1]:
            return
        lengths = duration if self._compat else np.fmax(duration, 0.0)
        for segment in segments(records):
            slots = np.array([self._slot_of(id) for id in segment.ids.tolist()], np.intp)
            times = elapsed[segment.frames], lengths[segment.frames]
            if len(np.unique(slots)) == len(slots):
                self._follow(*times, segment.records, slots)
            elif not self._compat:  # the last record of each actor counts
                last = np.sort(last_of_each(segment.ids))
                self._follow(*times, segment.records[:, last], slots[last])
            else:  # as in CARLA, each record is another frame for its actor
                for begin, length, listed in zip(*times, segment.records, strict=True):
                    for place, slot in zip(listed, slots, strict=True):
                        self._follow(begin[None], length[None], place.reshape(1, 1), slot[None])

    @np.errstate(all="ignore")
    def _follow(self, elapsed: Floats, lengths: Floats, records: NDArray[np.void], slots: Indices) -> None:
        """Carry the state of actors through frames that list them, (frames, actors), in CARLA's order of arithmetic.

        An actor at 9, 18 and 20 cm, whose anchor is 0, moves in the second of these frames, 18 cm from its anchor: the
        anchors become 0, 18 and 18 cm. An actor at no number moves, too.
        """
        states = self._states[slots]
        # Before the first frame, and behind each; at first, the anchors are the positions in the frames.
        places = np.stack([records[axis] for axis in "xyz"], axis=1)
        anchors = np.concatenate((states["anchor"].T[None], places))
        durations = np.zeros((len(records) + 1, len(slots)))
        durations[0] = states["duration"]
        stays = self._standing(records, states["walks"])
        steps = np.empty_like(anchors[0])
        x, y, z = steps
        for before, after, until, duration, length, near in zip(
            anchors[:-1], anchors[1:], durations[:-1], durations[1:], lengths.tolist(), stays, strict=True
        ):
            np.subtract(after, before, steps)
            np.multiply(steps, steps, steps)
            np.add(x, y, x)
            np.add(x, z, x)
            np.less(np.sqrt(x, x), self._limit, near, where=near)
            np.copyto(after, before, where=near)
            np.add(until, length, duration, where=near)
        begins = stays & (durations[:-1] == 0.0)
        for row, column in np.argwhere(~stays & (durations[:-1] >= self._min_time)).tolist():
            begun = np.flatnonzero(begins[:row, column])
            start = elapsed.item(begun[-1]) if len(begun) else states["start"].item(column)
            actor, anchor = self._actors[slots[column]], anchors[row, :, column].tolist()
            self._intervals.append(BlockedRow(start, durations.item(row, column), *actor, *anchor))
        latest = len(records) - 1 - begins[::-1].argmax(axis=0)
        states["start"] = np.where(begins.any(axis=0), elapsed[latest], states["start"])
        states["anchor"], states["duration"] = anchors[-1].T, durations[-1]
        self._states[slots] = states

    def _standing(self, records: NDArray[np.void], walks: Booleans) -> Booleans:
        """Return which actors are no walkers that lie on the ground, (frames, actors)."""
        if not walks.any():
            return np.ones(records.shape, np.bool_)
        pitch, roll = (np.abs((records[axis].astype(np.float64) + 180.0) % 360.0 - 180.0) for axis in ("pitch", "roll"))
        lies: Booleans = (pitch > _LYING) | (roll > _LYING)
        return ~(lies & walks)
