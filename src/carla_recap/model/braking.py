"""Hard braking: which vehicles brake hard, when and where.

The deceleration at a moment is the slope of a straight line through the speeds around it, so that a single wrong speed has
little effect. It must last for a while, so that a sudden stop (in a crash, by a teleport) does not count as braking.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.records import CM, ActorKind

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.records import Spawn

    Booleans = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Ids = NDArray[np.uint32]
    Indices = NDArray[np.intp]

HARD: Final = 6.0
"""The deceleration from which on braking is hard, in m/s², unless a query asks for another one."""
TYPES: Final = ("transforms", "velocities")
"""The record types that hard braking is computed from."""
HALF_WINDOW: Final = 0.125  # s before and after a moment, of which the speeds count
SHORTEST: Final = 0.3  # s
_FEWEST: Final = 3  # frames of hard braking
_GAP: Final = 1.0  # s between frames of a vehicle that belong together, at most
_JUMP: Final = 5.0  # m; a shorter step is no jump
_TOP_SPEED: Final = 100.0  # m/s; a faster step is a jump where no velocity is recorded
_SLACK: Final = 3.0  # a jump is longer than the recorded velocity explains by more than this factor
_ROUNDING: Final = 1e-6  # s
_DIGITS: Final = 6  # of decelerations, beyond which they depend on where the frames that are read begin
_SURE: Final = 0.999  # a value below this share of a limit is below it in the precision of the file, too

_BLOCK: Final = 100_000  # records that are evaluated together
_MARGIN: Final = 16  # frames that a block shares with the next one


class Braking(NamedTuple):
    """A vehicle brakes hard.

    Attributes:
        id: The vehicle.
        start: The beginning, in elapsed seconds.
        stop: The end, in elapsed seconds.
        x, y, z: The position at the start, in cm, left-handed.
        speed: The speed over the ground at the start, in m/s.
    """

    id: int
    start: float
    stop: float
    x: float
    y: float
    z: float
    speed: float


class BrakingDetector:
    """Finds hard braking in the frames of a recording.

    Speeds are those recorded, and the slopes of the positions where no velocities are recorded.

    Args:
        vehicles: The ids of the vehicles.
        deceleration: The deceleration from which on braking is hard, in m/s².
    """

    def __init__(self, vehicles: Collection[int], deceleration: float) -> None:
        self._deceleration = deceleration
        ids = np.array(sorted(vehicles), np.uint32)
        self._transforms, self._velocities = _VehicleRecords(ids), _VehicleRecords(ids)
        self._elapsed: list[float] = []  # of the frames of the block
        self._first = 0  # the number of the block's first frame
        self._done = 0  # the number of the first frame that is not evaluated yet
        self._runs: list[NDArray[np.void]] = []
        self._hard: list[Floats] = []  # ids, times and decelerations of vehicles in the frames in which they brake hard

    def add_spawns(self, spawns: Iterable[Spawn]) -> bool:
        """Add the vehicles among spawned actors; return False if one of them had records before, which were left out."""
        new = {spawn.id for spawn in spawns if spawn.kind == ActorKind.VEHICLE}
        if not new:
            return True
        return self._transforms.add_vehicles(new) and self._velocities.add_vehicles(new)

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        transforms = batch.records("transforms")
        if not transforms.shape[1]:
            return
        self._transforms.add(transforms)
        self._velocities.add(batch.records("velocities"))
        self._elapsed.extend(batch.elapsed.tolist())
        if self._transforms.count >= _BLOCK and len(self._elapsed) > 4 * _MARGIN:
            self._evaluate(len(self._elapsed) - _MARGIN)

    def finish(self) -> list[Braking]:
        """Return the hard braking in all frames, by id, then start."""
        if self._transforms.count:
            self._evaluate(len(self._elapsed))
        if not self._runs:
            return []
        runs = np.concatenate(self._runs)
        runs = runs[np.lexsort((runs["first"], runs["id"]))]
        runs = _joined(runs, runs["first"][1:] == runs["last"][:-1] + 1)
        lengths = runs["stop"] - runs["start"]
        runs = runs[(lengths >= SHORTEST - _ROUNDING) & (runs["last"] - runs["first"] >= _FEWEST - 1)]
        runs = _joined(runs, runs["start"][1:] - runs["stop"][:-1] < _GAP)
        return [Braking(*run) for run in runs[list(Braking._fields)].tolist()]

    def hardest(self, id: int, start: float, stop: float) -> tuple[float, float]:
        """Return the greatest deceleration of a vehicle that brakes hard, in m/s², and its time, after `finish`.

        Args:
            id: The vehicle.
            start: The elapsed seconds from which on it is looked for.
            stop: The elapsed seconds until which it is looked for.
        """
        ids, times, decelerations = np.concatenate((np.zeros((3, 0)), *self._hard), axis=1)
        among = np.flatnonzero((ids == id) & (times >= start) & (times <= stop))
        if not len(among):
            return math.nan, math.nan
        row = among[decelerations[among].argmax()]
        return float(decelerations[row]), float(times[row])

    @np.errstate(all="ignore")
    def _evaluate(self, until: int) -> None:
        """Evaluate the frames of the block before one; the last of them stay as the margin of the next block."""
        elapsed = np.array(self._elapsed)
        suspects = _suspects(self._transforms, self._velocities, elapsed, self._deceleration)
        if len(suspects):
            motion = _VehicleMotion(*self._transforms.table(suspects), *self._velocities.table(suspects), elapsed)
            deceleration = motion.deceleration()
            hard = deceleration >= self._deceleration
            hard &= (motion.frame >= self._done - self._first) & (motion.frame < until)
            self._runs.append(motion.runs(hard, self._first))
            values = np.round(deceleration[hard], _DIGITS)
            self._hard.append(np.stack((motion.id[hard], motion.time[hard], values)))
        self._done = self._first + until
        dropped = max(until - _MARGIN, 0)
        self._transforms.drop(dropped)
        self._velocities.drop(dropped)
        del self._elapsed[:dropped]
        self._first += dropped


class _VehicleRecords:
    """The records of vehicles in the packets of a type, one packet per frame.

    Attributes:
        count: The number of records.
    """

    def __init__(self, vehicles: Ids) -> None:
        self.count = 0
        self._vehicles = vehicles
        self._parts: list[_Part] = []
        self._listed = b""  # the ids of the latest frame
        self._others: set[int] = set()

    def add_vehicles(self, ids: set[int]) -> bool:
        """Add vehicles; return whether no frame so far has listed one of them."""
        new = ids.difference(self._vehicles.tolist())
        if new:
            self._vehicles = np.array(sorted({*self._vehicles.tolist(), *new}), np.uint32)
        return new.isdisjoint(self._others)

    def add(self, records: NDArray[np.void]) -> None:
        """Add the packets of some frames, (frames, records of each)."""
        ids = np.ascontiguousarray(records["id"])
        edges = [0, len(ids)]
        if len(ids) > 1:
            edges[1:1] = (np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1).tolist()
        for start, stop in pairwise(edges):
            listed = ids[start]
            among = _among(listed, self._vehicles)
            columns = among.nonzero()[0]
            key = listed.tobytes()
            if key != self._listed:
                self._listed = key
                self._others.update(listed[~among].tolist())
            self._parts.append(_Part(records[start:stop], columns, listed[columns]))
            self.count += (stop - start) * len(columns)

    @property
    def frames(self) -> int:
        """The number of frames."""
        return sum(len(part.records) for part in self._parts)

    @property
    def is_restless(self) -> bool:
        """Whether most frames list other vehicles than the frames around them."""
        return 2 * len(self._parts) > self.frames

    def ids(self) -> Ids:
        """Return the vehicles that have any records, ascending."""
        different = {part.ids.tobytes(): part.ids for part in self._parts}
        return np.unique(np.concatenate(list(different.values()))) if different else self._vehicles[:0]

    def fields(self, names: str, ids: Ids) -> NDArray[np.floating[Any]]:
        """Return fields of all records, (fields, frames, vehicles); NaN where a vehicle has no record.

        Args:
            names: The fields, each of one letter.
            ids: All vehicles that have any records, ascending.
        """
        values = np.full((len(names), self.frames, len(ids)), np.nan, self._parts[0].records.dtype[names[0]])
        first = 0
        for part in self._parts:
            columns = np.searchsorted(ids, part.ids)
            for number, name in enumerate(names):
                values[number, first : first + len(part.records), columns] = part.records[name][:, part.columns].T
            first += len(part.records)
        return values

    def table(self, ids: Ids) -> tuple[NDArray[np.void], Indices]:
        """Return the last record of each vehicle in each frame, and the number of the frame; by id, then frame."""
        taken = [part.records[:, part.columns[_among(part.ids, ids)]] for part in self._parts]
        rows, end = np.empty(sum(records.size for records in taken), taken[0].dtype), 0
        for records in taken:  # which is faster than to concatenate structures
            start, end = end, end + records.size
            rows[start:end] = records.ravel()
        sizes = np.concatenate([np.full(len(records), records.shape[1]) for records in taken])
        frames = np.repeat(np.arange(len(sizes)), sizes)
        order = np.argsort(rows["id"], kind="stable")
        rows, frames = rows[order], frames[order]
        last = np.append((np.diff(frames) != 0) | (np.diff(rows["id"]) != 0), True)[: len(rows)]
        return rows[last], frames[last]

    def drop(self, count: int) -> None:
        """Drop the first frames."""
        while self._parts and len(self._parts[0].records) <= count:
            count -= len(self._parts.pop(0).records)
        if count:
            self._parts[0] = self._parts[0]._replace(records=self._parts[0].records[count:])
        self.count = sum(len(part.records) * len(part.columns) for part in self._parts)


class _Part(NamedTuple):
    """The packets of consecutive frames that list the same vehicles.

    Attributes:
        records: Their records, (frames, records of each).
        columns: The columns of the records of vehicles.
        ids: The vehicles.
    """

    records: NDArray[np.void]
    columns: Indices
    ids: Ids


def _suspects(transforms: _VehicleRecords, velocities: _VehicleRecords, elapsed: Floats, deceleration: float) -> Ids:
    """Return the vehicles that may brake hard in some frames: all that do, and a few others.

    The slope of a line through speeds is a mean of the slopes between neighbours, so the speed of a vehicle that brakes hard
    falls as fast between some two frames. Vehicles that jump, or are missing in some frames, may brake hard, too.
    """
    ids = transforms.ids()
    if transforms.is_restless:
        return ids
    seconds = np.diff(elapsed)[:, None]
    if len(elapsed) <= _FEWEST or not (seconds > 0).all() or not (seconds < _GAP).all():
        return ids
    measured = velocities.ids()
    measured = measured[np.isin(measured, ids)]
    if len(measured):
        hard = _slows(_hypotenuse(*velocities.fields("xy", measured)), seconds, deceleration)
        measured_ids, ids = measured[hard], np.setdiff1d(ids, measured)
        if not len(ids):
            return measured_ids
    else:
        measured_ids = measured
    x, y, z = (np.diff(axis, axis=0) for axis in transforms.fields("xyz", ids))  # steps
    squares = x * x
    squares += y * y
    z *= z
    squares += z
    farthest = np.square(_SURE * _TOP_SPEED / CM * seconds).astype(squares.dtype)
    jumps = ~(squares < farthest).all(axis=0)
    # The speed in a frame is that between the frames around it.
    times = np.concatenate((seconds[:1], seconds[1:] + seconds[:-1], seconds[-1:]))
    speed = _hypotenuse(_around(x), _around(y))
    speed *= (CM / times).astype(speed.dtype)
    found: Ids = np.union1d(measured_ids, ids[jumps | _slows(speed, seconds, deceleration)])
    return found


def _around(steps: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the steps between the frames around each frame; steps are (frames - 1, vehicles)."""
    around = np.concatenate((steps[:1], steps))
    around[1:-1] += steps[1:]
    return around


def _hypotenuse(x: NDArray[np.floating[Any]], y: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the lengths of vectors, which are overwritten."""
    x *= x
    y *= y
    x += y
    lengths: NDArray[np.floating[Any]] = np.sqrt(x, out=x)
    return lengths


def _slows(speed: NDArray[np.floating[Any]], seconds: Floats, deceleration: float) -> Booleans:
    """Return which vehicles may slow down that fast between some two frames; speeds are (frames, vehicles)."""
    slower = speed[:-1] * speed.dtype.type(2 - _SURE)
    slower -= speed[1:]
    surely_not: Booleans = slower < (_SURE * deceleration * seconds).astype(speed.dtype)
    return ~np.asarray(surely_not.all(axis=0))


_RUN: Final = np.dtype(
    [("first", "i8"), ("last", "i8"), ("id", "u4")] + [(name, "f8") for name in Braking._fields if name != "id"]
)


class _VehicleMotion:
    """The motion of vehicles in some frames, one vehicle after the other.

    Args:
        transforms: Their transforms, by id, then frame.
        frame: The frame of each.
        velocities: The recorded velocities, in the same order.
        velocity_frame: The frame of each.
        elapsed: The elapsed seconds of each frame.
    """

    def __init__(
        self,
        transforms: NDArray[np.void],
        frame: Indices,
        velocities: NDArray[np.void],
        velocity_frame: Indices,
        elapsed: Floats,
    ) -> None:
        self.frame, self.id, self.time = frame, transforms["id"], elapsed[frame]
        self._transforms = transforms
        self._position = np.stack([transforms[axis].astype(np.float64) * CM for axis in "xyz"])
        recorded = _recorded_speeds(transforms["id"], frame, velocities, velocity_frame)
        self._continues = self._connected(recorded)  # from each row to the next one
        # A clock on which rows that do not belong together are far apart.
        steps = np.where(self._continues, np.diff(self.time), 2 * _GAP)
        self._clock = np.concatenate(([0.0], np.cumsum(steps)))[: len(frame)]
        self._speed = np.where(np.isnan(recorded), self._slopes(), recorded)

    def deceleration(self) -> Floats:
        """Return the deceleration of each row, in m/s²; NaN where it is unknown."""
        count = np.ones(len(self.frame))
        time, speed, squares, products = np.zeros((4, len(count)))
        for apart in range(1, min(_MARGIN, len(count))):
            seconds, change = (values[apart:] - values[:-apart] for values in (self._clock, self._speed))
            near = self._continues if apart == 1 else seconds <= HALF_WINDOW + _ROUNDING
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
        """Return the runs of consecutive frames in which a vehicle brakes hard.

        Args:
            hard: Whether it does in each row.
            number: The number of the block's first frame.
        """
        rows = np.flatnonzero(hard)
        continues = (np.diff(rows) == 1) & (np.diff(self.frame[rows]) == 1) & self._continues[rows[:-1]]
        runs = np.zeros(len(rows), _RUN)
        runs["id"] = self._transforms["id"][rows]
        runs["first"] = runs["last"] = number + self.frame[rows]
        runs["start"] = runs["stop"] = self.time[rows]
        for axis in "xyz":
            runs[axis] = self._transforms[axis][rows]
        runs["speed"] = self._speed[rows]
        return _joined(runs, continues)

    def _connected(self, recorded: Floats) -> Booleans:
        """Return whether each row and the next one are of a vehicle that neither jumps nor is missing for long."""
        seconds = np.diff(self.time)
        distance = np.sqrt((np.diff(self._position) ** 2).sum(axis=0))
        speed = np.fmax(recorded[1:], recorded[:-1])
        explained = np.where(np.isnan(speed), _TOP_SPEED * seconds, _SLACK * speed * seconds)
        # A distance of NaN connects nothing.
        near = distance <= np.maximum(explained, np.where(np.isnan(speed), 0.0, _JUMP))
        near &= (np.diff(self._transforms["id"]) == 0) & (seconds > 0) & (seconds <= _GAP)
        return np.asarray(near)

    def _slopes(self) -> Floats:
        """Return the speed over the ground that follows from the positions around each row, in m/s."""
        rows = np.arange(len(self.frame))
        before = rows - np.insert(self._continues, 0, False)[: len(rows)]
        after = rows + np.append(self._continues, False)[: len(rows)]
        distance = self._position[:2, after] - self._position[:2, before]
        return np.asarray(np.hypot(*distance) / (self.time[after] - self.time[before]))


def _recorded_speeds(ids: Ids, frame: Indices, velocities: NDArray[np.void], velocity_frame: Indices) -> Floats:
    """Return the recorded speeds over the ground of vehicles in some frames, in m/s; NaN where none is recorded."""
    speeds = np.full(len(ids), np.nan)
    if len(velocities):
        keys, wanted = _keys(velocities["id"], velocity_frame), _keys(ids, frame)
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        recorded = keys[found] == wanted
        speeds[recorded] = np.hypot(velocities["x"], velocities["y"])[found[recorded]]
    return speeds


def _among(ids: Ids, others: Ids) -> Booleans:
    """Return which ids are among others, which ascend."""
    if not len(others):
        return np.zeros(len(ids), np.bool_)
    found: Booleans = others[np.minimum(others.searchsorted(ids), len(others) - 1)] == ids
    return found


def _keys(ids: Ids, frame: Indices) -> NDArray[np.uint64]:
    """Return a number for each id and frame; the numbers have the same order."""
    return (ids.astype(np.uint64) << np.uint64(32)) + frame.astype(np.uint64)


def _joined(runs: NDArray[np.void], continues: Booleans) -> NDArray[np.void]:
    """Return runs in order, each joined with the next one if that continues it (and is of the same vehicle)."""
    if not len(runs):
        return runs
    apart = ~(continues & (runs["id"][1:] == runs["id"][:-1]))
    first, last = np.append(True, apart), np.append(apart, True)
    joined: NDArray[np.void] = runs[first]
    for name in ("last", "stop"):
        joined[name] = runs[name][last]
    return joined
