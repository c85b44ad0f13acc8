"""The motion of the carrier of a rig; axes are right-handed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP, MOTION, counts, motion_of, neighbours, rates
from carla_recap.replay.pose import LOCATION, angular_velocities, right_handed, right_handed_velocities
from carla_recap.replay.selection import numbers
from carla_recap.tables.trajectories import actor_rows, life_numbers, spawn_times

if TYPE_CHECKING:
    from carla_recap.recording import Recording
    from carla_recap.util.arrays import Floats


class Motion(NamedTuple):
    """How an actor moves at a moment, in the axes of the world."""

    velocity: Floats  # the velocity in m/s, (3,)
    acceleration: Floats  # the acceleration in m/s², (3,)
    rotation: Floats  # the angular velocity in degrees/s, (3,)
    angular_acceleration: Floats  # its change in degrees/s², (3,)


_REST = Motion(*np.zeros((4, 3)))


class CarrierMotion:
    """The motion of an actor, by the rule of `carla_recap.model.motion`; what is unknown counts as 0.

    Where no velocities are recorded, an acceleration is the change from the step to a frame to the step from it. It is known
    between two moments, in elapsed seconds.
    """

    def __init__(self, recording: Recording, id: int, start: float = -math.inf, stop: float = math.inf) -> None:
        begin, end = start - LONGEST_STEP, stop + LONGEST_STEP
        found = actor_rows(recording.reader, MOTION, {id}, start=begin, stop=end)
        rows, recorded = found["transforms"].get(id), found["velocities"].get(id)
        self._time = np.zeros(0)
        if rows is None:
            return
        with np.errstate(invalid="ignore"):  # a signaling NaN
            poses = right_handed(numbers(rows.records).astype(np.float64))
        known = np.isfinite(poses).all(axis=1)
        poses, self._time, frame = poses[known], rows.time[known], rows.frame[known]
        if not len(frame):
            return
        motion = np.full(poses.shape, np.nan)  # recorded: linear, angular
        if recorded is not None:
            _, own, those = np.intersect1d(frame, recorded.frame, assume_unique=True, return_indices=True)
            with np.errstate(invalid="ignore"):
                motion[own] = right_handed_velocities(numbers(recorded.records)[those].astype(np.float64))
        time, places, (linear, angular) = self._time, poses[:, LOCATION].T, np.split(motion.T, 2)
        spawned = spawn_times(recording.reader, begin, end).get(id, [])
        velocity, joined = motion_of(time, places, linear, life_numbers(time, spawned))
        self._joined, (before, after) = joined, neighbours(joined)
        with np.errstate(invalid="ignore", divide="ignore"):
            turning = angular_velocities(time, poses, joined).T
            seconds = np.where(joined, np.diff(time), np.nan)
            acceleration = np.full(places.shape, np.nan)
            acceleration[:, 1:-1] = np.diff(np.diff(places) / seconds) / (seconds[1:] + seconds[:-1]) * 2
        known = counts(linear)
        acceleration = np.where(known[before] & known[after], rates(time, velocity, joined), acceleration)
        turning = np.where(np.isfinite(angular).all(axis=0), angular, turning)
        changes = np.stack((acceleration, rates(time, turning, joined)))
        for beside in (before, after):  # beside a jump and at an end, they are those of the next frame
            changes = np.where(np.isnan(changes), changes[..., beside], changes)
        self._motion = np.nan_to_num(np.stack((velocity, changes[0], turning, changes[1])).transpose(0, 2, 1))

    def at(self, time: float) -> Motion:
        """Return the motion at elapsed seconds; an actor without poses is at rest."""
        if not len(self._time):
            return _REST
        row = max(int(np.searchsorted(self._time, time + SAME_TIME, side="right")) - 1, 0)
        found, after = self._motion[:, row], row + 1
        if after < len(self._time) and self._joined[row] and time > self._time[row] + SAME_TIME:
            part = (time - self._time[row]) / (self._time[after] - self._time[row])
            found = (1 - part) * found + part * self._motion[:, after]
        return Motion(*found)
