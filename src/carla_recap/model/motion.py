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
    from collections.abc import Iterator

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
FIRMEST_BRAKING: Final = 15.0
"""The deceleration in m/s² that no brakes and tyres exceed; a collision does, and faulty records do."""
LONGEST_STEP: Final = 1.0
"""The longest time between two frames of an actor from which its motion between them follows, in s."""
MAX_FRAMES: Final = 1000
"""The most frames before and after a moment of which values count: those of half a second at 2,000 Hz."""

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


def slope(time: Floats, values: Floats, half_window: float, *, joined: Booleans | None = None) -> Floats:
    """Return the slopes of straight lines through the values around each moment; NaN where there are none.

    A single wrong value has little effect on such a slope. The values of `half_window` before and after a moment count, in
    s, and the frames next to it, but at most `MAX_FRAMES` on each side. Times are in s, (frames,), and values (series,
    frames), NaN where they are unknown. `joined` says whether each frame and the next one belong together, (frames - 1,);
    None: if at most 1 s is between them.
    """
    known = ~np.isnan(values)
    values = np.where(known, values, 0.0)
    count = known.astype(np.float64)
    times, sums, squares, products = np.zeros((4, *values.shape))
    linked = joined
    for apart in range(1, min(MAX_FRAMES + 1, len(time))):
        with np.errstate(invalid="ignore"):
            seconds = time[apart:] - time[:-apart]
            near = (seconds > 0) & (seconds <= (LONGEST_STEP if apart == 1 else half_window + SAME_TIME))
        if joined is not None and linked is not None:
            linked = joined if apart == 1 else linked[:-1] & joined[apart - 1 :]
            near = linked if apart == 1 else near & linked
        if not near.any():
            break
        seconds = np.where(near, seconds, 0.0)
        both = near & known[:, apart:] & known[:, :-apart]
        with np.errstate(invalid="ignore"):  # of infinite values
            change = np.where(both, values[:, apart:] - values[:, :-apart], 0.0)
        distance = np.where(both, seconds, 0.0)
        for rows, sign in ((slice(None, -apart), 1), (slice(apart, None), -1)):
            count[:, rows] += both
            times[:, rows] += sign * distance
            sums[:, rows] += sign * change
            squares[:, rows] += distance * distance
            products[:, rows] += distance * change
    with np.errstate(invalid="ignore"):
        spread = count * squares - times * times
        slopes = np.full(values.shape, np.nan)
        np.divide(count * products - times * sums, spread, out=slopes, where=known & (count > 1) & (spread > 0))
    return slopes
