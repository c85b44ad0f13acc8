"""Post-encroachment time: how soon after an actor has left a spot another one arrives there, where their paths cross."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP
from carla_recap.queries.measures.boxes import Boxes, overlaps
from carla_recap.queries.measures.pairs import ELEMENTS, bounds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Booleans, Floats, Indices, Integers


CROSSING: Final = 30.0
"""The least angle between paths that cross, in degrees; actors on paths with a smaller one follow each other, or meet."""

SLOWEST: Final = 1.0
"""The speed from which on an actor counts as moving, in m/s."""

STEP: Final = 0.05
"""The time between the moments that are compared, in s."""

AROUND: Final = 3.0
"""The time before leaving and after arriving in which two actors must not touch, or be on one path, in s."""
ENCOUNTER: Final = 3.0
"""The time in s; critical moments of a pair with less time between them are one encounter."""

_FINE: Final = 10  # moments per step when the time is refined
_AT_ONCE: Final = 16  # moments that are compared with as many others at once
_LATEST: Final = 1e9  # s; times above it are none
_ALONG: Final = math.cos(math.radians(CROSSING))
_ACROSS: Final = math.sin(math.radians(CROSSING))


class Path(NamedTuple):
    """The path of a box; the fields but the size are arrays of one length.

    Attributes:
        time: The times in s, ascending.
        x, y: The centre in m.
        yaw: The heading in radians, counter-clockwise.
        length, width: The size in m.
    """

    time: Floats
    x: Floats
    y: Floats
    yaw: Floats
    length: float
    width: float

    def at(self, time: Floats) -> Boxes:
        """Return the boxes at some times, which are within those of the path."""
        x, y, yaw = (np.interp(time, self.time, values) for values in (self.x, self.y, np.unwrap(self.yaw)))
        return Boxes(x, y, yaw, self.length, self.width)


def post_encroachment_time(one: Path, other: Path, longest: float = 3.0) -> float:
    """Return the least time between one box leaving a spot and the other arriving there, in s.

    It is inf if their paths do not share a spot within the longest time, if both are there at once, or if they do not cross:
    following on one path does not count. Where paths cross at once, this is the definition of Allen, Shin and Cooper (1978):
    the entry of the second into the shared area less the exit of the first.

    Args:
        one: The path of a box.
        other: That of the other one.
        longest: The longest time that is looked for, in s.
    """
    start, stop = max(one.time[0], other.time[0]), min(one.time[-1], other.time[-1])
    found = math.inf
    if start <= stop:
        both = np.linspace(start, stop, max(math.ceil((stop - start) / STEP), 1) + 1)
        if overlaps(one.at(both), other.at(both)).any():
            return math.inf
    for first, second in ((one, other), (other, one)):
        begin, end = max(second.time[0], first.time[0]), min(second.time[-1], first.time[-1] + longest)
        if end < begin:
            continue
        arrivals = np.linspace(begin, end, max(math.ceil((end - begin) / STEP), 1) + 1)
        lags = np.arange(1, math.ceil(longest / STEP) + 1) * STEP
        arrival, lag = (each.ravel() for each in np.meshgrid(arrivals, lags, indexing="ij"))
        known = (arrival - lag >= first.time[0]) & (arrival - lag <= first.time[-1])
        arrival, lag = arrival[known], lag[known]
        a, b = second.at(arrival), first.at(arrival - lag)
        hits = np.flatnonzero(_cross(np.asarray(a.yaw) - np.asarray(b.yaw)) & overlaps(a, b))
        if len(hits):
            best = hits[lag[hits].argmin()]
            found = min(found, refined(first, second, float(arrival[best]), float(lag[best])))
    return found


def refined(first: Path, second: Path, arrival: float, lag: float) -> float:
    """Return a time between leaving and arriving more exactly, which is known to a step of 0.05 s.

    Args:
        first: The path of the actor that leaves.
        second: That of the actor that arrives.
        arrival: When the second one is where the first one was.
        lag: The time before it at which the first one was there, in s.
    """
    fine = STEP * np.linspace(-1, 1, 2 * _FINE + 1)
    arrivals, leavings = arrival + fine, arrival - lag + fine
    arrivals, leavings = (
        times[(times >= path.time[0] - SAME_TIME) & (times <= path.time[-1] + SAME_TIME)]
        for path, times in ((second, arrivals), (first, leavings))
    )
    late, early = (each.ravel() for each in np.meshgrid(arrivals, leavings, indexing="ij"))
    hits = (late - early > SAME_TIME) & overlaps(second.at(late), first.at(early))
    return min(lag, float((late - early)[hits].min(initial=math.inf)))


def _cross(turn: Floats) -> Booleans:
    """Return whether paths cross, by the angles between them in radians."""
    return np.asarray(np.abs(np.sin(turn)) >= _ACROSS)


@dataclass(frozen=True, slots=True)
class Crossing:
    """An actor that arrives where another one was, on a path that crosses its own.

    Attributes:
        first: The actor that was there first.
        second: The actor that arrives.
        left: When the first one is still there, in elapsed seconds.
        arrived: When the second one is there, in elapsed seconds.
        time: The time between leaving and arriving in s.
        speed: The speed of the second one then, in m/s.
        location: Its location, in m.
        begin, end: The first and the last time at which it arrives where the first one was, in elapsed seconds.
    """

    first: ActorLife
    second: ActorLife
    left: float
    arrived: float
    time: float
    speed: float
    location: tuple[float, float, float]
    begin: float
    end: float


class CrossingSearch:
    """Finds the paths that cross in tables of motion, each with the least time between leaving and arriving.

    Args:
        longest: The longest such time, in s.
        least_speed: The least speed with which an actor arrives, in m/s.
        only_vehicles: Whether vehicles alone arrive.
    """

    def __init__(self, longest: float, *, least_speed: float = SLOWEST, only_vehicles: bool = False) -> None:
        self._longest, self._least_speed, self._only_vehicles = longest, least_speed, only_vehicles
        self._found: dict[tuple[int, float, int, float], list[Crossing]] = defaultdict(list)

    @property
    def before(self) -> float:
        """The time before the frames of a table that it needs, in s."""
        return self._longest + 2 * STEP + AROUND

    def add(self, table: MotionTable, subjects: Booleans) -> None:
        """Process a table; `subjects` says whether an actor is of interest, one of a pair is."""
        grid = _Grid.of(table)
        hits = grid.hits(subjects, self._longest)
        arrives = grid.speed[hits.second, hits.arrived] >= self._least_speed
        if self._only_vehicles:
            arrives &= table.is_vehicle[hits.second]
        hits = hits.take(arrives)
        lag = grid.step[hits.arrived] - grid.step[hits.left]
        for rows in encounters(hits.first, hits.second, grid.time[hits.arrived]):
            best = rows[np.lexsort((hits.arrived[rows], lag[rows]))[0]]
            first, second = int(hits.first[best]), int(hits.second[best])
            left, arrived = (float(grid.time[each[best]]) for each in (hits.left, hits.arrived))
            paths = _path_of(table, first, left), _path_of(table, second, arrived)
            time = refined(*paths, arrived, arrived - left)
            frame = int(np.clip(np.searchsorted(table.clock, arrived - SAME_TIME), 0, len(table.time) - 1))
            crossing = Crossing(
                first=table.actors[first],
                second=table.actors[second],
                left=left,
                arrived=arrived,
                time=time,
                speed=float(grid.speed[second, hits.arrived[best]]),
                location=table.location(second, frame),
                begin=float(grid.time[hits.arrived[rows].min()]),
                end=float(grid.time[hits.arrived[rows].max()]),
            )
            one, other = crossing.first, crossing.second
            self._found[one.id, one.spawned_at, other.id, other.spawned_at].append(crossing)

    def finish(self) -> list[Crossing]:
        """Return what was found; what goes on from table to table is one crossing."""
        joined: list[Crossing] = []
        for found in self._found.values():
            for number, each in enumerate(found):
                if number and each.begin - joined[-1].end <= ENCOUNTER:
                    best = min(joined[-1], each, key=lambda crossing: round((crossing.arrived - crossing.left) / STEP))
                    joined[-1] = replace(best, begin=joined[-1].begin, end=each.end)
                else:
                    joined.append(each)
        return [each for each in joined if each.time <= self._longest]


def encounters(one: Indices, other: Indices, time: Floats) -> Iterator[Indices]:
    """Yield the positions of critical moments of each encounter, by time: those of a pair with at most 3 s between them."""
    order = np.lexsort((time, other, one))
    one, other, time = one[order], other[order], time[order]
    is_new = (np.diff(one) != 0) | (np.diff(other) != 0) | (np.diff(time) > ENCOUNTER)
    edges = [0, *(np.flatnonzero(is_new) + 1).tolist(), len(order)]
    for start, stop in pairwise(edges if len(order) else ()):
        yield order[start:stop]


class _Arrivals(NamedTuple):
    """Moments at which actors are where others were; arrays of one length.

    Attributes:
        first, second: The rows of the actor that was there first, and of the one that arrives.
        left, arrived: The moments at which they are there.
    """

    first: Indices
    second: Indices
    left: Indices
    arrived: Indices

    def take(self, kept: Booleans | Indices | slice) -> _Arrivals:
        """Return some of them."""
        return _Arrivals(*(column[kept] for column in self))


@dataclass(frozen=True, eq=False)
class _Grid:
    """Motion at the multiples of 0.05 s, between frames along straight lines; arrays of the shape (actors, moments).

    Attributes:
        table: The motion.
        step: The number of each moment from time 0, (moments,), ascending; there are none where frames are far apart.
        core: The moments from the first frame that the table is for to the one after the last.
        x, y, z, yaw, speed, thrown: As in the table.
    """

    table: MotionTable
    step: Integers
    core: slice
    x: Floats
    y: Floats
    z: Floats
    yaw: Floats
    speed: Floats
    thrown: Booleans

    @property
    def time(self) -> Floats:
        """The moments in elapsed seconds."""
        return np.asarray(self.step * STEP)

    @staticmethod
    def of(table: MotionTable) -> _Grid:
        """Return the motion of a table."""
        clock = np.clip(table.clock, -_LATEST, _LATEST)
        same = SAME_TIME / STEP
        first, last = np.ceil(clock / STEP - same), np.floor(clock / STEP + same)  # the moments next to each frame
        counts = np.where(np.diff(clock) <= LONGEST_STEP, last[1:] - first[:-1] + 1, last[:-1] - first[:-1] + 1)
        counts = np.maximum(np.append(counts, last[-1] - first[-1] + 1), 0).astype(np.int64)
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        step = np.unique(np.repeat(first, counts).astype(np.int64) + within)
        frame = np.maximum(np.searchsorted(clock, step * STEP + SAME_TIME, side="right") - 1, 0)
        behind = np.minimum(frame + 1, len(clock) - 1)
        seconds = clock[behind] - clock[frame]
        share = np.divide(step * STEP - clock[frame], seconds, out=np.zeros(len(step)), where=seconds > 0)
        share[np.abs(step * STEP - clock[frame]) <= SAME_TIME] = 0.0
        joined = np.hstack((table.joined, np.zeros((len(table.ids), 1), np.bool_)))[:, frame] | (share == 0)

        def between(values: Floats) -> Floats:
            now, then = values[:, frame], values[:, behind]
            return np.where(joined, np.where(share == 0, now, now + share * (then - now)), np.nan)

        end = clock[table.last] if table.last < len(clock) else np.inf
        core = np.searchsorted(step * STEP, (clock[table.first] - SAME_TIME, end - SAME_TIME))
        x, y, z, yaw, speed = map(between, (table.x, table.y, table.z, table.heading, table.speed))
        return _Grid(table, step, slice(*core.tolist()), x, y, z, yaw, speed, table.thrown[:, frame])

    def hits(self, subjects: Booleans, longest: float) -> _Arrivals:
        """Return where actors arrive in the core at most a time after others, on crossing paths; see `CrossingSearch`."""
        lags = math.ceil(longest / STEP - SAME_TIME) + 1  # a refined time may be shorter
        moves = (self.speed >= SLOWEST) & ~self.thrown
        x, y = np.where(moves, self.x, np.nan), np.where(moves, self.y, np.nan)
        found = [_Arrivals(*np.zeros((4, 0), np.intp))]
        for start in range(self.core.start, self.core.stop, _AT_ONCE):
            arrivals = slice(start, min(start + _AT_ONCE, self.core.stop))
            earliest = int(np.searchsorted(self.step, self.step[start] - lags))
            for stop in range(arrivals.stop, earliest, -_AT_ONCE):
                leavings = slice(max(stop - _AT_ONCE, earliest), stop)
                lag = self.step[arrivals, None] - self.step[leavings]
                for second, first in self._near(x, y, arrivals, leavings, subjects):
                    dx = x[second, arrivals][:, :, None] - x[first, leavings][:, None, :]
                    dy = y[second, arrivals][:, :, None] - y[first, leavings][:, None, :]
                    reach = (self.table.radius[first] + self.table.radius[second])[:, None, None]
                    near = (dx * dx + dy * dy <= reach * reach) & (lag > 0) & (lag <= lags)
                    pair, arrived, left = np.nonzero(near)
                    hits = _Arrivals(first[pair], second[pair], left + leavings.start, arrived + arrivals.start)
                    found.append(self._crossing(hits))
        return _Arrivals(*map(np.concatenate, zip(*found, strict=True)))

    def _near(
        self, x: Floats, y: Floats, arrivals: slice, leavings: slice, subjects: Booleans
    ) -> Iterator[tuple[Indices, Indices]]:
        """Yield the actors that may be in some moments where others are in some others, and these."""
        radius = self.table.radius
        (left, right), (bottom, top) = (bounds(values[:, arrivals], radius) for values in (x, y))
        (west, east), (south, north) = (bounds(values[:, leavings], radius) for values in (x, y))
        seconds, firsts = np.flatnonzero(left <= right), np.flatnonzero(west <= east)
        size = max(1, ELEMENTS // max(len(firsts), 1))
        for begin in range(0, len(seconds), size):
            some = seconds[begin : begin + size, None]
            near = (left[some] <= east[firsts]) & (west[firsts] <= right[some])
            near &= (bottom[some] <= north[firsts]) & (south[firsts] <= top[some])
            row, column = np.nonzero(near)
            second, first = some[row, 0], firsts[column]
            kept = (subjects[second] | subjects[first]) & self.table.free(second, first)
            second, first = second[kept], first[kept]
            few = max(1, ELEMENTS // _AT_ONCE**2)
            for at in range(0, len(second), few):
                yield second[at : at + few], first[at : at + few]

    def _crossing(self, hits: _Arrivals) -> _Arrivals:
        """Return the hits in which boxes overlap, on one level, on crossing paths, of pairs that do not touch or follow."""
        first, second, left, arrived = hits
        kept = _cross(self.yaw[second, arrived] - self.yaw[first, left])
        height = (self.table.height[first] + self.table.height[second]) / 2
        kept &= np.abs(self.z[second, arrived] - self.z[first, left]) <= height
        hits = hits.take(kept)
        hits = hits.take(overlaps(self._boxes(hits.first, hits.left), self._boxes(hits.second, hits.arrived)))
        if not len(hits.first):
            return hits
        begin = np.searchsorted(self.step, self.step[hits.left] - round(AROUND / STEP))
        end = np.searchsorted(self.step, self.step[hits.arrived] + round(AROUND / STEP), side="right")
        few = max(1, ELEMENTS // int((end - begin).max()))
        apart = [
            ~self._follow(hits.take(part), begin[part]) & ~self._touch(hits.take(part), begin[part], end[part])
            for part in (slice(start, start + few) for start in range(0, len(begin), few))
        ]
        return hits.take(np.concatenate(apart))

    def _follow(self, hits: _Arrivals, begin: Indices) -> Booleans:
        """Return whether arriving actors follow leaving ones, which had the same position and heading before."""
        first, second, _, arrived = hits
        moments = np.arange(begin.min(), arrived.max() + 1)
        dx = self.x[first[:, None], moments] - self.x[second, arrived][:, None]
        dy = self.y[first[:, None], moments] - self.y[second, arrived][:, None]
        distance = np.nan_to_num(dx * dx + dy * dy, nan=math.inf)
        distance[(moments < begin[:, None]) | (moments > arrived[:, None])] = math.inf
        nearest, rows = distance.argmin(axis=1), np.arange(len(first))
        turn = self.yaw[first, moments[nearest]] - self.yaw[second, arrived]
        reach = (self.table.width[first] + self.table.width[second]) / 2
        return np.asarray((distance[rows, nearest] <= reach * reach) & (np.cos(turn) >= _ALONG))

    def _touch(self, hits: _Arrivals, begin: Indices, end: Indices) -> Booleans:
        """Return whether pairs touch between two moments, in which case both are there at once."""
        moments = np.arange(begin.min(), end.max())
        during = (moments >= begin[:, None]) & (moments < end[:, None])
        first, second = hits.first[:, None], hits.second[:, None]
        dx, dy = (values[first, moments] - values[second, moments] for values in (self.x, self.y))
        reach = self.table.radius[first] + self.table.radius[second]
        row, column = np.nonzero((dx * dx + dy * dy <= reach * reach) & during)
        boxes = (self._boxes(each[row], moments[column]) for each in (hits.first, hits.second))
        touching = np.zeros(len(begin), np.bool_)
        touching[row[overlaps(*boxes)]] = True
        for one, other, frames in self.table.touching:
            together = ((hits.first == one) & (hits.second == other)) | ((hits.first == other) & (hits.second == one))
            times = self.table.clock[frames]
            contact = (self.time[moments] >= times[0] - STEP) & (self.time[moments] <= times[-1] + STEP)
            touching |= together & (during & contact).any(axis=1)
        return touching

    def _boxes(self, actor: Indices, moment: Indices) -> Boxes:
        table = self.table
        return Boxes(
            self.x[actor, moment], self.y[actor, moment], self.yaw[actor, moment], table.length[actor], table.width[actor]
        )


def _path_of(table: MotionTable, actor: int, time: float) -> Path:
    """Return the path of an actor of a table around a time, as long as it is present without a break."""
    frame = int(np.clip(np.searchsorted(table.clock, time + SAME_TIME, side="right") - 1, 0, len(table.time) - 1))
    begin, end = (int(edge[actor, frame]) for edge in table.path)
    rows = slice(begin, end + 1)
    return Path(
        table.time[rows],
        table.x[actor, rows],
        table.y[actor, rows],
        table.heading[actor, rows],
        float(table.length[actor]),
        float(table.width[actor]),
    )
