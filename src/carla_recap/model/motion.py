"""How actors move: one rule for velocities, accelerations and rates, recorded or not, and what a jump is.

The velocity of an actor at a frame is the recorded one, if it is finite and slower than 150 m/s. Else it is the central
difference of its places, with the same bound: between its frame before and its frame behind, of those that have its pose,
each of which counts if it is of the same life, at most 1 s away, and no jump lies between; next to a jump or at an end,
one of them counts. Without any, the velocity is unknown: NaN. Other rates, such as an acceleration of velocities, are the
differences between the same frames.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import CM

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.util.arrays import Booleans, Floats, Indices, Integers


Value = TypeVar("Value", float, "Floats")

MOTION: Final = ("transforms", "velocities")
"""The record types of positions and velocities."""
JUMP: Final = 5.0
"""The shortest step that can be a jump, in m."""
TOP_SPEED: Final = 100.0
"""The speed that no actor exceeds, in m/s."""
FAULTY_SPEED: Final = 150.0
"""The speed in m/s from which on a velocity is faulty, recorded or derived: it does not count."""
GRAVITY: Final = 9.81
"""The acceleration of what falls, in m/s², as Unreal Engine has it."""
MAX_DECELERATION: Final = 3.5 * GRAVITY
"""The deceleration in m/s² that CARLA's tyres, of friction 3.5, do not exceed; a collision does, and faulty records do."""
LONGEST_STEP: Final = 1.0
"""The longest time between two frames of an actor from which its motion between them follows, in s."""

_CELLS: Final = 1 << 15  # values whose slopes are computed together, about; more are slower
_SLACK: Final = 3.0  # a jump is longer than the recorded velocity explains by more than this factor


def place_in_metres(x: Value, y: Value, z: Value) -> tuple[Value, Value, Value]:
    """Return a place, or places, in m and right-handed axes; CARLA has them in cm, left-handed: y is turned around."""
    return x * CM, 0.0 - y * CM, z * CM


def possible_step(seconds: Floats | float, speed: Floats | float = np.nan, *, least: float = JUMP) -> Floats:
    """Return how far an actor gets in some time at most, in m; a longer step is a jump.

    That is three times the way at the recorded velocity, or the way at 100 m/s if none is recorded, and at least 5 m. In
    0.2 s, a step of 19 m is possible, but a jump if the recorded velocity is 30 m/s, which explains 18 m.

    The speed is the greater one of the velocities recorded at the ends of the step, in m/s, NaN if none is; a faulty one
    counts as none. `least` is the shortest step that can be a jump if no velocity is recorded, in m: 0 where a speed is
    derived from it.
    """
    seconds, speed = np.asarray(seconds), np.asarray(speed)
    unknown, derived = ~(speed < FAULTY_SPEED), np.asarray(np.maximum(TOP_SPEED * seconds, least))
    return derived if unknown.all() else np.where(unknown, derived, np.maximum(_SLACK * speed * seconds, JUMP))


def steps_joined(
    time: Floats,
    places: Floats,
    speed: Floats | float = np.nan,
    actor: Integers | None = None,
    *,
    longest: float = LONGEST_STEP,
) -> Booleans:
    """Return whether motion follows from each place of an actor and its next one, (n - 1,).

    It does if the next one is later, by `longest` s at most, without a jump; no place that is not finite is joined.
    Times are elapsed seconds, (n,), places are in m, (axes, n), and recorded speeds in m/s, (n,), NaN where none is. `actor`
    is a number of the life at each place, if there are several, one after the other, (n,).
    """
    speed = np.broadcast_to(np.where(np.asarray(speed) < FAULTY_SPEED, speed, np.nan), len(time))
    with np.errstate(all="ignore"):
        seconds, distance = np.diff(time), np.sqrt((np.diff(places) ** 2).sum(axis=0))
        joined = (seconds > 0) & (seconds <= longest)
        joined &= distance <= possible_step(seconds, np.fmax(speed[1:], speed[:-1]), least=0.0)
    return joined if actor is None else joined & (np.diff(actor) == 0)


def motion_of(time: Floats, places: Floats, recorded: Floats, actor: Integers | None = None) -> tuple[Floats, Booleans]:
    """Return the velocities at places in m/s, (axes, n), and whether motion follows from each and its next one, (n - 1,).

    Arguments are as of `steps_joined`; recorded velocities are in m/s, (axes, n), NaN where none is.
    """
    known = counts(recorded)
    joined = steps_joined(time, places, np.sqrt((recorded**2).sum(axis=0)) if known.any() else np.nan, actor)
    if known.all():
        return recorded, joined
    derived = rates(time, places, joined)
    np.copyto(derived, np.nan, where=~counts(derived))
    return np.where(known, recorded, derived) if known.any() else derived, joined


@np.errstate(invalid="ignore", over="ignore")
def counts(velocities: Floats) -> Booleans:
    """Return which velocities in m/s, (axes, ...), count: those that are finite, and slower than 150 m/s."""
    return np.asarray(np.sqrt((velocities**2).sum(axis=0)) < FAULTY_SPEED)


def rates(time: Floats, values: Floats, joined: Booleans, *, period: float | None = None) -> Floats:
    """Return the changes of values per second between the neighbours of each frame, (..., n); NaN without a neighbour.

    Times are elapsed seconds, (n,); `joined` says whether each frame and the next one belong together, (n - 1,). A period is
    a whole turn of angles, of which the change is the shorter way around.
    """
    before, after = neighbours(joined)
    with np.errstate(all="ignore"):
        seconds = np.where(after > before, time[after] - time[before], np.nan)
        changes = values.take(after, axis=-1) - values.take(before, axis=-1)
        if period is not None:
            changes -= period * np.rint(changes / period)
        return np.asarray(changes / seconds)


def neighbours(joined: Booleans) -> tuple[Indices, Indices]:
    """Return the frame before each frame and the one behind it, or itself in place of one that it does not belong to.

    If the first two of three frames belong together, that is 0 0 2 and 1 1 2.

    `joined` says whether each frame and the next one belong together, (frames - 1,).
    """
    frame = np.arange(len(joined) + 1)
    return frame - np.append(False, joined), frame + np.append(joined, False)


def runs(flags: Booleans, joined: Booleans) -> Iterator[tuple[int, int]]:
    """Yield the first and last of runs of flagged frames, (frames,); each and the next one are joined, (frames - 1,)."""
    goes_on = flags[1:] & flags[:-1] & joined
    first = flags & ~np.append(False, goes_on)[: len(flags)]
    last = flags & ~np.append(goes_on, False)[: len(flags)]
    yield from zip(np.flatnonzero(first).tolist(), np.flatnonzero(last).tolist(), strict=True)


@np.errstate(invalid="ignore", over="ignore")  # of times and values that are not finite
def slope(time: Floats, values: Floats, half_window: float, *, joined: Booleans | None = None) -> Floats:
    """Return the slopes of straight lines through the values around each moment; NaN where there are none.

    A single wrong value has little effect on such a slope. The values of `half_window` before and after a moment count, in
    s, and the frames next to it. Times are in s, (frames,), and values (series, frames), NaN where they are unknown.
    `joined` says whether each frame and the next one belong together, (frames - 1,), of which the next one is later, by at
    most 1 s; None: wherever it is.
    """
    seconds = np.diff(time)
    joined = (seconds > 0) & (seconds <= LONGEST_STEP) if joined is None else joined
    clock = np.append(0.0, np.cumsum(np.where(joined, seconds, LONGEST_STEP + half_window)))
    before, after = neighbours(joined)
    first = np.minimum(np.searchsorted(clock, clock - half_window - SAME_TIME), before)
    last = np.maximum(np.searchsorted(clock, clock + half_window + SAME_TIME, side="right") - 1, after)
    found, few = np.full(values.shape, np.nan), max(1, _CELLS // len(clock))
    for rows in (slice(start, start + few) for start in range(0, len(values), few)):
        row, frame = np.nonzero(~np.isnan(values[rows]))
        until = np.append(0, np.cumsum(~np.isnan(values[rows])))
        begin, end = (until[row * len(time) + each[frame]] for each in (first, last + 1))
        found[rows][row, frame] = _slopes(time[frame], values[rows][row, frame], begin, end)
    return found


def _slopes(time: Floats, values: Floats, begin: Indices, end: Indices) -> Floats:
    """Return the slope of a line through the values from one on and before another one, for each of n values, (n,).

    The sums of 1, 2, 4 ... values from each one on make up those of any number. All are of times and values relative to
    the first one, so that nothing is lost by rounding.
    """
    count = end - begin
    sums = blocks = [np.zeros(len(values)) for _ in range(4)]  # of times, values, squared times, and products of both
    length = 1
    while length <= count.max(initial=0):
        is_part = count & length
        at = np.minimum(begin, len(blocks[0]) - 1)
        moved = _moved([each[at] for each in blocks], length, time[at] - time, values[at] - values)
        sums = [each + np.where(is_part, more, 0.0) for each, more in zip(sums, moved, strict=True)]
        begin = begin + is_part
        fewer = max(len(values) + 1 - 2 * length, 0)
        later = slice(length, length + fewer)
        seconds, change = time[later] - time[:fewer], values[later] - values[:fewer]
        moved = _moved([each[later] for each in blocks], length, seconds, change)
        blocks = [each[:fewer] + more for each, more in zip(blocks, moved, strict=True)]
        length *= 2
    times, changes, squares, products = sums
    spread = count * squares - times * times
    found = np.full(len(values), np.nan)
    np.divide(count * products - times * changes, spread, out=found, where=spread > 0)
    return found


def _moved(sums: Sequence[Floats], count: int, seconds: Floats, change: Floats) -> tuple[Floats, ...]:
    """Return sums for another origin, which is some seconds earlier, and less by the change."""
    times, values, squares, products = sums
    later, greater = times + count * seconds, values + count * change
    return later, greater, squares + seconds * (times + later), products + seconds * greater + change * times
