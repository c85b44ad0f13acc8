"""Post-encroachment time: how soon after an actor has left a spot another one arrives there, where their paths cross."""

from __future__ import annotations

import math
import warnings
from collections import defaultdict
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP
from carla_recap.queries.measures.boxes import Boxes, overlaps
from carla_recap.queries.measures.pairs import ELEMENTS, bounds, meeting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Booleans, Floats, Indices


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
_LATEST: Final = 1e10  # s; times above it are none: they are not exact to 1 µs
_ALONG: Final = math.cos(math.radians(CROSSING))
_ACROSS: Final = math.sin(math.radians(CROSSING))


@dataclass(frozen=True, slots=True)
class Encounter:
    """Two actors nearly meet."""

    one: ActorLife  # the actor that approaches, or that arrives second where paths cross
    other: ActorLife
    start: float  # of the critical time, in elapsed seconds; where paths cross, the other actor is there then
    stop: float  # where paths cross, the first actor is there then
    time: float  # the most critical moment
    time_to_collision: float  # s, the least; inf unless it is critical
    required_deceleration: float  # m/s², the greatest that avoids a collision; 0 unless the time to collision is critical
    post_encroachment_time: float  # s between leaving and arriving; inf unless it is critical
    speed: float  # m/s, of the first actor at the most critical moment
    place: tuple[float, float, float]  # the location of the first actor at that moment, in m, right-handed

    @property
    def pair(self) -> frozenset[tuple[int, float]]:
        """The keys of both actors."""
        return frozenset((self.one.key, self.other.key))


class _TableCrossing(NamedTuple):
    """A crossing in a table: the first and the last time of its arrivals, and the soonest one after leaving."""

    begin: float
    end: float
    steps: int
    encounter: Encounter


class CrossingSearch:
    """Finds the paths that cross in tables of motion, each with the least time in s between leaving and arriving.

    It is the `longest` at most. Actors arrive with at least a speed, in m/s, and may have to be vehicles.
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
        grid = _Grid(table)
        arrives = (grid.speed >= self._least_speed) & (table.is_vehicle | (not self._only_vehicles))[:, None]
        hits = grid.hits(subjects, self._longest, arrives)
        lag = grid.step[hits.arrived] - grid.step[hits.left]
        for rows in encounters(hits.first, hits.second, grid.time[hits.arrived]):
            best = rows[np.lexsort((hits.arrived[rows], lag[rows]))[0]]
            first, second = int(hits.first[best]), int(hits.second[best])
            left, arrived = (float(grid.time[each[best]]) for each in (hits.left, hits.arrived))
            time = _refined(table, first, second, left, arrived)
            frame = int(np.clip(np.searchsorted(table.clock, arrived - SAME_TIME), 0, len(table.time) - 1))
            one, other = table.actors[second], table.actors[first]
            speed, place = float(grid.speed[second, hits.arrived[best]]), table.location(second, frame)
            encounter = Encounter(one, other, left, arrived, arrived, math.inf, 0.0, time, speed, place)
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
    """Moments at which actors are where others were; arrays of one length."""

    first: Indices  # the row of the actor that was there first
    second: Indices  # that of the actor that arrives
    left: Indices  # the moment at which the first one is there
    arrived: Indices

    def take(self, kept: Booleans | Indices | slice) -> _Arrivals:
        """Return some of them."""
        return _Arrivals(*(column[kept] for column in self))


class _Grid:
    """Motion of a table at the multiples of 0.05 s, along straight lines; arrays of the shape (actors, moments).

    The number of each moment from time 0 is its `step`, ascending; there are none where frames are far apart. The `core` are
    those from the first frame that the table is for to the one after the last.
    """

    def __init__(self, table: MotionTable) -> None:
        clock = np.clip(table.clock, -_LATEST, _LATEST)
        if clock[-1] == _LATEST:
            warnings.warn(
                f"no crossings are found behind {_LATEST:g} s, where times are not exact", RecapWarning, stacklevel=2
            )
        same = SAME_TIME / STEP
        first, last = np.ceil(clock / STEP - same), np.floor(clock / STEP + same)  # the moments next to each frame
        counts = np.where(np.diff(clock) <= LONGEST_STEP, last[1:] - first[:-1] + 1, last[:-1] - first[:-1] + 1)
        counts = np.maximum(np.append(counts, last[-1] - first[-1] + 1), 0).astype(np.int64)
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        self.table, self.step = table, np.unique(np.repeat(first, counts).astype(np.int64) + within)
        self.time = time = self.step * STEP
        frame = np.maximum(np.searchsorted(clock, time + SAME_TIME, side="right") - 1, 0)
        seconds = clock[np.minimum(frame + 1, len(clock) - 1)] - clock[frame]
        share = np.divide(time - clock[frame], seconds, out=np.zeros(len(time)), where=seconds > 0)
        share[np.abs(time - clock[frame]) <= SAME_TIME] = 0.0
        behind = frame + (share > 0)
        torn = (share > 0) & ~np.hstack((table.joined, np.zeros((len(table.ids), 1), np.bool_))).take(frame, axis=1)

        def interpolated(values: Floats) -> Floats:
            now = values.take(frame, axis=1)
            found: Floats = now + share * (values.take(behind, axis=1) - now)
            found[torn] = np.nan
            return found

        end = clock[table.last] if table.last < len(clock) else np.inf
        self.core = slice(*np.searchsorted(time, (clock[table.first] - SAME_TIME, end - SAME_TIME)).tolist())
        self.x, self.y, self.z = map(interpolated, (table.x, table.y, table.z))
        self.yaw, self.speed = map(interpolated, (table.heading, table.speed))
        self.thrown = table.thrown.take(frame, axis=1)

    def hits(self, subjects: Booleans, longest: float, arrives: Booleans) -> _Arrivals:
        """Return where actors arrive in the core at most a time after others, on crossing paths; see `CrossingSearch`.

        `arrives` says in which moments an actor counts as one that does, (actors, moments).
        """
        lags = math.ceil(longest / STEP - SAME_TIME) + 1  # a refined time may be shorter
        moves = (self.speed >= SLOWEST) & ~self.thrown
        x, y = (np.where(moves, values, np.nan) for values in (self.x, self.y))
        then_x, then_y = (np.where(arrives, values, np.nan) for values in (x, y))
        some, rest = np.flatnonzero(subjects), np.flatnonzero(~subjects)
        table, within, few = self.table, np.arange(_BLOCK), max(1, ELEMENTS // _BLOCK**2)
        around, found = bounds(x, y, table.radius, _BLOCK), [_Arrivals(*np.zeros((4, 0), np.intp))]
        for apart in range((lags - 1) // _BLOCK + 2):
            near = chain(meeting(around, some, np.arange(len(subjects)), apart), meeting(around, rest, some, apart))
            for second, first, block in near:
                kept = table.free(second, first)
                kept &= (block >= self.core.start // _BLOCK) & (block * _BLOCK < self.core.stop)
                met = second[kept], first[kept], block[kept]
                for start in range(0, len(met[0]), few):
                    second, first, block = (each[start : start + few, None, None] for each in met)
                    arrived, left = block * _BLOCK + within[:, None], (block - apart) * _BLOCK + within
                    hit = (arrived >= self.core.start) & (arrived < self.core.stop)
                    arrived, left = (np.minimum(each, len(self.step) - 1) for each in (arrived, left))
                    lag = self.step[arrived] - self.step[left]
                    there, here = second * len(self.step) + arrived, first * len(self.step) + left
                    dx, dy = then_x.take(there) - x.take(here), then_y.take(there) - y.take(here)
                    reach = table.radius[first] + table.radius[second]
                    hit = hit & (dx * dx + dy * dy <= reach * reach) & (lag > 0) & (lag <= lags)
                    row, at, then = np.unravel_index(np.flatnonzero(hit), hit.shape)
                    found.append(
                        self._crossing(
                            _Arrivals(first[row, 0, 0], second[row, 0, 0], left[row, 0, then], arrived[row, at, 0])
                        )
                    )
        arrivals = _Arrivals(*map(np.concatenate, zip(*found, strict=True)))
        arrivals = arrivals.take(~self._touching(arrivals))
        return arrivals.take(~self._following(arrivals))

    def _crossing(self, hits: _Arrivals) -> _Arrivals:
        """Return the hits in which boxes overlap, on one level, on crossing paths."""
        first, second, left, arrived = hits
        height = (self.table.height[first] + self.table.height[second]) / 2
        kept = np.abs(np.sin(self.yaw[second, arrived] - self.yaw[first, left])) >= _ACROSS
        hits = hits.take(kept & (np.abs(self.z[second, arrived] - self.z[first, left]) <= height))
        return hits.take(overlaps(self._boxes(hits.first, hits.left), self._boxes(hits.second, hits.arrived)))

    def _around(self, hits: _Arrivals) -> tuple[Indices, Indices]:
        """Return the first moment within 3 s before each leaving, and the one behind those within 3 s after the arrival."""
        begin = np.searchsorted(self.step, self.step[hits.left] - round(AROUND / STEP))
        return begin, np.searchsorted(self.step, self.step[hits.arrived] + round(AROUND / STEP), side="right")

    def _touching(self, hits: _Arrivals) -> Booleans:
        """Return in which hits the pair touches in the moments around."""
        begin, end = self._around(hits)
        pairs, pair = np.unique(hits.first * len(self.x) + hits.second, return_inverse=True)
        found, few = np.zeros(len(pair), np.bool_), max(1, ELEMENTS // max(1, len(self.step)))
        for start in range(0, len(pairs), few):
            first, second = np.divmod(pairs[start : start + few], len(self.x))
            reach = self.table.radius[first] + self.table.radius[second]
            dx, dy = self.x[second] - self.x[first], self.y[second] - self.y[first]
            near = dx * dx + dy * dy <= (reach * reach)[:, None]
            row, moment = np.nonzero(near)
            near[row, moment] = overlaps(self._boxes(first[row], moment), self._boxes(second[row], moment))
            count = np.pad(np.cumsum(near, axis=1), ((0, 0), (1, 0)))
            some = np.flatnonzero((pair >= start) & (pair < start + few))
            row = pair[some] - start
            found[some] = count[row, end[some]] > count[row, begin[some]]
        for one, other, frames in self.table.touching:
            times = self.table.clock[frames]
            is_pair = ((hits.first == one) & (hits.second == other)) | ((hits.first == other) & (hits.second == one))
            found |= is_pair & (self.time[begin] <= times[-1] + STEP) & (self.time[end - 1] >= times[0] - STEP)
        return found

    def _following(self, hits: _Arrivals) -> Booleans:
        """Return in which hits the second one follows the first, which had the same position and heading before."""
        begin, found = self._around(hits)[0], np.zeros(len(hits.first), np.bool_)
        few = max(1, ELEMENTS // int((hits.arrived + 1 - begin).max(initial=1)))
        for start in range(0, len(begin), few):
            first, second, _, arrived = hits.take(slice(start, start + few))
            moments = arrived[:, None] - np.arange(int((arrived + 1 - begin[start : start + few]).max()))[::-1]
            moments = np.maximum(moments, begin[start : start + few, None])
            there = first[:, None] * len(self.step) + moments
            dx, dy = self.x.take(there) - self.x[second, arrived, None], self.y.take(there) - self.y[second, arrived, None]
            distance = np.nan_to_num(dx * dx + dy * dy, nan=math.inf)
            nearest, rows = distance.argmin(axis=1), np.arange(len(first))
            turn = self.yaw[first, moments[rows, nearest]] - self.yaw[second, arrived]
            reach = (self.table.width[first] + self.table.width[second]) / 2
            found[start : start + few] = (distance[rows, nearest] <= reach * reach) & (np.cos(turn) >= _ALONG)
        return found

    def _boxes(self, actor: Indices, moment: Indices) -> Boxes:
        table = self.table
        return Boxes(
            self.x[actor, moment], self.y[actor, moment], self.yaw[actor, moment], table.length[actor], table.width[actor]
        )


def _refined(table: MotionTable, first: int, second: int, left: float, arrived: float) -> float:
    """Return the time between leaving and arriving more exactly, which is known to a step of 0.05 s."""
    fine = STEP * np.linspace(-1, 1, 2 * _FINE + 1)
    late, early = (each.ravel() for each in np.meshgrid(arrived + fine, left + fine, indexing="ij"))
    hits = (late - early > SAME_TIME) & overlaps(_box_at(table, second, late, arrived), _box_at(table, first, early, left))
    return min(arrived - left, float((late - early)[hits].min(initial=math.inf)))


def _box_at(table: MotionTable, actor: int, times: Floats, around: float) -> Boxes:
    """Return the box of an actor at times around another one; at NaN where it is not present without a break from there."""
    frame = int(np.clip(np.searchsorted(table.clock, around + SAME_TIME, side="right") - 1, 0, len(table.time) - 1))
    begin, end = (int(edge[actor, frame]) for edge in table.path)
    time = table.time[begin : end + 1]
    x, y, yaw = (np.interp(times, time, values[actor, begin : end + 1]) for values in (table.x, table.y, table.heading))
    x[(times < time[0] - SAME_TIME) | (times > time[-1] + SAME_TIME)] = np.nan
    return Boxes(x, y, yaw, float(table.length[actor]), float(table.width[actor]))
