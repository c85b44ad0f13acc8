"""Hard braking of vehicles, one after the other, each over all of its frames at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from carla_recap.model.frame import Frame
from tests.twins.motion import FAULTY, belongs, velocities

Interval = tuple[int, float, float, float, float, float]
"""The vehicle, the start and the end; of what tyres can do the same and the greatest deceleration, NaN if it is nothing."""
TYRES = 3.5 * 9.81  # m/s²


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
    slopes, speeds = [math.nan] * len(times), [math.nan] * len(times)
    joined = [belongs(times, places, recorded, row) and restarts[row] == restarts[row + 1] for row in range(len(times) - 1)]
    hard: list[list[int]] = []  # runs of frames
    start = 0
    for stop in [row + 1 for row, follows in enumerate(joined) if not follows] + [len(times)]:
        rows = slice(start, stop)
        speeds[rows] = [math.hypot(*velocity[:2]) for velocity in velocities(times[rows], places[rows], recorded[rows])]
        slopes[rows] = _decelerations(times[rows], speeds[rows])
        run: list[int] = []
        for row in range(start, stop):
            run = [*run, row] if slopes[row] >= deceleration else []
            if len(run) == 1:
                hard.append(run)
            elif run:
                hard[-1] = run
        start = stop

    def lost(run: list[int]) -> float:
        return sum((times[row + 1] - times[row]) * (slopes[row] + slopes[row + 1]) / 2 for row in run[:-1])

    def is_enough(run: list[int]) -> bool:
        return lost(run) >= deceleration * (0.3 - 1e-6)

    def tyres_can(run: list[int]) -> bool:
        steps = [(speeds[row] - speeds[row + 1]) / (times[row + 1] - times[row]) for row in run[:-1]]
        return times[run[-1]] - times[run[0]] >= 0.3 - 1e-6 or all(step <= 1.1 * TYRES for step in steps)

    found: list[tuple[float, float]] = []
    for run in hard:
        if len(run) >= 3 and is_enough(run):
            first, last = times[run[0]], times[run[-1]]
            if found and 0 <= first - found[-1][1] < 1.0:
                first = found.pop()[0]
            found.append((first, last))
    intervals: list[Interval] = []
    for first, last in found:
        parts: list[list[int]] = []
        for row in (row for run in hard for row in run if first <= times[row] <= last and slopes[row] <= TYRES):
            if parts and row == parts[-1][-1] + 1 and joined[row - 1]:
                parts[-1].append(row)
            else:
                parts.append([row])
        possible = [row for part in parts if is_enough(part) and tyres_can(part) for row in part]
        during = [times[row] for row in possible] or [math.nan]
        hardest = max((slopes[row] for row in possible), default=math.nan)
        intervals.append((id, first, last, min(during), max(during), hardest))
    return intervals


def _decelerations(times: list[float], speeds: list[float]) -> list[float]:
    """Return the deceleration at each of some frames that belong together; NaN where it is unknown."""
    slopes = []
    for row, time in enumerate(times):
        near = [each for each, other in enumerate(times) if abs(each - row) <= 1 or abs(other - time) <= 0.125 + 1e-6]
        known = [each for each in near if not math.isnan(speeds[each])]
        has_slope = len(known) > 1 and not math.isnan(speeds[row])
        slopes.append(
            -np.polyfit(*np.transpose([(times[n] - time, speeds[n]) for n in known]), 1)[0] if has_slope else math.nan
        )
    return slopes
