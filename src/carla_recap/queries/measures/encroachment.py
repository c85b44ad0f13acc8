"""Post-encroachment time: how soon after an actor has left a spot another one arrives there, where their paths cross."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ActorLife
from carla_recap.model.motion import LONGEST_STEP
from carla_recap.model.records import Spawn
from carla_recap.queries.measures.boxes import Boxes, overlaps
from carla_recap.queries.measures.motion_table import MotionTable
from carla_recap.queries.measures.pairs import ELEMENTS, bounds, meeting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

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
_BLOCK: Final = 16  # moments of which each actor has one bounding box
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
    following on one path does not count, as in `measures`. Where paths cross at once, this is the definition of Allen, Shin
    and Cooper (1978): the entry of the second into the shared area less the exit of the first.

    Args:
        one: The path of a box.
        other: That of the other one.
        longest: The longest time that is looked for, in s.
    """
    time = np.arange(min(one.time[0], other.time[0]), max(one.time[-1], other.time[-1]) + STEP, STEP)
    time = np.union1d(time, (one.time[-1], other.time[-1]))
    columns = ((one.x, other.x), (one.y, other.y), (np.unwrap(one.yaw), np.unwrap(other.yaw)))
    x, y, yaw = (
        np.stack([np.interp(time, path.time, each, np.nan, np.nan) for path, each in zip((one, other), both, strict=True)])
        for both in columns
    )
    lives = tuple(ActorLife(id, "", "vehicle", "", 0.0, spawn=Spawn(id)) for id in (1, 2))
    length, width = np.array([(path.length, path.width) for path in (one, other)]).T
    moving, none = np.full(x.shape, SLOWEST), np.zeros_like(x)
    table = MotionTable(
        0,
        len(time),
        time,
        np.array([1, 2]),
        lives,
        np.ones(2, np.bool_),
        x,
        y,
        none,
        yaw,
        moving,
        none,
        length,
        width,
        np.ones(2),
        np.zeros((2, 3)),
    )
    search = CrossingSearch(longest)
    search.add(table, table.is_vehicle)
    return min((each.post_encroachment_time for each in search.finish()), default=math.inf)


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
class Encounter:
    """Two actors nearly meet.

    Attributes:
        id1: The actor that approaches, or that arrives second where paths cross.
        id2: The other actor.
        start: The beginning of the critical time, in elapsed seconds; where paths cross, the other actor is there then.
        stop: Its end; where paths cross, the first actor is there then.
        time: The most critical moment.
        time_to_collision: The least time to collision in s; inf unless it is critical.
        required_deceleration: The greatest deceleration that a collision takes to be avoided, in m/s²; 0 unless the time to
            collision is critical.
        post_encroachment_time: The time between leaving and arriving in s; inf unless it is critical.
        speed: The speed of the first actor at the most critical moment, in m/s.
        x, y, z: The location of the first actor at that moment, in m, right-handed.
    """

    id1: int
    id2: int
    start: float
    stop: float
    time: float
    time_to_collision: float
    required_deceleration: float
    post_encroachment_time: float
    speed: float
    x: float
    y: float
    z: float


class _TableCrossing(NamedTuple):
    """A crossing in a table: the first and the last time of its arrivals, and the soonest one after leaving."""

    begin: float
    end: float
    steps: int
    encounter: Encounter


class CrossingSearch:
    """Finds the paths that cross in tables of motion, each with the least time between leaving and arriving.

    Args:
        longest: The longest such time, in s.
        least_speed: The least speed with which an actor arrives, in m/s.
        only_vehicles: Whether vehicles alone arrive.
    """

    def __init__(self, longest: float, *, least_speed: float = SLOWEST, only_vehicles: bool = False) -> None:
        self._longest, self._least_speed, self._only_vehicles = longest, least_speed, only_vehicles
        self._found: dict[tuple[int, float, int, float], list[_TableCrossing]] = defaultdict(list)

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
            time = refined(_path_of(table, first, left), _path_of(table, second, arrived), arrived, arrived - left)
            frame = int(np.clip(np.searchsorted(table.clock, arrived - SAME_TIME), 0, len(table.time) - 1))
            one, other = table.actors[second], table.actors[first]
            speed, place = float(grid.speed[second, hits.arrived[best]]), table.location(second, frame)
            encounter = Encounter(one.id, other.id, left, arrived, arrived, math.inf, 0.0, time, speed, *place)
            begin, end = grid.time[[hits.arrived[rows].min(), hits.arrived[rows].max()]].tolist()
            self._found[one.id, one.spawned_at, other.id, other.spawned_at].append(
                _TableCrossing(begin, end, int(lag[best]), encounter)
            )

    def finish(self) -> list[Encounter]:
        """Return what was found; what goes on from table to table is one crossing."""
        joined: list[_TableCrossing] = []
        for found in self._found.values():
            for number, each in enumerate(found):
                if number and each.begin - joined[-1].end <= ENCOUNTER:
                    best = min(joined[-1], each, key=lambda crossing: crossing.steps)
                    joined[-1] = best._replace(begin=joined[-1].begin, end=each.end)
                else:
                    joined.append(each)
        longest = self._longest + SAME_TIME  # 30 steps of 0.05 s are 1.5 s, whatever is rounded
        return [each.encounter for each in joined if each.encounter.post_encroachment_time <= longest]


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
        margin = -len(self.step) % _BLOCK
        step = np.pad(self.step, (0, margin), mode="edge") if margin else self.step
        moves = (self.speed >= SLOWEST) & ~self.thrown
        x, y = (
            np.pad(np.where(moves, values, np.nan), ((0, 0), (0, margin)), constant_values=np.nan)
            for values in (self.x, self.y)
        )
        found = [_Arrivals(*np.zeros((4, 0), np.intp))]
        pairs = np.concatenate([np.zeros((4, 0), np.intp), *self._near(x, y, step, lags, subjects)], axis=1)
        within, few = np.arange(_BLOCK), max(1, ELEMENTS // _BLOCK**2)
        for start in range(0, pairs.shape[1], few):
            second, first, late, early = pairs[:, start : start + few, None]
            arrived, left = late * _BLOCK + within, early * _BLOCK + within
            lag = step[arrived][:, :, None] - step[left][:, None, :]
            dx = x[second, arrived][:, :, None] - x[first, left][:, None, :]
            dy = y[second, arrived][:, :, None] - y[first, left][:, None, :]
            reach = (self.table.radius[first] + self.table.radius[second])[:, :, None]
            near = (dx * dx + dy * dy <= reach * reach) & (lag > 0) & (lag <= lags)
            near &= ((arrived >= self.core.start) & (arrived < self.core.stop))[:, :, None]
            row, at, then = np.nonzero(near)
            found.append(self._crossing(_Arrivals(first[row, 0], second[row, 0], left[row, then], arrived[row, at])))
        return _Arrivals(*map(np.concatenate, zip(*found, strict=True)))

    def _near(self, x: Floats, y: Floats, step: Integers, lags: int, subjects: Booleans) -> Iterator[NDArray[np.intp]]:
        """Yield the actors that may be in a block of moments where others are in a block before, and both blocks, (4, n)."""
        radius = self.table.radius[:, None]
        around = [bounds(values.reshape(len(x), -1, _BLOCK), radius) for values in (x, y)]
        for late in range(self.core.start // _BLOCK, math.ceil(self.core.stop / _BLOCK)):
            earliest = int(np.searchsorted(step, step[max(late * _BLOCK, self.core.start)] - lags))
            for early in range(earliest // _BLOCK, late + 1):
                second, first = meeting(*([(low[:, at], high[:, at]) for low, high in around] for at in (late, early)))
                kept = (subjects[second] | subjects[first]) & self.table.free(second, first)
                blocks = np.full((2, np.count_nonzero(kept)), [[late], [early]])
                yield np.stack((second[kept], first[kept], *blocks))

    def _crossing(self, hits: _Arrivals) -> _Arrivals:
        """Return the hits in which boxes overlap, on one level, on crossing paths, of pairs that do not touch or follow."""
        first, second, left, arrived = hits
        height = (self.table.height[first] + self.table.height[second]) / 2
        kept = np.abs(np.sin(self.yaw[second, arrived] - self.yaw[first, left])) >= _ACROSS
        hits = hits.take(kept & (np.abs(self.z[second, arrived] - self.z[first, left]) <= height))
        hits = hits.take(overlaps(self._boxes(hits.first, hits.left), self._boxes(hits.second, hits.arrived)))
        if not len(hits.first):
            return hits
        begin = np.searchsorted(self.step, self.step[hits.left] - round(AROUND / STEP))
        end = np.searchsorted(self.step, self.step[hits.arrived] + round(AROUND / STEP), side="right")
        pairs, pair = np.unique(np.stack((hits.first, hits.second)), axis=1, return_inverse=True)
        apart, few = np.zeros(len(begin), np.bool_), max(1, ELEMENTS // len(self.step))
        for start in range(0, pairs.shape[1], few):
            touching = np.pad(np.cumsum(self._touching(*pairs[:, start : start + few]), axis=1), ((0, 0), (1, 0)))
            rows = np.flatnonzero((pair >= start) & (pair < start + few))
            apart[rows] = touching[pair[rows] - start, end[rows]] == touching[pair[rows] - start, begin[rows]]
        hits, begin = hits.take(apart), begin[apart]
        few = max(1, ELEMENTS // int((hits.arrived - begin).max(initial=0) + 1))
        parts = (slice(start, start + few) for start in range(0, len(begin), few))
        follow = [np.zeros(0, np.bool_), *(self._follow(hits.take(part), begin[part]) for part in parts)]
        return hits.take(~np.concatenate(follow))

    def _follow(self, hits: _Arrivals, begin: Indices) -> Booleans:
        """Return whether arriving actors follow leaving ones, which had the same position and heading before."""
        first, second, _, arrived = (column[:, None] for column in hits)
        moments = np.minimum(begin[:, None] + np.arange((arrived[:, 0] - begin).max() + 1), arrived)
        dx = self.x[first, moments] - self.x[second, arrived]
        dy = self.y[first, moments] - self.y[second, arrived]
        distance = np.nan_to_num(dx * dx + dy * dy, nan=math.inf)
        nearest, rows = distance.argmin(axis=1), np.arange(len(begin))
        turn = self.yaw[hits.first, moments[rows, nearest]] - self.yaw[hits.second, hits.arrived]
        reach = (self.table.width[hits.first] + self.table.width[hits.second]) / 2
        return np.asarray((distance[rows, nearest] <= reach * reach) & (np.cos(turn) >= _ALONG))

    def _touching(self, first: Indices, second: Indices) -> Booleans:
        """Return at which moments pairs touch, (pairs, moments)."""
        dx, dy = (values[first] - values[second] for values in (self.x, self.y))
        reach = (self.table.radius[first] + self.table.radius[second])[:, None]
        found = np.asarray(dx * dx + dy * dy <= reach * reach)
        row, moment = np.nonzero(found)
        found[row, moment] = overlaps(*(self._boxes(each[row], moment) for each in (first, second)))
        for one, other, frames in self.table.touching:
            together = ((first == one) & (second == other)) | ((first == other) & (second == one))
            times = self.table.clock[frames]
            found |= together[:, None] & (self.time >= times[0] - STEP) & (self.time <= times[-1] + STEP)
        return found

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
