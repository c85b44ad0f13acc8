"""How an actor drives, along which points of a route, and in the numbers of Bench2Drive: efficiency and smoothness.

Bench2Drive's `tools/efficiency_smoothness_benchmark.py` defines them, and nuPlan the bounds of comfort; see docs/scores.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from statistics import fmean
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.presence import FAR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from carla_recap.model.lives import ActorLife
    from carla_recap.tables.trajectories import Trajectory
    from carla_recap.util.arrays import Floats, Indices, Integers

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

WINDOW: Final = 2
"""The points of a route that are passed in a tick."""

_TICK: Final = 0.05  # s between two updates of the evaluator's criteria
LONGEST_FRAME: Final = 5.0
"""The time in s; of a longer frame, criteria have as many ticks as of one that lasts as long."""
_SPACING: Final = 1.0  # m between the points of a route


@dataclass(frozen=True, eq=False)
class Drive:
    """How an actor moves; arrays for its n frames."""

    actor: ActorLife
    time: Floats  # elapsed seconds, (n,)
    position: Floats  # x, y and z in m, right-handed, (n, 3)
    yaw: Floats  # the heading in radians, (n,)
    speed: Floats  # over the ground in m/s, (n,)
    velocity: Floats  # over the ground in m/s, (n, 2); it may be no number
    steps: Floats  # the distance from the place before in m, 0 for a jump, (n,)

    @classmethod
    def of(cls, actor: ActorLife, path: Trajectory) -> Drive:
        """Return the motion of an actor, without frames in which its pose is no number, or is too far away.

        Of a clock that goes back, the frames count that are later than all before.
        """
        path = path.ascending()
        place = np.stack((path.x, path.y, path.z), axis=1)
        kept = (np.abs(place) < FAR).all(axis=1) & np.isfinite(path.yaw)
        path = path.at(kept)
        velocity, steps = np.stack((path.vx, path.vy), axis=1), np.append(0.0, np.nan_to_num(path.steps))
        return cls(actor, path.time, place[kept], np.radians(path.yaw), ground_speed(path), velocity, steps[: len(path)])

    def __len__(self) -> int:
        return len(self.time)

    def during(self, start: float, stop: float) -> Drive:
        """Return the frames from a time on and before another one, in elapsed seconds."""
        rows = np.flatnonzero((self.time > start - SAME_TIME) & (self.time < stop - SAME_TIME))
        return self.part(rows[0], rows[-1]) if len(rows) else self.part(0, -1)

    def part(self, first: int, last: int) -> Drive:
        """Return some of the frames, both ends included."""
        rows = slice(first, last + 1)
        values = (self.time, self.position, self.yaw, self.speed, self.velocity, self.steps)
        return Drive(self.actor, *(each[rows] for each in values))

    @cached_property
    def driven(self) -> Floats:
        """The distance driven until each frame in m, (n,)."""
        return np.cumsum(self.steps) - self.steps[:1]

    @property
    def half_length(self) -> float:
        """Half of the length of the actor in m."""
        return box_of(self.actor).extent_x

    def behind(self, distance: float) -> Floats:
        """Return the points at a distance behind the actor, (n, 3)."""
        back = np.stack((np.cos(self.yaw), np.sin(self.yaw), np.zeros(len(self))), axis=1)
        points: Floats = self.position - distance * back
        return points

    @cached_property
    def frames(self) -> Indices:
        """The frame of each tick of the evaluator, (ticks,); a frame that is longer has several."""
        seconds = np.diff(self.time, prepend=self.time[:1])
        counts = np.clip(np.rint(np.nan_to_num(seconds) / _TICK), 1, LONGEST_FRAME / _TICK)
        return np.repeat(np.arange(len(self)), counts.astype(np.int64))

    @cached_property
    def ticks(self) -> list[tuple[float, float, float]]:
        """The position at each tick of the evaluator."""
        places = self.position.tolist()
        return [places[frame] for frame in self.frames.tolist()]


def ground_speed(path: Trajectory) -> Floats:
    """Return the speed over the ground; NaN where it is unknown."""
    speed = np.hypot(path.vx, path.vy)
    return np.where(np.isfinite(speed), speed, np.nan)


@dataclass(frozen=True, eq=False)
class PlannedRoute:
    """A route as a row of points."""

    points: Floats  # (n, 3), in m
    ahead: Floats  # the driving direction at each, as vectors of length 1, (n, 3)
    travelled: Floats  # the distance of each from the first one along the route, in m, (n,)
    junction: float | None = None  # the share of the points in % to a bit behind the first one in a junction

    @classmethod
    def of_drive(cls, drive: Drive) -> PlannedRoute:
        """Return the driven path of an actor as a route."""
        count = int(drive.driven[-1] / _SPACING)
        rows = np.unique(np.searchsorted(drive.driven, np.arange(count + 1) * _SPACING))
        yaw = drive.yaw[rows]
        ahead = np.stack((np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))), axis=1)
        return cls(drive.position[rows], ahead, drive.driven[rows])

    @property
    def length(self) -> float:
        """The length in m."""
        return float(self.travelled[-1])

    def passed(self, ticks: Iterable[tuple[float, float, float]], window: int) -> Iterator[tuple[int, int]]:
        """Yield the index of the tick and of the point for each point that an actor at positions passes, in order.

        It may pass as many of the points ahead in a tick as there are in the window.
        """
        rows, index = np.hstack((self.points, self.ahead)).tolist(), 0
        for tick, (x, y, z) in enumerate(ticks):
            for number, (px, py, pz, ax, ay, az) in enumerate(rows[index + 1 : index + window + 1], index + 1):
                if (x - px) * ax + (y - py) * ay + (z - pz) * az > 0:
                    index = number
                    yield tick, number

    def travelled_by(self, drive: Drive) -> Floats:
        """Return how far a drive has come along the route until each frame, in m, (n,)."""
        return np.asarray(self.travelled[self.reached(drive, WINDOW)])

    def reached(self, drive: Drive, window: int) -> Integers:
        """Return the index of the last point passed until each frame of a drive, (n,); see `passed`."""
        numbers = np.zeros(len(drive), np.int64)
        for tick, number in self.passed(drive.ticks, window):
            numbers[drive.frames[tick]] = number
        return np.maximum.accumulate(numbers)


def background(paths: Mapping[int, Trajectory], lives: Iterable[ActorLife]) -> list[Trajectory]:
    """Return the trajectories of the background vehicles among actors, of those that have poses."""
    found = (paths[life.id].of_life(life) for life in lives if life.role_name == BACKGROUND and life.id in paths)
    return [path for path in found if len(path)]


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

    The route has a length in m, and equal parts; the hero has travelled some m of it in each frame, (n,). The others are the
    background vehicles.
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
