"""Whether two actors meet on the paths that they really take, not only along straight lines."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.queries.measures.boxes import Boxes, time_to_collision
from carla_recap.queries.measures.pairs import ELEMENTS

if TYPE_CHECKING:
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.queries.measures.pairs import PairFrames
    from carla_recap.util.arrays import Booleans, Floats, Indices


LATER: Final = 0.5
"""The time by which actors may meet later on their paths than along straight lines, in s."""
SEEN: Final = 3.0
"""The time after a collision along straight lines up to which paths are known, in s."""
BEND_TIME: Final = 3.0
"""The time before the end of a path in which its bend is determined, in s."""

_STEP: Final = 0.1  # s in which an actor goes straight on, at least
_STEPS: Final = 100  # until actors meet, at most; each is as much longer
_BEND: Final = 3.0  # m of a path by which its bend is determined
_SHARPEST: Final = 0.3  # radians per m
_BESIDE: Final = 0.3  # m between boxes that still meet


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
    few = ELEMENTS // _STEPS
    for some in (open_pairs[start : start + few] for start in range(0, len(open_pairs), few)):
        counts[some] = paths_meet(table, pairs.one[some], pairs.other[some], frame[some], times[some])
    return counts


def paths_meet(table: MotionTable, one: Indices, other: Indices, frame: Indices, times: Floats) -> Booleans:
    """Return whether actors that keep their speed from a frame on meet on their paths; see `on_collision_course`."""
    step = np.maximum(_STEP, (times + LATER) / _STEPS)[:, None]
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
    x, y, yaw = (
        np.where(  # an actor may stand and turn
            distance == 0,
            values[actor, frame][:, None],
            np.where(
                wanted >= length[:, None],
                values[actor, end][:, None],
                np.interp(known, covered.take(present), values.take(present)),
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
    steps = np.diff(beyond, axis=1, prepend=0.0)
    return x + np.cumsum(steps * np.cos(yaw), axis=1), y + np.cumsum(steps * np.sin(yaw), axis=1), yaw
