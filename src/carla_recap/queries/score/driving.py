"""How the hero drives, in the numbers of Bench2Drive: driving efficiency and smoothness.

Its `tools/efficiency_smoothness_benchmark.py` defines them; the bounds of comfort are nuPlan's. See docs/scores.md.
"""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.queries.score.criteria import traffic_shares

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from carla_recap.queries.score.drives import Drive, PlannedRoute
    from carla_recap.tables.trajectories import Trajectory
    from carla_recap.util.arrays import Floats

COMFORT: Final[Mapping[str, tuple[float, float]]] = {
    "longitudinal_acceleration": (-4.05, 2.40),
    "lateral_acceleration": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
    "longitudinal_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_acceleration": (-1.93, 1.93),
}
"""The bounds of comfort by quantity, in m/s², m/s³, rad/s and rad/s²."""

_CHECKPOINTS: Final = 20  # parts of a route
_MAX_EFFICIENCY: Final = 1000.0  # %: a part with more, as beside traffic that stands, does not count
_STEP: Final = 0.1  # s between two samples
_WINDOW: Final = 20  # samples that are judged together
_WIDTH: Final = 7  # samples through which a parabola is laid
_MIN_SAMPLES: Final = 3  # of a parabola
_MAX_SAMPLES: Final = 100  # per frame; a recording with fewer frames says nothing about comfort


class Comfort(NamedTuple):
    """How smoothly a vehicle drives.

    Attributes:
        smoothness: The windows of 2 s in which all quantities are within their bounds, in % of all.
        within: Those in which each quantity is, by its name in `COMFORT`.
    """

    smoothness: float
    within: dict[str, float]


def efficiency(drive: Drive, route: PlannedRoute, others: Sequence[Trajectory]) -> float | None:
    """Return the mean speed of the hero in % of that of the background vehicles, the mean of twenty parts of the route.

    Args:
        drive: The drive of the hero.
        route: The route.
        others: The trajectories of the background vehicles.

    Returns:
        The percentage; None without background vehicles, or if no part is completed.
    """
    shares = [share for _, share in traffic_shares(drive, route, others, _CHECKPOINTS)] if others else []
    counted = [share for share in shares if share <= _MAX_EFFICIENCY]
    return fmean(counted) if counted else None


def comfort(time: Floats, velocity: Floats, yaw: Floats) -> Comfort | None:
    """Return how smoothly a vehicle drives.

    Args:
        time: The times in s, ascending, (n,).
        velocity: The velocities over the ground in m/s, (n, 2); rows whose time or velocity is no number do not count.
        yaw: The headings in radians, (n,).

    Returns:
        The comfort; None for less than 0.2 s, or a motion with less than a frame in 10 s.
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

    Args:
        along: The longitudinal accelerations in m/s², a sample each 0.1 s, (n,); fewer than 20 are one window.
        aside: The lateral accelerations in m/s².
        turning: The yaw rates in rad/s.
    """
    count = min(len(along), _WINDOW)
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
