"""Pairs of actors that are near each other, frame by frame, and what is computed for each pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.queries.measures.boxes import Boxes, gap, time_to_collision

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Booleans, Floats, Indices


FRAMES: Final = 64
"""The number of frames for which near pairs are looked for at once."""
ELEMENTS: Final = 1 << 19
"""The number of values that are computed at once."""

_STEP: Final = 0.5  # m; boxes with more than this height between them are on different levels
_COLUMNS: Final = ("one", "other", "frame", "dx", "dy", "vx", "vy", "distance")


def bounds(values: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest value along the last axis, less and more a reach; inf and -inf of NaN alone."""
    least = np.fmin.reduce(values, axis=-1, initial=np.inf)
    greatest = np.fmax.reduce(values, axis=-1, initial=-np.inf)
    return least - reach, greatest + reach


def meeting(ones: Sequence[tuple[Floats, Floats]], others: Sequence[tuple[Floats, Floats]]) -> tuple[Indices, Indices]:
    """Return the rows of some actors and those of others that overlap, of bounds along x and along y."""
    one, other = (np.flatnonzero(least <= greatest) for least, greatest in (ones[0], others[0]))  # those that are present
    near = np.ones((len(one), len(other)), np.bool_)
    for (least, greatest), (low, high) in zip(ones, others, strict=True):
        near &= (least[one, None] <= high[other]) & (low[other] <= greatest[one, None])
    row, column = np.nonzero(near)
    return one[row], other[column]


@dataclass(frozen=True, eq=False)
class PairFrames:
    """Pairs of actors in frames in which both are present, on one level; arrays of one length.

    Attributes:
        table: The motion.
        one: The first actor of each pair.
        other: The second actor.
        frame: The frame.
        dx, dy: The centre of the second minus that of the first, in m.
        vx, vy: The velocity of the second minus that of the first, in m/s.
        distance: The distance of the centres in m.
    """

    table: MotionTable
    one: Indices
    other: Indices
    frame: Indices
    dx: Floats
    dy: Floats
    vx: Floats
    vy: Floats
    distance: Floats

    @staticmethod
    def of(table: MotionTable, frames: slice, one: Indices, other: Indices) -> PairFrames:
        """Return pairs in some frames."""

        def difference(values: Floats) -> Floats:
            part = values[:, frames]
            return np.asarray(part[other] - part[one])

        dx, dy, dz = difference(table.x), difference(table.y), difference(table.z)
        level = np.abs(dz) <= ((table.height[one] + table.height[other]) / 2 + _STEP)[:, None]
        pair, frame = np.nonzero(level)  # False for NaN
        dx, dy = dx[pair, frame], dy[pair, frame]
        vx, vy = difference(table.vx)[pair, frame], difference(table.vy)[pair, frame]
        return PairFrames(table, one[pair], other[pair], frame + frames.start, dx, dy, vx, vy, np.hypot(dx, dy))

    def take(self, kept: Booleans | Indices) -> PairFrames:
        """Return some of them."""
        return PairFrames(self.table, *(getattr(self, name)[kept] for name in _COLUMNS))

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

    def within(self) -> Floats:
        """Return the sum of the radii of circles within both boxes in m."""
        radius = np.minimum(self.table.length, self.table.width) / 2
        return np.asarray(radius[self.one] + radius[self.other])

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

    def gap(self) -> Floats:
        """Return the gaps in m."""
        return gap(*self.boxes())

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


def near_pairs(table: MotionTable, subjects: Booleans, reach: Floats | float) -> Iterator[PairFrames]:
    """Yield the pairs that may be near each other, in some frames of those that the table is for.

    One of a pair is a subject. The distance of both is at most the sum of their reaches in m.
    """
    for start in range(table.first, table.last, FRAMES):
        frames = slice(start, min(start + FRAMES, table.last))
        around = [bounds(values[:, frames], np.asarray(reach)) for values in (table.x, table.y)]
        one, other = meeting(around, around)
        kept = (one < other) & (subjects[one] | subjects[other])
        one, other = one[kept], other[kept]
        free = table.free(one, other)
        one, other = one[free], other[free]
        for few in range(0, len(one), ELEMENTS // FRAMES):
            part = slice(few, few + ELEMENTS // FRAMES)
            yield PairFrames.of(table, frames, one[part], other[part])


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
