"""Hard braking: which vehicles brake hard, when and where.

The deceleration at a moment is the slope of a straight line through the speeds around it, so that a single wrong speed has
little effect. Braking is hard if it lasts for 0.3 s, or loses as much speed in less, as an emergency stop from a low speed
does. What tyres cannot do is a collision's or a teleport's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP, MAX_DECELERATION, counts, neighbours, runs, slope, steps_joined
from carla_recap.model.records import CM, ActorKind
from carla_recap.model.segment import SegmentBuffer, segments

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.records import Spawn
    from carla_recap.util.arrays import Booleans, Floats, Integers


HARD: Final = 6.0
"""The deceleration from which on braking is hard, in m/s², unless a query asks for another one."""
HALF_WINDOW: Final = 0.125  # s before and after a moment, of which the speeds count
SHORTEST: Final = 0.3  # s in which the least deceleration loses the least speed that counts
_FEWEST: Final = 3  # frames of hard braking
_STEP: Final = 1.1 * MAX_DECELERATION  # m/s² between two frames, of which speeds may follow from positions
_DIGITS: Final = 6  # of decelerations, beyond which they depend on where the frames that are read begin
_SURE: Final = 0.999  # a deceleration below this share of another one is below it in spite of rounding

_BLOCK: Final = 100_000  # records that are evaluated together, at least
_CELLS: Final = 1 << 15  # vehicles times frames that are evaluated together, at most; more are slower
_COLLECTED: Final = 1 << 21  # vehicles times frames that are collected together, at most: each time goes over all frames
_REACH: Final = 2.5  # s: two of the longest steps, and a bit, are between frames that a deceleration depends on


class Braking(NamedTuple):
    """A vehicle brakes hard."""

    id: int  # the vehicle
    start: float  # the beginning, in elapsed seconds
    stop: float  # the end, in elapsed seconds
    x: float  # the position at the start, in cm, left-handed
    y: float
    z: float
    speed: float  # the speed over the ground at the start, in m/s


class BrakingDetector:
    """Finds braking of vehicles from a deceleration in m/s² on in the frames of a recording.

    Speeds are those recorded, and the slopes of the positions where no velocities are recorded. Frames are evaluated in
    blocks, each with the frames of some seconds before and after it. Vehicles do not depend on each other.
    """

    def __init__(self, vehicles: Collection[int], deceleration: float) -> None:
        self._deceleration = deceleration
        self._least = deceleration * (SHORTEST - SAME_TIME)  # the speed in m/s that hard braking loses
        self._vehicles = set(vehicles)
        self._others: set[int] = set()  # other ids that frames have listed
        self._listed = b""  # the ids of the latest segment
        self._transforms, self._velocities = SegmentBuffer(), SegmentBuffer()
        self._elapsed: list[float] = []  # of the frames that are held
        self._first = 0  # the number of the first of these
        self._done = 0  # the number of the frame after those that are evaluated
        self._new = self._held = 0  # frames and transforms of vehicles since the latest block, and those held from before
        self._hard = [np.zeros(0, _HARD)]
        self._hard_by_id: dict[int, NDArray[np.void]] = {}  # in the order of time

    def add_spawns(self, spawns: Iterable[Spawn]) -> bool:
        """Add the vehicles among spawned actors; return False if one of them had records before, which were left out."""
        new = {spawn.id for spawn in spawns if spawn.kind == ActorKind.VEHICLE}.difference(self._vehicles)
        self._vehicles.update(new)
        return new.isdisjoint(self._others)

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch."""
        transforms = batch.records("transforms")
        if not transforms.shape[1]:
            return
        self._new += len(batch) + self._add(self._transforms, transforms)
        self._add(self._velocities, batch.records("velocities"))
        self._elapsed.extend(batch.elapsed.tolist())
        if self._new >= max(_BLOCK, self._held):
            self._end_block()

    def finish(self) -> list[Braking]:
        """Return the hard braking in all frames, by id, then start."""
        self._evaluate(np.array(self._elapsed), len(self._elapsed))
        hard = np.concatenate(self._hard)
        hard = hard[np.lexsort((hard["frame"], hard["id"]))]
        of_vehicles = np.split(hard, np.flatnonzero(np.diff(hard["id"])) + 1)
        in_time = (rows[np.argsort(rows["time"], kind="stable")] for rows in of_vehicles if len(rows))
        self._hard_by_id = {rows["id"].item(0): rows.copy() for rows in in_time}
        first, last = _runs(hard, _follow(hard))
        lost = _lost(hard)
        enough = (lost[last] - lost[first] >= self._least) & (last - first >= _FEWEST - 1)
        first, last = first[enough], last[enough]
        pause = hard["time"][first[1:]] - hard["time"][last[:-1]]  # below 0 where the clock has gone back
        begin, end = _runs(hard[first], (pause >= 0) & (pause < LONGEST_STEP))
        rows = zip(hard[first[begin]].tolist(), hard["time"][last[end]].tolist(), strict=True)
        return [Braking(id, start, stop, x, y, z, speed) for (id, _, _, start, x, y, z, speed, _), stop in rows]

    def hardest(self, id: int, start: float, stop: float) -> tuple[float, float]:
        """Return the greatest deceleration in m/s² of a vehicle within some elapsed seconds, and its time, after `finish`.

        Of braking that tyres can do in a part alone, the deceleration is that of the part.
        """
        rows = self._hard_of(id, start, stop)
        rows = rows[possible] if (possible := self._can_be_braking(rows)).any() else rows
        if not len(rows):
            return math.nan, math.nan
        row = rows[rows["deceleration"].argmax()]
        return round(row["deceleration"].item(), _DIGITS), row["time"].item()

    def by_tyres(self, braking: Braking) -> Braking | None:
        """Return hard braking from when to when tyres can do it; None if they cannot. Where its frames are unknown, all is.

        The deceleration that they can do is at most `MAX_DECELERATION`; what is shorter than 0.3 s, by a tenth more at most
        between any two frames. A collision within a second before or behind is left out by that.
        """
        rows = self._hard_of(braking.id, braking.start, braking.stop)
        if not len(rows):
            return braking
        possible = self._can_be_braking(rows)
        if possible.all() or not possible.any():
            return braking if possible.any() else None
        rows = rows[possible]
        (id, _, _, start, x, y, z, speed, _), stop = rows[rows["time"].argmin()].tolist(), rows["time"].max().item()
        return Braking(id, start, stop, x, y, z, speed)

    def _hard_of(self, id: int, start: float, stop: float) -> NDArray[np.void]:
        """Return the frames of a time in which a vehicle brakes hard, after `finish`."""
        rows = self._hard_by_id.get(id, np.zeros(0, _HARD))
        rows = rows[rows["time"].searchsorted(start) : rows["time"].searchsorted(stop, "right")]
        return rows[rows["frame"].argsort()]

    def _can_be_braking(self, rows: NDArray[np.void]) -> Booleans:
        """Return which frames of hard braking of a vehicle are of parts that are long enough, and that tyres can do."""
        found, time, lost = np.zeros(len(rows), np.bool_), rows["time"], _lost(rows)
        by_tyres = -np.diff(rows["speed"]) <= _STEP * np.diff(time)
        for first, last in runs(rows["deceleration"] <= MAX_DECELERATION, _follow(rows)):
            is_long = time[last] - time[first] >= SHORTEST - SAME_TIME
            found[first : last + 1] = is_long or (by_tyres[first:last].all() and lost[last] - lost[first] >= self._least)
        return found

    def _add(self, buffer: SegmentBuffer, records: NDArray[np.void]) -> int:
        """Add the records of some frames, and return how many are of vehicles."""
        found = []
        for segment in segments(records) if records.shape[1] else ():
            is_vehicle = np.array([id in self._vehicles for id in segment.ids.tolist()], bool)
            listed = segment.ids.tobytes()
            if listed != self._listed:
                self._listed = listed
                self._others.update(segment.ids[~is_vehicle].tolist())
            found.append(segment.only(is_vehicle))
        buffer.add(found, len(records))
        return sum(len(segment) * len(segment.ids) for segment in found)

    def _end_block(self) -> None:
        """Evaluate the frames that no later one can affect, and keep those that can affect others than these.

        No motion follows over a frame at which the clock stands still or goes back.
        """
        elapsed = np.array(self._elapsed)
        clock = _restarts(elapsed)
        restart = int(np.searchsorted(clock, clock[-1]))
        until = restart + int(np.searchsorted(elapsed[restart:], elapsed[-1] - _REACH))
        kept = restart + int(np.searchsorted(elapsed[restart:], elapsed[until] - _REACH))
        self._evaluate(elapsed, until)
        for buffer in (self._transforms, self._velocities):
            buffer.drop(kept)
        del self._elapsed[:kept]
        self._first += kept
        self._held = (self._held + self._new) * len(self._elapsed) // len(elapsed)
        self._new = 0

    def _evaluate(self, elapsed: Floats, until: int) -> None:
        """Evaluate the frames that are held, of some elapsed seconds, before one."""
        every, clock = self._transforms.ids(), _restarts(elapsed)
        for collected in _pieces(len(every), _COLLECTED // max(len(elapsed), 1)):
            ids = every[collected]
            places, present = self._transforms.dense("xyz", ids)
            velocities, recorded = self._velocities.dense("xyz", ids)
            recorded &= counts(velocities)
            for rows in _pieces(len(ids), _CELLS // len(elapsed)):
                hard = self._hard_frames(places[:, rows], present[rows], velocities[:, rows], recorded[rows], elapsed, clock)
                hard["id"] = ids[rows][hard["id"]]
                hard["frame"] += self._first
                hard["before"] += self._first
                self._hard.append(hard[(hard["frame"] >= self._done) & (hard["frame"] < self._first + until)])
        self._done = self._first + until

    @np.errstate(all="ignore")
    def _hard_frames(
        self,
        places: NDArray[Any],
        present: Booleans,
        velocities: NDArray[Any],
        recorded: Booleans,
        elapsed: Floats,
        clock: Integers,
    ) -> NDArray[np.void]:
        """Return the frames in which vehicles brake hard, by vehicle, then frame; an id is the number of the vehicle.

        Places are in cm and velocities in m/s, (3, vehicles, frames), each with where it is known, (vehicles, frames).
        """
        # From here on, arrays have a row for each frame of the first vehicle, then of the second one, and so on.
        there = np.flatnonzero(present)
        vehicle, frame = np.divmod(there, len(elapsed))
        places, time = places.reshape(3, -1).take(there, axis=1), elapsed[frame]
        metres = places.astype(np.float64) * CM
        speed = np.full(len(there), np.nan)
        if recorded.any():
            speed = np.where(recorded, np.hypot(*velocities[:2]), np.nan).take(there).astype(np.float64)
        seconds = np.diff(time)
        joined = steps_joined(time, metres, speed, vehicle * len(elapsed) + clock[frame])
        before, after = neighbours(joined)
        derived = (metres.take(after, axis=1) - metres.take(before, axis=1)) / (time[after] - time[before])
        derived = np.where(counts(derived), np.hypot(*derived[:2]), np.nan)
        speed = np.where(np.isnan(speed), derived, speed)
        # The slope of a line through speeds is a mean of the slopes between neighbours, one of which is as steep.
        steep = joined & ~(speed[:-1] - speed[1:] < _SURE * self._deceleration * seconds)
        braking = np.zeros(len(present), np.bool_)
        braking[vehicle[:-1][steep]] = True
        rows = np.flatnonzero(braking[vehicle])
        if not len(rows):
            return np.zeros(0, _HARD)
        speed = speed[rows]
        joined = np.append(joined, False)[rows[:-1]]
        deceleration = -slope(time[rows], speed[None], HALF_WINDOW, joined=joined)[0]
        kept = np.flatnonzero(deceleration >= self._deceleration)
        rows, found = rows[kept], np.zeros(len(kept), _HARD)
        found["before"] = frame[before[rows]]
        found["id"], found["frame"], found["time"], found["speed"] = vehicle[rows], frame[rows], time[rows], speed[kept]
        found["x"], found["y"], found["z"] = places[:, rows]
        found["deceleration"] = deceleration[kept]
        return found


_HARD: Final = np.dtype(
    [("id", "u4"), ("frame", "i8"), ("before", "i8")]
    + [(name, "f8") for name in ("time", "x", "y", "z", "speed", "deceleration")]
)
"""A frame in which a vehicle brakes hard, and its frame before."""


def _pieces(count: int, most: int) -> Iterator[slice]:
    """Yield the slices of a number of rows, with at most some rows each, but with one at least."""
    step = max(most, 1)
    return (slice(start, start + step) for start in range(0, count, step))


def _restarts(elapsed: Floats) -> Integers:
    """Return how often the clock has stood still or gone back until each frame."""
    return np.append(0, np.cumsum(~(elapsed[1:] > elapsed[:-1])))[: len(elapsed)]


def _follow(rows: NDArray[np.void]) -> Booleans:
    """Return whether each next frame of hard braking is the vehicle's next frame."""
    return np.asarray(rows["before"][1:] == rows["frame"][:-1])


@np.errstate(invalid="ignore", over="ignore")  # of times that are not finite
def _lost(rows: NDArray[np.void]) -> Floats:
    """Return the speed in m/s that is lost up to each frame of hard braking, in frames that follow each other alone."""
    deceleration = rows["deceleration"]
    lost = np.diff(rows["time"]) * (deceleration[1:] + deceleration[:-1]) / 2
    return np.append(0.0, np.cumsum(np.where(_follow(rows), lost, 0.0)))


def _runs(rows: NDArray[np.void], goes_on: Booleans) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the last of the rows that belong together: of one id, each of which the next one goes on with."""
    found = runs(np.ones(len(rows), np.bool_), goes_on & (np.diff(rows["id"]) == 0))
    first, last = np.array(list(found), np.intp).reshape(-1, 2).T
    return first, last
