"""Pairs of actors that are near each other, frame by frame: ahead of each other, or on a collision course."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.queries.measures.boxes import Boxes, time_to_collision
from carla_recap.util.arrays import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Booleans, Indices


ELEMENTS: Final = 1 << 19
"""The number of values that are computed at once."""

_FRAMES: Final = 64  # in which actors are near each other, or not
_STEP: Final = 0.5  # m; boxes with more than this height between them are on different levels
LATER: Final = 0.5
"""The time by which actors may meet later on their paths than along straight lines, in s."""
SEEN: Final = 3.0
"""The time after a collision along straight lines up to which paths are known, in s."""
BEND_TIME: Final = 3.0
"""The time before the end of a path in which its bend is determined, in s."""

_SHORTEST: Final = 0.1  # s in which an actor goes straight on, at least
_STEPS: Final = 100  # until actors meet, at most; each is as much longer
_BEND: Final = 3.0  # m of a path by which its bend is determined
_SHARPEST: Final = 0.3  # radians per m
_BESIDE: Final = 0.3  # m between boxes that still meet


Bounds = tuple[Floats, Floats, Floats, Floats]
"""The least and the greatest x and y in blocks of columns, with a reach, each (actors, blocks)."""


def bounds(x: Floats, y: Floats, reach: Floats, size: int) -> Bounds:
    """Return the bounds of actors that reach some m around their places in m, (actors, columns), in blocks of a size."""
    starts, reach = np.arange(0, x.shape[1], size), reach[:, None]
    (left, low), (right, high) = ([end.reduceat(each, starts, axis=1) for each in (x, y)] for end in (np.fmin, np.fmax))
    return left - reach, right + reach, low - reach, high + reach


def meeting(bounds: Bounds, ones: Indices, others: Indices, apart: int = 0) -> Iterator[tuple[Indices, Indices, Indices]]:
    """Yield which of some rows come near the places where other rows were some blocks before, these rows, and the block."""
    (left, right, low, high), blocks = bounds, bounds[0].shape[1]
    rows = max(1, min(len(ones), ELEMENTS // max(1, len(others))))
    few = max(1, ELEMENTS // max(1, rows * len(others)))
    for first, row in product(range(apart, blocks, few), range(0, len(ones), rows)):
        some = ones[row : row + rows]
        here, there = (slice(first - back, min(first + few, blocks) - back) for back in (0, apart))
        near = (left[some, None, here] <= right[None, others, there]) & (
            left[None, others, there] <= right[some, None, here]
        )
        found = np.flatnonzero(near)  # NaN, of those that are absent, is near nothing
        one, other, block = np.unravel_index(found, near.shape)
        one, other, block = some[one], others[other], block + first
        near = (low[one, block] <= high[other, block - apart]) & (low[other, block - apart] <= high[one, block])
        yield one[near], other[near], block[near]


@dataclass(frozen=True, eq=False)
class PairFrames:
    """Pairs of actors in frames in which both are present, on one level; arrays of one length."""

    table: MotionTable
    one: Indices  # the row of the first actor of each pair
    other: Indices
    frame: Indices
    dx: Floats  # the centre of the second minus that of the first, in m
    dy: Floats
    vx: Floats  # the velocity of the second minus that of the first, in m/s
    vy: Floats
    distance: Floats  # of the centres in m

    @staticmethod
    def of(table: MotionTable, one: Indices, other: Indices, frame: Indices) -> PairFrames:
        """Return those pairs whose actors are present in their frames, on one level."""
        count = len(table.time)

        def difference(values: Floats) -> Floats:
            return np.asarray(values.take(other * count + frame) - values.take(one * count + frame))

        reach = (table.height[one] + table.height[other]) / 2 + _STEP
        level = np.flatnonzero(np.abs(difference(table.z)) <= reach)  # not of NaN
        one, other, frame = one[level], other[level], frame[level]
        dx, dy, vx, vy = map(difference, (table.x, table.y, table.vx, table.vy))
        return PairFrames(table, one, other, frame, dx, dy, vx, vy, np.hypot(dx, dy))

    @property
    def _columns(self) -> tuple[NDArray[Any], ...]:
        return self.one, self.other, self.frame, self.dx, self.dy, self.vx, self.vy, self.distance

    def take(self, kept: Booleans | Indices) -> PairFrames:
        """Return some of them."""
        return PairFrames(self.table, *(column[kept] for column in self._columns))

    @staticmethod
    def joined(parts: Sequence[PairFrames]) -> PairFrames:
        """Return the pairs of several parts of a table, of at least one."""
        columns = zip(*(part._columns for part in parts), strict=True)
        return PairFrames(parts[0].table, *map(np.concatenate, columns))

    def turned(self) -> PairFrames:
        """Return the pairs with their actors exchanged."""
        return PairFrames(
            self.table, self.other, self.one, self.frame, -self.dx, -self.dy, -self.vx, -self.vy, self.distance
        )

    def __len__(self) -> int:
        return len(self.frame)

    def around(self) -> Floats:
        """Return the sum of the radii of circles around both boxes in m."""
        return np.asarray(self.table.radius[self.one] + self.table.radius[self.other])

    def approach(self) -> Floats:
        """Return the magnitude of the difference of both velocities in m/s."""
        return np.hypot(self.vx, self.vy)

    def boxes(self) -> tuple[Boxes, Boxes]:
        """Return the boxes of both actors, the first one at rest in the origin."""
        table, one, other = self.table, self.one, self.other
        yaw = table.yaw
        return (
            Boxes(0.0, 0.0, yaw[one, self.frame], table.length[one], table.width[one]),
            Boxes(self.dx, self.dy, yaw[other, self.frame], table.length[other], table.width[other], self.vx, self.vy),
        )

    def colliding(self, horizon: float) -> tuple[PairFrames, Floats]:
        """Return those that collide within a time in s if they keep their velocity, and their times to collision in s."""
        speed, around = self.approach(), self.around()
        toward = -(self.dx * self.vx + self.dy * self.vy)  # times the speed
        aside = np.abs(self.dx * self.vy - self.dy * self.vx)  # times the speed
        soon = (toward > 0) & (aside <= around * speed) & (self.distance - around <= speed * horizon)
        pairs = self.take(np.flatnonzero(soon | (self.distance <= around)))
        times = time_to_collision(*pairs.boxes())
        kept = np.flatnonzero(times <= horizon)
        return pairs.take(kept), times[kept]


def near_pairs(table: MotionTable, subjects: Booleans, reach: Floats) -> Iterator[PairFrames]:
    """Yield the pairs that may be near each other, in some frames of those that the table is for.

    One of a pair is a subject. The distance of both is at most the sum of their reaches in m.
    """
    around = bounds(table.x[:, table.core], table.y[:, table.core], reach, _FRAMES)
    for one, other, block in meeting(around, np.flatnonzero(subjects), np.arange(len(subjects))):
        kept = np.flatnonzero(((one < other) | ~subjects[other]) & table.free(one, other))
        one, other = np.minimum(one, other), np.maximum(one, other)
        for few in (kept[start : start + ELEMENTS // _FRAMES] for start in range(0, len(kept), ELEMENTS // _FRAMES)):
            frame = table.first + _FRAMES * block[few, None] + np.arange(_FRAMES)
            row, column = np.nonzero(frame < table.last)
            yield PairFrames.of(table, one[few[row]], other[few[row]], frame[row, column])


_SAME_HEADING: Final = np.cos(np.deg2rad(45.0))


def ahead(pairs: PairFrames) -> tuple[PairFrames, Floats]:
    """Return the pairs in which the second actor is a vehicle ahead of the first, in the corridor as wide as the first.

    Its heading differs by 45 degrees at most. The numbers are the distances from bumper to bumper along the heading of the
    first one, in m.
    """
    table = pairs.table
    pairs = pairs.take(table.is_vehicle[pairs.other])
    yaw = table.yaw[pairs.one, pairs.frame]
    cos, sin = np.cos(yaw), np.sin(yaw)
    along, across = pairs.dx * cos + pairs.dy * sin, np.abs(pairs.dy * cos - pairs.dx * sin)
    half_width = table.width / 2
    kept = (along > 0) & (across < half_width[pairs.one] + table.radius[pairs.other])
    pairs, along, across = pairs.take(kept), along[kept], across[kept]
    turn = table.yaw[pairs.other, pairs.frame] - table.yaw[pairs.one, pairs.frame]
    cos, sin = np.cos(turn), np.abs(np.sin(turn))
    length, width = table.length[pairs.other] / 2, half_width[pairs.other]
    kept = (cos >= _SAME_HEADING) & (across < half_width[pairs.one] + sin * length + cos * width)
    gaps = along - table.length[pairs.one] / 2 - cos * length - sin * width
    return pairs.take(kept), np.maximum(gaps[kept], 0.0)


def on_collision_course(pairs: PairFrames, times: Floats) -> Booleans:
    """Return whether times to collision count.

    They do if the boxes touch; else if neither actor may be thrown by a collision, and both touch, or pass at less than
    0.3 m, if they keep their speed on the paths that they take, at most 0.5 s later than along straight lines. So the other
    lane of a bend, and what is parked beside it, is no obstacle, though a straight line leads there.
    """
    table, frame = pairs.table, pairs.frame
    counts = np.asarray(times == 0)
    open_pairs = np.flatnonzero(~counts & ~table.thrown[pairs.one, frame] & ~table.thrown[pairs.other, frame])
    open_pairs = open_pairs[np.argsort(times[open_pairs], kind="stable")]  # those with as many steps together
    few = max(1, ELEMENTS // _STEPS)
    for some in (open_pairs[start : start + few] for start in range(0, len(open_pairs), few)):
        counts[some] = paths_meet(table, pairs.one[some], pairs.other[some], frame[some], times[some])
    return counts


def paths_meet(table: MotionTable, one: Indices, other: Indices, frame: Indices, times: Floats) -> Booleans:
    """Return whether actors that keep their speed from a frame on meet on their paths; see `on_collision_course`."""
    step = np.maximum(_SHORTEST, (times + LATER) / _STEPS)[:, None]
    ahead = np.arange(math.ceil(float(((times + LATER) / step[:, 0]).max(initial=0.0))) + 1.0) * step
    stop = table.clock[frame] + times + SEEN
    first, second = (_path_ahead(table, actor, frame, ahead, stop) for actor in (one, other))
    x, y = second[0] - first[0], second[1] - first[1]
    vx, vy = np.diff(x, axis=1) / step, np.diff(y, axis=1) / step
    x, y = x[:, :-1], y[:, :-1]
    reach = (table.radius[one] + table.radius[other])[:, None] + _BESIDE + np.hypot(vx, vy) * step
    near = (np.hypot(x, y) <= reach) & (ahead[:, :-1] < (times + LATER)[:, None])
    row, moment = np.nonzero(near)
    a, b = one[row], other[row]
    touching = time_to_collision(
        Boxes(0.0, 0.0, first[2][row, moment], table.length[a], table.width[a] + _BESIDE),
        Boxes(x[near], y[near], second[2][row, moment], table.length[b], table.width[b] + _BESIDE, vx[near], vy[near]),
    )
    found = np.zeros(len(one), np.bool_)
    found[row[touching <= step[row, 0]]] = True
    return found


def _path_ahead(
    table: MotionTable, actor: Indices, frame: Indices, ahead: Floats, stop: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return where actors come with their speed on the paths that they take until a time, and then as those bend."""
    covered, clock = table.covered, table.clock
    distance = table.speed[actor, frame][:, None] * ahead
    begin, end = (edge[actor, frame] for edge in table.path)
    end = np.minimum(end, np.searchsorted(clock, stop, side="right") - 1)
    length = covered[actor, end]
    wanted = covered[actor, frame][:, None] + distance
    known = np.minimum(wanted, length[:, None])
    present = np.flatnonzero(~np.isnan(table.x))
    stations = covered.take(present)
    x, y, yaw = (
        np.where(  # an actor may stand and turn
            distance == 0,
            values[actor, frame][:, None],
            np.where(
                wanted >= length[:, None],
                values[actor, end][:, None],
                np.interp(known, stations, values.take(present)),
            ),
        )
        for values in (table.x, table.y, table.heading)
    )
    before = np.searchsorted(covered.ravel(), length - _BEND, side="right") - 1 - actor * len(clock)
    before = np.maximum(np.maximum(before, np.searchsorted(clock, clock[end] - BEND_TIME)), begin)
    length -= covered[actor, before]
    turn = table.heading[actor, end] - table.heading[actor, before]
    bend = np.divide(turn, length, out=np.zeros(len(actor)), where=length >= _BEND / 3)
    beyond = wanted - known
    yaw += np.clip(bend, -_SHARPEST, _SHARPEST)[:, None] * beyond
    steps = np.diff(beyond, axis=1, prepend=0.0) * np.where(table.along[actor, frame] < 0, -1.0, 1.0)[:, None]
    return x + np.cumsum(steps * np.cos(yaw), axis=1), y + np.cumsum(steps * np.sin(yaw), axis=1), yaw
