"""How far the paths of an actor in two recordings part, and how long the states of a traffic light differ.

Frames are compared on their elapsed times. Nothing is aligned or shifted.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ActorLife
from carla_recap.model.motion import possible_step
from carla_recap.model.records import CM, Spawn
from carla_recap.model.segment import SegmentBuffer, segments
from carla_recap.queries.recorded_actors import actors

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.util.arrays import Booleans, Floats, Indices

_FIELDS: Final = {"transforms": ("x", "y", "z", "yaw"), "light_states": ("state",)}
_FRAMES: Final = 1024  # that are compared at once
_ROUNDING: Final = 1e-9  # degrees; between angles that are whole turns apart


class ActorFrames(NamedTuple):
    """Fields of the records of an actor in some frames, (fields, frames), and which of these have a record, (frames,)."""

    values: NDArray[Any]
    known: Booleans


class RecordedPaths:
    """What is compared of a recording, read once, some frames at a time: their elapsed seconds and durations, (frames,)."""

    def __init__(self, source: Reader) -> None:
        self.source = source
        self.lives = list(actors(source))  # by number: in order of appearance, then those whose spawn is not recorded
        self.unknown: dict[int, int] = {}  # the numbers of the latter, by id
        self.poses: Counter[int] = Counter()  # in how many of the frames so far each actor has a pose, by number
        self._numbers: dict[int, list[int]] = defaultdict(list)
        for number, life in enumerate(self.lives):
            self._numbers[life.id].append(number)
        times = [np.stack((each.elapsed, each.duration)) for each in source.batches(()) if not each.preamble]
        self.elapsed, self.duration = np.concatenate([np.empty((2, 0)), *times], axis=1)
        self._batches = (batch for batch in source.batches(tuple(_FIELDS)) if not batch.preamble)
        self._buffers = {name: SegmentBuffer() for name in _FIELDS}
        self._first = self._done = 0  # the first frame that is in memory, and the one after the latest that was returned

    def number(self, id: int, time: float) -> int | None:
        """Return the number of the actor that had an id at a time, as `ActorLives.at` has it."""
        numbers = self._numbers.get(id)
        if numbers is None or id in self.unknown:
            return None
        return numbers[max(bisect_right(numbers, time, key=lambda number: self.lives[number].spawned_at) - 1, 0)]

    def window(self, start: int, stop: int) -> dict[str, dict[int, ActorFrames]]:
        """Return the records of some frames, by type and number of the actor; none before the start are read later."""
        for skipped in range(self._done, start, _FRAMES):
            self.window(skipped, min(skipped + _FRAMES, start))
        transforms = self._buffers["transforms"]
        while self._first + transforms.frames < stop and (batch := next(self._batches, None)) is not None:
            self._add(batch)
        for buffer in self._buffers.values():
            buffer.drop(start - self._first)
        self._first = start
        found = {name: dict(self._by_number(name, stop)) for name in _FIELDS}
        for number, poses in found["transforms"].items():
            self.poses[number] += int(np.count_nonzero(poses.known[self._done - start :]))
        self._done = stop
        return found

    def _add(self, batch: Batch) -> None:
        for name, buffer in self._buffers.items():
            found = list(segments(records)) if (records := batch.records(name)).size else []
            for id in (id for segment in found for id in dict.fromkeys(segment.ids.tolist()) if name == "transforms"):
                if id not in self._numbers:
                    self.unknown[id] = len(self.lives)
                    self._numbers[id].append(len(self.lives))
                    spawn = Spawn(id, x=math.nan, y=math.nan, z=math.nan)
                    self.lives.append(ActorLife(id, "", "", "", math.nan, spawn=spawn))
            buffer.add(found, len(batch))

    def _by_number(self, name: str, stop: int) -> Iterator[tuple[int, ActorFrames]]:
        buffer, count, time = self._buffers[name], stop - self._first, self.elapsed[self._first : stop]
        ids = buffer.ids(0, count)
        values, known = buffer.dense(_FIELDS[name], ids, 0, count)
        for row, id in enumerate(ids.tolist()):
            numbers = self._numbers.get(id, [])
            turn = np.searchsorted([self.lives[number].spawned_at for number in numbers[1:]], time, "right")
            for which, number in enumerate(numbers):
                yield number, ActorFrames(values[:, row], known[row] & (turn == which))


class FramePairs(NamedTuple):
    """Which frames of recording b are around each frame of recording a, (frames of a,)."""

    before: Indices  # the last one before it, or the one that has the same time; -1 if b has none around it
    after: Indices  # the first one after it
    weight: Floats  # the share of the latter
    seconds: Floats  # the time between the two

    def of(self, rows: Indices, first: int) -> FramePairs:
        """Return those of some frames of a, with frames of b counted from one of them."""
        return FramePairs(self.before[rows] - first, self.after[rows] - first, self.weight[rows], self.seconds[rows])


@np.errstate(all="ignore")
def pair_frames(a: Floats, b: Floats) -> FramePairs:
    """Return which frames of b are around each frame of a, by their elapsed seconds.

    Times that go back, or are no numbers, count as the latest before, or as the first one. Of several frames at one time,
    the n-th of a has the n-th of b, or the last one.
    """
    if not len(b):
        nowhere = np.full(len(a), -1)
        return FramePairs(nowhere, nowhere, *np.zeros((2, len(a))))
    a, b = _ascending(a), _ascending(b)
    first, stop = np.searchsorted(b, a), np.searchsorted(b, a, "right")
    rank = np.arange(len(a)) - np.searchsorted(a, a)
    is_same = first < stop
    before = np.where(is_same, np.minimum(first + rank, stop - 1), first - 1)
    after = np.where(is_same, before, first)
    earlier, later = a - b[np.maximum(before, 0)], b[np.minimum(after, len(b) - 1)] - a
    is_after = (after < len(b)) & (later <= SAME_TIME)
    is_before = (before >= 0) & (earlier <= SAME_TIME) & ~is_after
    before, after = np.where(is_after, after, before), np.where(is_before, before, after)
    valid = (before >= 0) & (after < len(b))
    before, after = np.where(valid, before, -1), np.where(valid, after, -1)
    seconds = b[after] - b[before]
    return FramePairs(before, after, np.where(seconds > 0, earlier / seconds, 0.0), seconds)


def _ascending(time: Floats) -> Floats:
    is_time = np.isfinite(time)
    return np.maximum.accumulate(np.where(is_time, time, time[is_time.argmax()] if is_time.any() else 0.0))


@dataclass
class PathDifference:
    """How far two paths part; the first attributes are those of `ActorDifference`, beside them sums of finite distances."""

    frames: int = 0
    first: float | None = None
    first_distance: float | None = None
    mean: float = math.nan
    rms: float = math.nan
    max: float = math.nan
    max_at: float = math.nan
    final: float = math.nan
    heading: float = 0.0
    finite: int = 0
    total: float = 0.0
    squares: float = 0.0

    def add(self, time: Floats, mine: Floats, theirs: Floats, tolerance: float) -> None:
        """Add the poses of both in the next frames, x, y, z in cm and yaw in degrees, (4, frames); the tolerance is in m."""
        same = (mine == theirs) | (np.isnan(mine) & np.isnan(theirs))
        steps = np.where(same, 0.0, mine - theirs)
        distance = np.sqrt((steps[:3] ** 2).sum(axis=0)) * CM
        finite = distance[np.isfinite(distance)]
        distance = np.where(np.isfinite(distance), distance, np.inf)
        turn = np.abs(_turn(steps[3]))
        beyond, largest = np.flatnonzero(distance > tolerance), distance.argmax().item()
        if self.first is None and len(beyond):
            self.first, self.first_distance = time.item(beyond[0]), distance.item(beyond[0])
        if not distance[largest] <= self.max:
            self.max, self.max_at = distance.item(largest), time.item(largest)
        self.frames += len(time)
        self.final = distance.item(-1)
        self.heading = max(self.heading, np.where(np.isfinite(turn) & (turn > _ROUNDING), turn, 0.0).max().item())
        self.finite += len(finite)
        self.total += finite.sum().item()
        self.squares += (finite**2).sum().item()
        if self.finite:
            self.mean, self.rms = self.total / self.finite, math.sqrt(self.squares / self.finite)


class StateDifference:
    """How long the states of a traffic light differ: the first time at which they do, and the seconds."""

    first: float | None = None
    seconds = 0.0


@np.errstate(all="ignore")
def compare(
    a: RecordedPaths, b: RecordedPaths, partners: Mapping[int, int], tolerance: float
) -> tuple[dict[int, PathDifference], dict[int, StateDifference]]:
    """Return how far the paths of actors part, and how long the states of lights differ, by number in a.

    Both are read to their ends, and compared at the frames of a. Partners are the numbers in b of the actors of a; actors
    whose spawn is in neither of them are compared if they have the same id. Paths differ beyond the tolerance, in m.
    """
    pairs = pair_frames(a.elapsed, b.elapsed)
    paths: dict[int, PathDifference] = defaultdict(PathDifference)
    states: dict[int, StateDifference] = defaultdict(StateDifference)
    start = stop = 0
    while stop < len(a.elapsed):
        start, stop = stop, min(stop + _FRAMES, len(a.elapsed))
        while stop - start > 1 and pairs.after[start:stop].max() - pairs.before[start] > 2 * _FRAMES:
            stop = start + (stop - start) // 2
        ours, valid = a.window(start, stop), np.flatnonzero(pairs.before[start:stop] >= 0)
        if not len(valid):
            continue
        rows = start + valid
        first, last = pairs.before[rows].min().item(), pairs.after[rows].max().item()
        theirs, some = b.window(first, last + 1), pairs.of(rows, first)
        time, duration = a.elapsed[rows], a.duration[rows]
        known = {number: b.unknown[id] for id, number in a.unknown.items() if id in b.unknown} | dict(partners)
        for name in _FIELDS:
            for number in ours[name].keys() & known.keys():
                if (other := theirs[name].get(known[number])) is None:
                    continue
                mine = ActorFrames(ours[name][number].values[:, valid], ours[name][number].known[valid])
                if name == "transforms":
                    _compare_poses(paths[number], mine, other, some, time, tolerance)
                else:
                    _compare_states(states[number], mine, other, some, time, duration)
    b.window(len(b.elapsed), len(b.elapsed))
    return paths, states


def _compare_poses(
    path: PathDifference, mine: ActorFrames, other: ActorFrames, pairs: FramePairs, time: Floats, tolerance: float
) -> None:
    """Add the frames in which both poses are known; that of b is interpolated, but not across a jump."""
    known = mine.known & other.known[pairs.before] & other.known[pairs.after]
    theirs = other.values[:, pairs.before].astype(np.float64)
    between = pairs.before != pairs.after
    if between.any():
        steps = other.values[:, pairs.after] - theirs
        steps[3] = _turn(steps[3])
        known &= ~(np.sqrt((steps[:3] ** 2).sum(axis=0)) * CM > possible_step(pairs.seconds))
        theirs = np.where(between, theirs + pairs.weight * steps, theirs)
    if known.any():
        path.add(time[known], mine.values[:, known], theirs[:, known], tolerance)


def _compare_states(
    light: StateDifference, mine: ActorFrames, other: ActorFrames, pairs: FramePairs, time: Floats, duration: Floats
) -> None:
    """Add the frames in which the state is that of neither of the frames of b around them."""
    (state,), (before,), (after,) = mine.values, other.values[:, pairs.before], other.values[:, pairs.after]
    differs = mine.known & other.known[pairs.before] & (state != before)
    differs &= (state != after) | ~other.known[pairs.after]
    if differs.any():
        light.first = time[differs].item(0) if light.first is None else light.first
        lasts = duration[differs]
        light.seconds += np.where(np.isfinite(lasts), np.maximum(lasts, 0.0), 0.0).sum().item()


def _turn(degrees: Floats) -> Floats:
    """Return angles within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0
