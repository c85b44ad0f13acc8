"""How the hero drives, in the numbers of Bench2Drive: driving efficiency and smoothness.

Its `tools/efficiency_smoothness_benchmark.py` defines them; the bounds of comfort are nuPlan's. See docs/scores.md.
"""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.measures.drives import ground_speed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from carla_recap.queries.measures.drives import Drive
    from carla_recap.tables.trajectories import Trajectory
    from carla_recap.util.arrays import Floats, Integers

COMFORT: Final[Mapping[str, tuple[float, float]]] = {
    "longitudinal_acceleration": (-4.05, 2.40),
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
    "longitudinal_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_acceleration": (-1.93, 1.93),
}
"""The bounds of comfort by quantity, in m/s², m/s³, rad/s and rad/s²."""

BACKGROUND: Final = "background"
"""The role_name of the vehicles of the traffic."""

_CHECKPOINTS: Final = 20  # parts of a route
_MAX_EFFICIENCY: Final = 1000.0  # %: a part with more, as beside traffic that stands, does not count
_LAST_COUNTS: Final = 2  # how often the last part counts: the evaluator ends its criterion twice
_WITH_PHYSICS: Final = 70.0  # m from the hero within which the evaluator's traffic manager moves vehicles with physics
_ALMOST: Final = 0.95  # of the route: from there on, the last part counts
_STEP: Final = 0.1  # s between two samples
_SAMPLES: Final = 20  # samples that are judged together
_WIDTH: Final = 7  # samples through which a parabola is laid
_MIN_SAMPLES: Final = 3  # of a parabola
_MAX_SAMPLES: Final = 100  # per frame; a recording with fewer frames says nothing about comfort


class Comfort(NamedTuple):
    """How smoothly a vehicle drives."""

    smoothness: float  # the windows of 2 s in which all quantities are within their bounds, in % of all
    within: dict[str, float]  # those in which each quantity is, by its name in `COMFORT`


def efficiency(drive: Drive, travelled: Floats, length: float, others: Sequence[Trajectory]) -> float | None:
    """Return the mean speed of the hero in % of that of the background vehicles, the mean of twenty parts of the route.

    It is None without background vehicles, or if no part is completed; see `traffic_shares`.
    """
    shares = [share for _, share in traffic_shares(drive, travelled, length, others, _CHECKPOINTS)] if others else []
    counted = [share for share in shares if share <= _MAX_EFFICIENCY]
    return fmean(counted) if counted else None


def traffic_shares(
    drive: Drive, travelled: Floats, length: float, others: Iterable[Trajectory], parts: int
) -> Iterator[tuple[int, float]]:
    """Yield the frame in which each part of a route ends, and the speed of the hero there in % of that of the traffic.

    Args:
        drive: The drive of the hero.
        travelled: How far it has come along the route in each frame, in m, (n,).
        length: The length of the route, in m.
        others: The trajectories of the background vehicles.
        parts: The number of equal parts.
    """
    sums, counts = np.zeros((2, len(drive)))
    for path in others:
        frames = np.minimum(np.searchsorted(drive.time, path.time - SAME_TIME), len(drive) - 1)
        speed = _reported_speed(drive, path, frames)
        both = (np.abs(drive.time[frames] - path.time) < SAME_TIME) & np.isfinite(speed)
        sums += np.bincount(frames[both], speed[both], len(drive))
        counts += np.bincount(frames[both], minlength=len(drive))
    known = (counts > 0) & np.isfinite(drive.speed)
    traffic = np.where(known, sums / np.maximum(counts, 1), 0.0)
    hero = np.where(known, drive.speed, 0.0)
    first, begin = 0, 0.0
    ends = []
    while len(over := np.flatnonzero(travelled[first:] - begin > length / parts)):
        end = first + int(over[0])
        ends.append((first, end))
        first, begin = end, float(travelled[end])
    if travelled[-1] > _ALMOST * length:
        ends += [(first, len(drive))] * _LAST_COUNTS
    for start, end in ends:
        points, mean = known[start:end].sum(), float(traffic[start:end].sum())
        yield min(end, len(drive) - 1), round(float(hero[start:end].sum()) / mean * 100, 2) if points and mean else 100.0


def _reported_speed(drive: Drive, path: Trajectory, frames: Integers) -> Floats:
    """Return the speed of a background vehicle as CARLA reports it, in m/s, (frames,).

    The evaluator's traffic manager moves vehicles that are far from the hero without physics. Of such a vehicle, CARLA
    reports the speed that it had when it was near the hero, or 0 if it never was.
    """
    away = np.hypot(path.x - drive.position[frames, 0], path.y - drive.position[frames, 1])
    has_physics = path.velocity_recorded | (away < _WITH_PHYSICS)
    row = np.maximum.accumulate(np.where(has_physics, np.arange(len(away)), -1))
    speed: Floats = np.where(row >= 0, ground_speed(path)[row], 0.0)
    return speed


def comfort(time: Floats, velocity: Floats, yaw: Floats) -> Comfort | None:
    """Return how smoothly a vehicle drives; None for less than 0.2 s, or a motion with less than a frame in 10 s.

    Times are in s, ascending, (n,), velocities over the ground in m/s, (n, 2), and headings in radians, (n,). Rows whose
    time or velocity is no number do not count.
    """
    known = np.isfinite(velocity).all(axis=1) & np.isfinite(time)
    time, velocity, yaw = time[known], velocity[known], yaw[known]
    samples = int((time[-1] - time[0]) / _STEP + 1e-6) + 1 if len(time) else 0  # the end counts in spite of rounding
    if not _MIN_SAMPLES <= samples <= _MAX_SAMPLES * len(time):
        return None
    at = time[0] + np.arange(samples) * _STEP
    vx, vy, heading = (np.interp(at, time, values) for values in (*velocity.T, np.unwrap(yaw)))
    ax, ay, turning = (np.gradient(values, _STEP) for values in (vx, vy, heading))
    values = comfort_values(
        ax * np.cos(heading) + ay * np.sin(heading), ay * np.cos(heading) - ax * np.sin(heading), turning
    )
    inside = {
        name: ((values[name] > least) & (values[name] < greatest)).all(axis=1) for name, (least, greatest) in COMFORT.items()
    }
    return Comfort(
        100 * float(np.all(list(inside.values()), axis=0).mean()),
        {name: 100 * float(windows.mean()) for name, windows in inside.items()},
    )


def comfort_values(along: Floats, aside: Floats, turning: Floats) -> dict[str, Floats]:
    """Return the quantities of `COMFORT` in windows of 2 s, (windows, 20); samples after the last window do not count.

    Accelerations along and aside are in m/s², yaw rates in rad/s, each 0.1 s, (n,); fewer than 20 are one window.
    """
    count = min(len(along), _SAMPLES)
    smooth, slope = _parabolas(count)
    windows = [
        values[: len(values) // count * count].reshape(-1, count) @ smooth.T
        for values in (along, aside, np.hypot(along, aside), turning)
    ]
    return {
        "longitudinal_acceleration": windows[0],
        "lateral_acceleration": windows[1],
        "jerk": windows[2] @ slope.T,
        "longitudinal_jerk": windows[0] @ slope.T,
        "yaw_rate": windows[3],
        "yaw_acceleration": windows[3] @ slope.T,
    }


def _parabolas(count: int) -> tuple[Floats, Floats]:
    """Return the matrices for values and slopes of parabolas through the samples around each (Savitzky and Golay)."""
    width = min(_WIDTH, count)
    values, slopes = np.zeros((2, count, count))
    for row in range(count):
        around = np.arange(width) + min(max(row - width // 2, 0), count - width)
        values[row, around], slopes[row, around], _ = np.linalg.pinv(np.vander(around - row, 3, increasing=True))
    return values, slopes / _STEP
