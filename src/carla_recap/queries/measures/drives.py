"""How an actor drives, and along which points of a route."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.presence import FAR
from carla_recap.roads.polylines import stations

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.model.lives import ActorLife
    from carla_recap.tables.trajectories import Trajectory
    from carla_recap.util.arrays import Floats, Indices, Integers

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

    @classmethod
    def of(cls, actor: ActorLife, path: Trajectory) -> Drive:
        """Return the motion of an actor, without frames in which its pose is no number, or is too far away."""
        place = np.stack((path.x, path.y, path.z), axis=1)
        kept = (np.abs(place) < FAR).all(axis=1) & np.isfinite(path.yaw)
        velocity = np.stack((path.vx, path.vy), axis=1)
        return cls(actor, path.time[kept], place[kept], np.radians(path.yaw[kept]), ground_speed(path)[kept], velocity[kept])

    def __len__(self) -> int:
        return len(self.time)

    def during(self, start: float, stop: float) -> Drive:
        """Return the frames from a time on and before another one, in elapsed seconds."""
        rows = np.flatnonzero((self.time > start - SAME_TIME) & (self.time < stop - SAME_TIME))
        return self.part(rows[0], rows[-1]) if len(rows) else self.part(0, -1)

    def part(self, first: int, last: int) -> Drive:
        """Return some of the frames, both ends included."""
        rows = slice(first, last + 1)
        values = (self.time, self.position, self.yaw, self.speed, self.velocity)
        return Drive(self.actor, *(each[rows] for each in values))

    @property
    def length(self) -> float:
        """The distance driven in m."""
        return float(stations(self.position)[-1])

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
    junction: float | None = (
        None  # the share of the points in % to a bit behind the first one in a junction, if there is one
    )

    @classmethod
    def of_drive(cls, drive: Drive) -> PlannedRoute:
        """Return the driven path of an actor as a route."""
        travelled = stations(drive.position[:, :2])
        count = int(travelled[-1] / _SPACING)
        rows = np.unique(np.searchsorted(travelled, np.arange(count + 1) * _SPACING))
        yaw = drive.yaw[rows]
        return cls(drive.position[rows], np.stack((np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))), axis=1))

    @cached_property
    def travelled(self) -> Floats:
        """The distance of each point from the first one along the route, (n,)."""
        return stations(self.points)

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
