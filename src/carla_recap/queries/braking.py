"""Which vehicles brake hard, when, and where.

The deceleration at a moment is the slope of a straight line through the speeds around it, so that a single wrong one counts
for little; and it must last, so that what stops at once (in a crash, by a teleport) is not taken for braking.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.records import CM

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch

    Floats = NDArray[np.float64]
    Booleans = NDArray[np.bool_]

HALF_WINDOW: Final = 0.125  # s; the speeds around a moment are those so long before and after it
SHORTEST: Final = 0.3  # s
_FEWEST: Final = 3  # moments of a braking
_GAP: Final = 1.0  # s; what comes later goes on with nothing
_JUMP: Final = 5.0  # m; whatever is shorter is no jump
_TOP_SPEED: Final = 100.0  # m/s; what is faster is a jump, where the velocity is not recorded
_SLACK: Final = 3.0  # a jump is longer than so many times the way that the recorded velocity explains
_ROUNDING: Final = 1e-6  # s
_SURE: Final = 0.999  # of a limit; what is below is below it in the precision of the file, too

_BLOCK: Final = 100_000  # rows that are taken together
_MARGIN: Final = 16  # frames that a block shares with its neighbour


class Braking(NamedTuple):
    """A vehicle brakes.

    Attributes:
        id: The vehicle.
        start: When it begins, in elapsed seconds.
        stop: When it ends.
        x, y, z: Where it begins, in cm, left-handed.
        speed: How fast the vehicle is then over the ground, in m/s.
    """

    id: int
    start: float
    stop: float
    x: float
    y: float
    z: float
    speed: float


def hard_braking(source: Reader, vehicles: Collection[int], deceleration: float) -> list[Braking]:
    """When vehicles brake hard for a while.

    Speeds are those recorded, and where there is none, the slope of the positions.

    Args:
        source: The recording.
        vehicles: The ids to look at.
        deceleration: In m/s²; what is more is hard.

    Returns:
        By id, then start.

    Raises:
        FormatError: The file contradicts its format.
    """
    watch = _Watch(vehicles, deceleration)
    for batch in source.batches(("transforms", "velocities")):
        watch.batch(batch)
    return watch.finish()


class _Watch:
    """Gathers the rows of vehicles batch by batch, and looks at them in blocks.

    Args:
        vehicles: The ids to look at.
        deceleration: What is hard, in m/s².
    """

    def __init__(self, vehicles: Collection[int], deceleration: float) -> None:
        self._vehicles = np.array(sorted(vehicles), np.uint32)
        self._deceleration = deceleration
        self._poses = _Rows(self._vehicles)
        self._velocities = _Rows(self._vehicles)
        self._elapsed: list[float] = []  # of the frames of the block
        self._first = 0  # the number of the block's first frame
        self._done = 0  # the number of the first frame that is not looked at yet
        self._runs: list[NDArray[np.void]] = []

    def batch(self, batch: Batch) -> None:
        """Take in the frames of a batch."""
        poses = batch.records("transforms")
        if not poses.shape[1]:
            return
        self._poses.add(poses)
        self._velocities.add(batch.records("velocities"))
        self._elapsed.extend(batch.elapsed.tolist())
        if self._poses.count >= _BLOCK and len(self._elapsed) > 4 * _MARGIN:
            self._look(len(self._elapsed) - _MARGIN)

    def finish(self) -> list[Braking]:
        """All that was seen."""
        if self._poses.count:
            self._look(len(self._elapsed))
        if not self._runs:
            return []
        runs = np.concatenate(self._runs)
        runs = runs[np.lexsort((runs["first"], runs["id"]))]
        runs = _joined(runs, runs["first"][1:] == runs["last"][:-1] + 1)
        lengths = runs["stop"] - runs["start"]
        runs = runs[(lengths >= SHORTEST - _ROUNDING) & (runs["last"] - runs["first"] >= _FEWEST - 1)]
        runs = _joined(runs, runs["start"][1:] - runs["stop"][:-1] < _GAP)
        return [Braking(*run) for run in runs[list(Braking._fields)].tolist()]

    def _look(self, until: int) -> None:
        """Look at the frames of the block up to some place; its last ones stay for the next block."""
        with np.errstate(all="ignore"):
            elapsed = np.array(self._elapsed)
            suspects = _suspects(self._poses, self._velocities, elapsed, self._deceleration)
            if len(suspects):
                track = _Track(*self._poses.table(suspects), *self._velocities.table(suspects), elapsed)
                hard = track.deceleration() >= self._deceleration
                hard &= (track.frame >= self._done - self._first) & (track.frame < until)
                self._runs.append(track.runs(hard, self._first))
        self._done = self._first + until
        kept = max(until - _MARGIN, 0)
        self._poses.forget(kept)
        self._velocities.forget(kept)
        del self._elapsed[:kept]
        self._first += kept


class _Rows:
    """The rows of vehicles in the packets of a type, one packet per frame.

    Attributes:
        count: How many there are.
    """

    def __init__(self, vehicles: NDArray[np.uint32]) -> None:
        self.count = 0
        self._vehicles = vehicles
        self._parts: list[_Part] = []

    def add(self, records: NDArray[np.void]) -> None:
        """Take in the packets of some frames, (frames, records of each)."""
        ids = np.ascontiguousarray(records["id"])
        edges = [0, *(np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1).tolist(), len(ids)]
        for start, stop in pairwise(edges):
            columns = np.flatnonzero(_among(ids[start], self._vehicles))
            part = _Part(records[start:stop], columns, ids[start, columns])
            self._parts.append(part)
            self.count += part.size

    @property
    def is_restless(self) -> bool:
        """Whether most frames list others than those around them."""
        return 2 * len(self._parts) > sum(map(len, self._parts))

    def ids(self) -> NDArray[np.uint32]:
        """Return the vehicles that have any rows, ascending."""
        different = {part.ids.tobytes(): part.ids for part in self._parts}
        return np.unique(np.concatenate(list(different.values()))) if different else self._vehicles[:0]

    def columns(self, names: str, ids: NDArray[np.uint32]) -> NDArray[np.floating[Any]]:
        """Return fields of all rows, (fields, frames, vehicles); not a number where a vehicle has no row.

        Args:
            names: The fields, of a letter each.
            ids: The vehicles, ascending: all that have any rows.
        """
        values = np.full((len(names), sum(map(len, self._parts)), len(ids)), np.nan, self._parts[0].records.dtype[names[0]])
        at = 0
        for part in self._parts:
            places = np.searchsorted(ids, part.ids)
            for number, name in enumerate(names):
                values[number, at : at + len(part), places] = part.records[name][:, part.columns].T
            at += len(part)
        return values

    def table(self, ids: NDArray[np.uint32]) -> tuple[NDArray[np.void], NDArray[np.intp]]:
        """Return the last row of each vehicle in each frame, and the number of that frame; by id, then frame."""
        taken = [part.records[:, part.columns[_among(part.ids, ids)]] for part in self._parts]
        rows = np.concatenate([records.ravel() for records in taken])
        sizes = np.concatenate([np.full(len(records), records.shape[1]) for records in taken])
        frames = np.repeat(np.arange(len(sizes)), sizes)
        order = np.argsort(rows["id"], kind="stable")
        rows, frames = rows[order], frames[order]
        last = np.append((np.diff(frames) != 0) | (np.diff(rows["id"]) != 0), True)[: len(rows)]
        return rows[last], frames[last]

    def forget(self, count: int) -> None:
        """Drop the first frames."""
        while self._parts and len(self._parts[0]) <= count:
            part = self._parts.pop(0)
            count -= len(part)
            self.count -= part.size
        if count:
            part = self._parts[0]
            self._parts[0] = _Part(part.records[count:], part.columns, part.ids)
            self.count -= count * len(part.columns)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The packets of some frames that list the same vehicles.

    Attributes:
        records: Their records, (frames, records of each).
        columns: Which of the records are of vehicles.
        ids: The vehicles.
    """

    records: NDArray[np.void]
    columns: NDArray[np.intp]
    ids: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.records)

    @property
    def size(self) -> int:
        """The number of rows of vehicles."""
        return len(self.records) * len(self.columns)


def _suspects(poses: _Rows, velocities: _Rows, elapsed: Floats, deceleration: float) -> NDArray[np.uint32]:
    """Return the vehicles that may brake hard in some frames: all that do, and a few others.

    The slope of a line through speeds is a mean of the slopes from one to the next, so a vehicle that brakes is one whose
    speed falls that fast from some frame to the next. What jumps, or is not in all of the frames, may brake.
    """
    ids = poses.ids()
    if poses.is_restless:
        return ids
    seconds = np.diff(elapsed)[:, None]
    if len(elapsed) <= _FEWEST or not (seconds > 0).all() or not (seconds < _GAP).all():
        return ids
    places = poses.columns("xyz", ids)
    steps = places[:, 1:] - places[:, :-1]
    jumps = ~((steps * steps).sum(axis=0) < np.square(_SURE * _TOP_SPEED / CM * seconds)).all(axis=0)
    ways = np.concatenate((steps[:2, :1], places[:2, 2:] - places[:2, :-2], steps[:2, -1:]), axis=1)
    around = np.concatenate((seconds[:1], seconds[1:] + seconds[:-1], seconds[-1:]))
    speed = np.sqrt((ways * ways).sum(axis=0)) / (around / CM)
    if velocities.count:
        measured = velocities.ids()
        x, y = velocities.columns("xy", measured)
        known = np.isin(measured, ids)
        column = np.searchsorted(ids, measured[known])
        speed[:, column] = np.hypot(x, y)[:, known]
        jumps[column] = False
    slower = ~(speed[:-1] * (2 - _SURE) - speed[1:] < _SURE * deceleration * seconds)
    found: NDArray[np.uint32] = ids[jumps | slower.any(axis=0)]
    return found


_RUN: Final = np.dtype(
    [("first", "i8"), ("last", "i8"), ("id", "u4")] + [(name, "f8") for name in Braking._fields if name != "id"]
)


class _Track:
    """The ways of vehicles in some frames, one behind the other.

    Args:
        poses: Their transforms, by id, then frame.
        frame: The frame of each.
        velocities: Recorded velocities, in the same order.
        velocity_frame: The frame of each.
        elapsed: The elapsed seconds of each frame.
    """

    def __init__(
        self,
        poses: NDArray[np.void],
        frame: NDArray[np.intp],
        velocities: NDArray[np.void],
        velocity_frame: NDArray[np.intp],
        elapsed: Floats,
    ) -> None:
        self.frame = frame
        self._poses = poses
        self._time = elapsed[frame]
        self._place = np.stack([poses[axis].astype(np.float64) * CM for axis in "xyz"])
        recorded = _speeds(poses["id"], frame, velocities, velocity_frame)
        self._goes_on = self._connected(recorded)  # from each row to the next one
        # A clock on which rows that do not belong together are far apart.
        steps = np.where(self._goes_on, np.diff(self._time), 2 * _GAP)
        self._clock = np.concatenate(([0.0], np.cumsum(steps)))[: len(frame)]
        self._speed = np.where(np.isnan(recorded), self._slopes(), recorded)

    def deceleration(self) -> Floats:
        """Of each row, in m/s²; NaN where it cannot be told."""
        count = np.ones(len(self.frame))
        time, speed, squares, products = np.zeros((4, len(count)))
        for apart in range(1, min(_MARGIN, len(count))):
            seconds, change = (values[apart:] - values[:-apart] for values in (self._clock, self._speed))
            near = self._goes_on if apart == 1 else seconds <= HALF_WINDOW + _ROUNDING
            if not near.any():
                break
            seconds, change = np.where(near, seconds, 0), np.where(near, change, 0)
            for rows, sign in ((slice(None, -apart), 1), (slice(apart, None), -1)):
                count[rows] += near
                time[rows] += sign * seconds
                speed[rows] += sign * change
                squares[rows] += seconds * seconds
                products[rows] += seconds * change
        slope: Floats = (count * products - time * speed) / (count * squares - time * time)
        return -slope

    def runs(self, hard: Booleans, number: int) -> NDArray[np.void]:
        """The stretches of rows, each of a vehicle in frame after frame, in which it brakes.

        Args:
            hard: The rows.
            number: The number of the block's first frame.
        """
        rows = np.flatnonzero(hard)
        goes_on = (np.diff(rows) == 1) & (np.diff(self.frame[rows]) == 1) & self._goes_on[rows[:-1]]
        runs = np.zeros(len(rows), _RUN)
        runs["id"] = self._poses["id"][rows]
        runs["first"] = runs["last"] = number + self.frame[rows]
        runs["start"] = runs["stop"] = self._time[rows]
        for axis in "xyz":
            runs[axis] = self._poses[axis][rows]
        runs["speed"] = self._speed[rows]
        return _joined(runs, goes_on)

    def _connected(self, recorded: Floats) -> Booleans:
        """Whether a row and the next one are of a vehicle that neither jumps nor stays away."""
        seconds = np.diff(self._time)
        way = np.sqrt((np.diff(self._place) ** 2).sum(axis=0))
        speed = np.fmax(recorded[1:], recorded[:-1])
        explained = np.where(np.isnan(speed), _TOP_SPEED * seconds, _SLACK * speed * seconds)
        # What is not a number connects nothing.
        near = way <= np.maximum(explained, np.where(np.isnan(speed), 0.0, _JUMP))
        near &= (np.diff(self._poses["id"]) == 0) & (seconds > 0) & (seconds <= _GAP)
        return np.asarray(near)

    def _slopes(self) -> Floats:
        """The speed over the ground, in m/s, that the positions around tell of."""
        rows = np.arange(len(self.frame))
        before = rows - np.insert(self._goes_on, 0, False)[: len(rows)]
        after = rows + np.append(self._goes_on, False)[: len(rows)]
        way = self._place[:2, after] - self._place[:2, before]
        return np.asarray(np.hypot(*way) / (self._time[after] - self._time[before]))


def _speeds(
    ids: NDArray[np.uint32], frame: NDArray[np.intp], velocities: NDArray[np.void], velocity_frame: NDArray[np.intp]
) -> Floats:
    """The recorded speeds over the ground, in m/s, of some vehicles in some frames; NaN where there is none."""
    speeds = np.full(len(ids), np.nan)
    if len(velocities):
        keys, wanted = _keys(velocities["id"], velocity_frame), _keys(ids, frame)
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        there = keys[found] == wanted
        speeds[there] = np.hypot(velocities["x"], velocities["y"])[found[there]]
    return speeds


def _among(ids: NDArray[np.uint32], others: NDArray[np.uint32]) -> Booleans:
    """Return which ids are among others, which ascend."""
    if not len(others):
        return np.zeros(len(ids), np.bool_)
    found: Booleans = others[np.minimum(np.searchsorted(others, ids), len(others) - 1)] == ids
    return found


def _keys(ids: NDArray[np.uint32], frame: NDArray[np.intp]) -> NDArray[np.uint64]:
    """A number for each id and frame, in their order."""
    return (ids.astype(np.uint64) << np.uint64(32)) + frame.astype(np.uint64)


def _joined(runs: NDArray[np.void], goes_on: Booleans) -> NDArray[np.void]:
    """Runs in order, those that go on with the next one (of the same vehicle) made one with it."""
    if not len(runs):
        return runs
    apart = ~(goes_on & (runs["id"][1:] == runs["id"][:-1]))
    first, last = np.append(True, apart), np.append(apart, True)
    joined: NDArray[np.void] = runs[first]
    for name in ("last", "stop"):
        joined[name] = runs[name][last]
    return joined
