"""Post-encroachment time: how soon after an actor has left a spot another one arrives there, where their paths cross."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.measures.boxes import Boxes, overlaps
from carla_recap.queries.measures.motion_blocks import MARGIN
from carla_recap.queries.measures.pairs import FRAMES

if TYPE_CHECKING:
    from carla_recap.queries.measures.motion_blocks import MotionBlock
    from carla_recap.util.arrays import Booleans, Floats, Indices


CROSSING: Final = 30.0
"""The least angle between paths that cross, in degrees; actors on paths with a smaller one follow each other, or meet."""

SLOWEST: Final = 1.0
"""The speed from which on an actor counts as moving, in m/s."""

STEP: Final = 0.05
"""The time between the moments that are compared, in s."""

_LAGS: Final = 128  # moments before another one that are compared with it, at most
_FINE: Final = 10  # moments per step when the time is refined
_HITS: Final = 2048  # that are examined at once
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
    arrivals = arrivals[(arrivals >= second.time[0]) & (arrivals <= second.time[-1])]
    leavings = leavings[(leavings >= first.time[0]) & (leavings <= first.time[-1])]
    late, early = (each.ravel() for each in np.meshgrid(arrivals, leavings, indexing="ij"))
    hits = (late > early) & overlaps(second.at(late), first.at(early))
    return min(lag, float((late - early)[hits].min(initial=math.inf)))


def _cross(turn: Floats) -> Booleans:
    """Return whether paths cross, by the angles between them in radians."""
    return np.asarray(np.abs(np.sin(turn)) >= _ACROSS)


class Encroachments(NamedTuple):
    """Moments at which actors arrive where others were; arrays of one length.

    Attributes:
        first: The actor that was there first, as a row of the block.
        second: The actor that arrives.
        left: The frame in which the first one is still there.
        arrived: The frame in which the second one is there.
        time: The time between both in s.
    """

    first: Indices
    second: Indices
    left: Indices
    arrived: Indices
    time: Floats

    def take(self, kept: Booleans | Indices) -> Encroachments:
        """Return some of them."""
        return Encroachments(self.first[kept], self.second[kept], self.left[kept], self.arrived[kept], self.time[kept])


def encroachments(block: MotionBlock, start: int, one: Indices, other: Indices, longest: float) -> Encroachments:
    """Return the moments in 64 frames at which one of a pair arrives where the other was, on a path that crosses its own.

    Args:
        block: The motion.
        start: The first of the 64 frames.
        one: The first actor of each pair, as a row of the block.
        other: The second actor.
        longest: The longest time between leaving and arriving, in s.
    """
    firsts, seconds = np.concatenate((one, other)), np.concatenate((other, one))
    step = _typical_step(block.time)
    stride = max(1, round(STEP / step)) if step > 0 else 1
    last = min(start + FRAMES, block.last)
    parts = []
    speed = block.speed
    radius = np.hypot(block.length, block.width) / 2
    moves = np.asarray((speed >= SLOWEST).any(axis=1))
    kept = moves[firsts] & moves[seconds]
    firsts, seconds = firsts[kept], seconds[kept]
    reach = ((radius[firsts] + radius[seconds]) ** 2)[:, None]
    open_pairs = np.ones((len(firsts), last - start), np.bool_)  # for which no shorter time is known
    arrived = np.arange(start, last)
    x, y = block.x[seconds][:, start:last], block.y[seconds][:, start:last]
    for lag in range(1, min(math.ceil(longest / (step * stride)) if step > 0 else 0, _LAGS) + 1):
        shift = lag * stride
        skipped = max(shift - start, 0)
        if skipped >= last - start or not len(firsts):
            break
        rows = slice(start + skipped - shift, last - shift)
        dx = x[:, skipped:] - block.x[firsts, rows]
        dy = y[:, skipped:] - block.y[firsts, rows]
        pair, frame = np.nonzero((dx * dx + dy * dy <= reach) & open_pairs[:, skipped:])
        if not len(pair):
            continue
        frame += skipped
        arrivals = Encroachments(firsts[pair], seconds[pair], arrived[frame] - shift, arrived[frame], np.zeros(len(pair)))
        hits = _crossing(block, speed, arrivals)
        open_pairs[pair[hits], frame[hits]] = False
        parts.append(arrivals.take(hits))
    first, second, left, found = (
        np.concatenate([np.zeros(0, np.intp), *(part[column] for part in parts)]).astype(np.intp) for column in range(4)
    )
    time = block.time[found] - block.time[left]
    joined = Encroachments(first, second, left, found, time)
    return _apart(block, joined.take((time > 0) & (time <= longest)))


def _crossing(block: MotionBlock, speed: Floats, arrivals: Encroachments) -> Indices:
    """Return which actors arrive in a frame where another was in an earlier one, on a path that crosses its own."""
    first, second, left, arrived, _ = arrivals
    kept = (speed[first, left] >= SLOWEST) & (speed[second, arrived] >= SLOWEST)
    kept &= _cross(block.yaw[second, arrived] - block.yaw[first, left])
    kept &= np.abs(block.z[second, arrived] - block.z[first, left]) <= (block.height[first] + block.height[second]) / 2
    near = np.flatnonzero(kept)
    near = near[overlaps(_boxes(block, first[near], left[near]), _boxes(block, second[near], arrived[near]))]
    follows = [_follow(block, arrivals.take(near[start : start + _HITS])) for start in range(0, len(near), _HITS)]
    return near[~np.concatenate(follows)] if follows else near


def _follow(block: MotionBlock, arrivals: Encroachments) -> Booleans:
    """Return whether arriving actors follow leaving ones, which had the same position and heading earlier."""
    first, second, _, arrived, _ = arrivals
    frames = slice(int(_before(block, arrived).min()), int(arrived.max()) + 1)
    dx = block.x[first, frames] - block.x[second, arrived][:, None]
    dy = block.y[first, frames] - block.y[second, arrived][:, None]
    distance = np.nan_to_num(dx * dx + dy * dy, nan=math.inf)
    frame = np.arange(frames.start, frames.stop)
    earliest = _before(block, arrived)[:, None]
    distance[(frame < earliest) | (frame > arrived[:, None])] = math.inf
    rows = np.arange(len(first))
    nearest = distance.argmin(axis=1)
    turn = block.yaw[first, nearest + frames.start] - block.yaw[second, arrived]
    reach = (block.width[first] + block.width[second]) / 2
    return np.asarray((distance[rows, nearest] <= reach * reach) & (np.cos(turn) >= _ALONG))


def _apart(block: MotionBlock, arrivals: Encroachments) -> Encroachments:
    """Return the arrivals of pairs that do not touch in the 3 s before and after, in which case both are there at once."""
    if not len(arrivals.time):
        return arrivals
    pairs, index = np.unique(np.stack((arrivals.first, arrivals.second)), axis=1, return_inverse=True)
    begin, end = _before(block, arrivals.arrived), _after(block, arrivals.arrived)
    frames = np.arange(begin.min(), end.max() + 1)
    touching = overlaps(_boxes(block, pairs[0][:, None], frames), _boxes(block, pairs[1][:, None], frames))
    count = np.pad(np.cumsum(touching, axis=1), ((0, 0), (1, 0)))  # of the frames before each one in which they touch
    row = index.ravel()
    return arrivals.take(count[row, end + 1 - frames[0]] == count[row, begin - frames[0]])


def _before(block: MotionBlock, frame: Indices) -> Indices:
    """Return the first frame within 3 s before each of some frames; the margins of a block have all of these."""
    return np.minimum(np.searchsorted(block.time, block.time[frame] - MARGIN + SAME_TIME), frame)


def _after(block: MotionBlock, frame: Indices) -> Indices:
    """Return the last frame within 3 s after each of some frames."""
    return np.maximum(np.searchsorted(block.time, block.time[frame] + MARGIN - SAME_TIME) - 1, frame)


def _boxes(block: MotionBlock, actor: Indices, frame: Indices) -> Boxes:
    return Boxes(
        block.x[actor, frame], block.y[actor, frame], block.yaw[actor, frame], block.length[actor], block.width[actor]
    )


def _typical_step(time: Floats) -> float:
    """Return the median of the time between frames in s; 0 without one."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 0.0


def path_of(block: MotionBlock, actor: int, frame: int) -> Path:
    """Return the path of an actor of a block around a frame, as long as it is present without a break."""
    known = ~np.isnan(block.x[actor])
    known[1:] &= np.diff(block.time) > 0
    absent = np.flatnonzero(~known)
    place = int(np.searchsorted(absent, frame))
    begin = int(absent[place - 1]) + 1 if place else 0
    stop = int(absent[place]) if place < len(absent) else len(known)
    rows = slice(begin, max(stop, begin + 1))
    return Path(
        block.time[rows],
        block.x[actor, rows],
        block.y[actor, rows],
        block.yaw[actor, rows],
        float(block.length[actor]),
        float(block.width[actor]),
    )
