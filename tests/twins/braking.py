"""Hard braking of vehicles, one after the other, each over all of its frames at once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tests.twins.motion import FAULTY, belongs, velocities

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.model.frame import Frame

Interval = tuple[int, float, float]
"""The vehicle, the start and the end."""


def braking(frames: Sequence[Frame], vehicles: Sequence[int], deceleration: float) -> list[Interval]:
    """Return the intervals of hard braking, by id, then start."""
    return [interval for id in sorted(vehicles) for interval in _of_vehicle(frames, id, deceleration)]


def _of_vehicle(frames: Sequence[Frame], id: int, deceleration: float) -> list[Interval]:
    times, places, recorded, restarts = list[float](), [], [], list[int]()
    restart = 0  # how often the clock of the recording has stood still or gone back
    for before, frame in zip([None, *frames], frames, strict=False):
        restart += before is not None and not frame.elapsed > before.elapsed
        pose = [row for row in frame["transforms"] if row["id"] == id]
        if not pose:
            continue
        velocity = [row for row in frame["velocities"] if row["id"] == id][-1:]
        known = [np.hypot(row["x"], row["y"]) for row in velocity if math.hypot(*(row[axis] for axis in "xyz")) < FAULTY]
        times.append(frame.elapsed)
        places.append(tuple(float(pose[-1][axis]) / 100 for axis in "xyz"))
        recorded.append((float(known[0]) if known else math.nan, 0.0, 0.0))
        restarts.append(restart)
    # Of what belongs together, every part by itself.
    joined = [belongs(times, places, recorded, row) and restarts[row] == restarts[row + 1] for row in range(len(times) - 1)]
    hard: list[list[int]] = []  # runs of frames
    start = 0
    for stop in [row + 1 for row, follows in enumerate(joined) if not follows] + [len(times)]:
        rows = slice(start, stop)
        slowing = _decelerations(times[rows], places[rows], recorded[rows])
        run: list[int] = []
        for row, slows in enumerate(slowing, start):
            run = [*run, row] if slows >= deceleration else []
            if len(run) == 1:
                hard.append(run)
            elif run:
                hard[-1] = run
        start = stop
    found: list[Interval] = []
    for run in hard:
        first, last = times[run[0]], times[run[-1]]
        if len(run) < 3 or last - first < 0.3 - 1e-6:
            continue
        if found and first - found[-1][2] < 1.0:
            found[-1] = id, found[-1][1], last
        else:
            found.append((id, first, last))
    return found


def _decelerations(times: list[float], places: list, recorded: list) -> list[float]:
    """Return the deceleration at each of some frames that belong together; NaN where it is unknown."""
    speeds = [math.hypot(*velocity[:2]) for velocity in velocities(times, places, recorded)]
    slopes = []
    for row, time in enumerate(times):
        near = [each for each, other in enumerate(times) if abs(each - row) <= 1 or abs(other - time) <= 0.125 + 1e-6]
        known = [each for each in near if not math.isnan(speeds[each])]
        has_slope = len(known) > 1 and not math.isnan(speeds[row])
        slopes.append(
            -np.polyfit(*np.transpose([(times[n] - time, speeds[n]) for n in known]), 1)[0] if has_slope else math.nan
        )
    return slopes
