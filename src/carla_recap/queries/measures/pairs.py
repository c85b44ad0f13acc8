"""Pairs of actors that are near each other, frame by frame, and what is computed for each pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.queries.measures.boxes import Boxes, gap, time_to_collision

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.queries.measures.motion_blocks import MotionBlock
    from carla_recap.util.arrays import Booleans, Floats, Indices


FRAMES: Final = 64
"""The number of frames for which near pairs are looked for at once."""
HORIZON: Final = 10.0
"""The longest time to collision that is computed, in s."""

_PAIRS: Final = 1 << 17  # of 64 frames, at most
_ELEMENTS: Final = 1 << 19  # pairs and frames that are computed at once
_STEP: Final = 0.5  # m; boxes with more than this height between them are on different levels


def near_pairs(
    block: MotionBlock, subjects: Booleans, reach: float | Floats, *, frames: int = FRAMES
) -> Iterator[tuple[int, Indices, Indices]]:
    """Yield the pairs that may be near each other within some frames: the first frame, and the actors of each pair.

    Of two walkers, and of actors one of which is attached to the other, there are no pairs. If more than 131,072 pairs are
    near each other, those that are beside each other along x come first.

    Args:
        block: The motion.
        subjects: Whether an actor is of interest, (actors,); one of a pair is.
        reach: The distance in m from the centre of an actor within which the other's reach has to be; for all actors, or for
            each.
        frames: The number of frames for which near pairs are looked for at once.
    """
    reach = np.broadcast_to(np.asarray(reach, np.float64), block.ids.shape)
    parent = {actor.id: actor.parent for actor in block.actors if actor.parent is not None}
    starts = range(block.first, block.last, frames)
    edges = list(starts)
    if not edges or len(block.ids) < 2:
        return
    bounds = [_bounds(values[:, block.core], np.array(edges) - block.first, reach) for values in (block.x, block.y)]
    for number, start in enumerate(starts):
        (left, right), (bottom, top) = ((low[:, number], high[:, number]) for low, high in bounds)
        present = np.flatnonzero(left <= right)
        order = present[np.argsort(left[present], kind="stable")]
        counts = np.searchsorted(left[order], right[order], side="right") - np.arange(1, len(order) + 1)
        if counts.sum() > _PAIRS:
            counts = np.minimum(counts, _PAIRS // len(order) + 1)
        first = np.repeat(np.arange(len(order)), counts)
        second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
        one, other = order[first], order[second]
        near = (bottom[one] <= top[other]) & (bottom[other] <= top[one])
        near &= (subjects[one] | subjects[other]) & (block.is_vehicle[one] | block.is_vehicle[other])
        one, other = one[near], other[near]
        if parent:
            ids = block.ids
            free = [
                parent.get(a) != b and parent.get(b) != a
                for a, b in zip(ids[one].tolist(), ids[other].tolist(), strict=True)
            ]
            one, other = one[free], other[free]
        step = _ELEMENTS // frames
        for begin in range(0, len(one), step):
            yield start, one[begin : begin + step], other[begin : begin + step]


def _bounds(values: Floats, edges: Indices, reach: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest value from each edge to the next, less and more the reach; inf, -inf without any."""
    absent = np.isnan(values)
    low = np.minimum.reduceat(np.where(absent, np.inf, values), edges, axis=1)
    high = np.maximum.reduceat(np.where(absent, -np.inf, values), edges, axis=1)
    return low - reach[:, None], high + reach[:, None]


@dataclass(frozen=True, eq=False)
class PairFrames:
    """Pairs of actors in frames in which both are present, on one level; arrays of one length.

    Attributes:
        block: The motion.
        one: The first actor of each pair.
        other: The second actor.
        frame: The frame.
        dx, dy: The centre of the second minus that of the first, in m.
        vx, vy: The velocity of the second minus that of the first, in m/s.
        distance: The distance of the centres in m.
    """

    block: MotionBlock
    one: Indices
    other: Indices
    frame: Indices
    dx: Floats
    dy: Floats
    vx: Floats
    vy: Floats
    distance: Floats

    @staticmethod
    def of(block: MotionBlock, start: int, one: Indices, other: Indices, *, frames: int = FRAMES) -> PairFrames:
        """Return pairs in some frames from one on."""
        rows = slice(start, min(start + frames, block.last))

        def difference(values: Floats) -> Floats:
            part = values[:, rows]
            return np.asarray(part[other] - part[one])

        dx, dy, dz = difference(block.x), difference(block.y), difference(block.z)
        level = np.abs(dz) <= ((block.height[one] + block.height[other]) / 2 + _STEP)[:, None]
        pair, frame = np.nonzero(level)  # False for NaN
        dx, dy = dx[pair, frame], dy[pair, frame]
        vx, vy = difference(block.vx)[pair, frame], difference(block.vy)[pair, frame]
        return PairFrames(block, one[pair], other[pair], frame + start, dx, dy, vx, vy, np.hypot(dx, dy))

    def take(self, kept: Booleans | Indices) -> PairFrames:
        """Return some of them."""
        return PairFrames(
            self.block,
            self.one[kept],
            self.other[kept],
            self.frame[kept],
            self.dx[kept],
            self.dy[kept],
            self.vx[kept],
            self.vy[kept],
            self.distance[kept],
        )

    def turned(self) -> PairFrames:
        """Return the pairs with their actors exchanged."""
        return PairFrames(
            self.block, self.other, self.one, self.frame, -self.dx, -self.dy, -self.vx, -self.vy, self.distance
        )

    def __len__(self) -> int:
        return len(self.frame)

    def around(self) -> Floats:
        """Return the sum of the radii of circles around both boxes in m."""
        radius = np.hypot(self.block.length, self.block.width) / 2
        return np.asarray(radius[self.one] + radius[self.other])

    def within(self) -> Floats:
        """Return the sum of the radii of circles within both boxes in m."""
        radius = np.minimum(self.block.length, self.block.width) / 2
        return np.asarray(radius[self.one] + radius[self.other])

    def boxes(self) -> tuple[Boxes, Boxes]:
        """Return the boxes of both actors, the first one at rest in the origin."""
        block, one, other = self.block, self.one, self.other
        yaw = block.yaw
        return (
            Boxes(0.0, 0.0, yaw[one, self.frame], block.length[one], block.width[one]),
            Boxes(self.dx, self.dy, yaw[other, self.frame], block.length[other], block.width[other], self.vx, self.vy),
        )

    def gap(self) -> Floats:
        """Return the gaps in m."""
        return gap(*self.boxes())

    def time_to_collision(self, horizon: float = HORIZON) -> Floats:
        """Return the times to collision in s; inf above the horizon."""
        times = np.full(len(self), np.inf)
        speed = np.hypot(self.vx, self.vy)
        around = self.around()
        with np.errstate(invalid="ignore"):
            toward = -(self.dx * self.vx + self.dy * self.vy)  # times the speed
            aside = np.abs(self.dx * self.vy - self.dy * self.vx)  # times the speed
            possible = (toward > 0) & (aside <= around * speed) & (self.distance - around <= speed * horizon)
        found = np.flatnonzero(possible | (self.distance <= around))
        if len(found):
            near = time_to_collision(*self.take(found).boxes())
            times[found] = np.where(near <= horizon, near, np.inf)
        return times


@dataclass(frozen=True, eq=False)
class Following:
    """Vehicles ahead on the same path; arrays of one length.

    Attributes:
        pairs: The followers and the vehicles ahead of them.
        gap: The distance from bumper to bumper along the heading of the follower, in m.
    """

    pairs: PairFrames
    gap: Floats


_SAME_HEADING: Final = np.cos(np.deg2rad(45.0))


def ahead(pairs: PairFrames) -> Following:
    """Return the pairs in which the second actor is a vehicle ahead of the first, in the corridor as wide as the first.

    Its heading differs by 45 degrees at most.
    """
    block = pairs.block
    pairs = pairs.take(block.is_vehicle[pairs.other])
    yaw = block.yaw[pairs.one, pairs.frame]
    cos, sin = np.cos(yaw), np.sin(yaw)
    along, across = pairs.dx * cos + pairs.dy * sin, np.abs(pairs.dy * cos - pairs.dx * sin)
    half_width, reach = block.width / 2, np.hypot(block.length, block.width) / 2
    kept = (along > 0) & (across < half_width[pairs.one] + reach[pairs.other])
    pairs, along, across = pairs.take(kept), along[kept], across[kept]
    turn = block.yaw[pairs.other, pairs.frame] - block.yaw[pairs.one, pairs.frame]
    cos, sin = np.cos(turn), np.abs(np.sin(turn))
    length, width = block.length[pairs.other] / 2, half_width[pairs.other]
    kept = (cos >= _SAME_HEADING) & (across < half_width[pairs.one] + sin * length + cos * width)
    gaps = along - block.length[pairs.one] / 2 - cos * length - sin * width
    return Following(pairs.take(kept), np.maximum(gaps[kept], 0.0))
