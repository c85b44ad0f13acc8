"""The motion of the carrier of a rig, and the velocities of what is around it; axes are right-handed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP, possible_step
from carla_recap.replay.pose import LOCATION, right_handed, right_handed_velocities, rotations
from carla_recap.replay.selection import find, numbers
from carla_recap.tables.trajectories import actor_rows

if TYPE_CHECKING:
    from carla_recap.recording import Recording
    from carla_recap.replay import Scene
    from carla_recap.util.arrays import Floats


class Motion(NamedTuple):
    """How an actor moves at a moment, in the axes of the world.

    Attributes:
        velocity: The velocity in m/s, (3,).
        acceleration: The acceleration in m/s², (3,).
        rotation: The angular velocity in degrees/s, (3,).
    """

    velocity: Floats
    acceleration: Floats
    rotation: Floats


_REST = Motion(np.zeros(3), np.zeros(3), np.zeros(3))


class CarrierMotion:
    """The motion of an actor: as recorded, else by its poses; accelerations are the differences of velocities.

    Where the actor jumps, it has the motion of one side of the jump, and no acceleration.

    Args:
        recording: The recording.
        id: The actor.
        start: The elapsed seconds from which on it is known.
        stop: The elapsed seconds until which it is known.
    """

    def __init__(self, recording: Recording, id: int, start: float = -math.inf, stop: float = math.inf) -> None:
        begin, end = start - LONGEST_STEP, stop + LONGEST_STEP
        found = actor_rows(recording.reader, ("transforms", "velocities"), {id}, start=begin, stop=end)
        rows, recorded = found["transforms"].get(id), found["velocities"].get(id)
        self._time = np.zeros(0)
        if rows is None:
            return
        with np.errstate(invalid="ignore"):  # a signaling NaN
            poses = right_handed(numbers(rows.records).astype(np.float64))
        known = np.isfinite(poses).all(axis=1)
        poses, self._time, frame = poses[known], rows.time[known], rows.frame[known]
        motion = np.full(poses.shape, np.nan)  # linear, angular
        if recorded is not None:
            _, own, those = np.intersect1d(frame, recorded.frame, assume_unique=True, return_indices=True)
            with np.errstate(invalid="ignore"):
                motion[own] = right_handed_velocities(numbers(recorded.records)[those].astype(np.float64))
        speeds = np.sqrt((motion[:, :3] ** 2).sum(axis=1))
        seconds, steps = np.diff(self._time), np.diff(poses[:, LOCATION], axis=0)
        fastest = np.fmax(speeds[1:], speeds[:-1])
        self._joined = (seconds > 0) & (seconds <= LONGEST_STEP)
        self._joined &= np.sqrt((steps**2).sum(axis=1)) <= possible_step(seconds, fastest)
        seconds = np.where(self._joined, seconds, np.nan)[:, None]
        recorded_rows = np.isfinite(motion[:, :3]).all(axis=1)
        by_steps = np.concatenate((steps, _turns(rotations(poses))), axis=1) / seconds
        for part in (slice(0, 3), slice(3, 6)):
            for side in (slice(1, None), slice(None, -1)):  # by the step to the frame, else by that from it
                unknown = ~np.isfinite(motion[side, part]).all(axis=1)
                motion[side, part][unknown] = by_steps[unknown, part]
        motion = np.nan_to_num(motion)
        self._velocity, self._rotation = motion[:, :3], motion[:, 3:]
        self._acceleration = np.zeros_like(self._velocity)
        # The velocity by a step is that in its middle
        between = np.concatenate((seconds[:1], (seconds[1:] + seconds[:-1]) / 2))
        between = np.where((recorded_rows[1:] & recorded_rows[:-1])[:, None], seconds, between)
        self._acceleration[1:] = np.nan_to_num(np.diff(self._velocity, axis=0) / between)

    def at(self, time: float) -> Motion:
        """Return the motion at elapsed seconds; an actor without poses is at rest."""
        if not len(self._time):
            return _REST
        row = max(int(np.searchsorted(self._time, time + SAME_TIME, side="right")) - 1, 0)
        after = row + 1
        if after < len(self._time) and self._joined[row] and time > self._time[row] + SAME_TIME:
            part = (time - self._time[row]) / (self._time[after] - self._time[row])
            velocity, rotation = (
                (1 - part) * values[row] + part * values[after] for values in (self._velocity, self._rotation)
            )
            return Motion(velocity, self._acceleration[after], rotation)
        return Motion(self._velocity[row], self._acceleration[row], self._rotation[row])


def _turns(axes: Floats) -> Floats:
    """Return the rotations from each of some axes to the next ones as vectors in the world, (n - 1, 3) in degrees."""
    turn = axes[1:] @ np.swapaxes(axes[:-1], 1, 2)
    sine = np.stack(
        (turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]), axis=1
    )  # twice the sine of the angle, along the axis
    length = np.sqrt((sine**2).sum(axis=1))
    angle = np.arctan2(length, np.trace(turn, axis1=1, axis2=2) - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        vectors: Floats = np.degrees(sine * np.where(length > 0, angle / length, 0.5)[:, None])
    return vectors


def velocities_of(scene: Scene, before: Scene | None) -> Floats:
    """Return the velocities of the actors of a scene: as recorded, else by their steps since the scene before.

    Returns:
        The velocities in m/s, right-handed, (ids of the scene, 3); 0 where they are unknown.
    """
    found = np.full((len(scene.ids), 3), np.nan)
    if before is not None and 0 < (seconds := scene.time - before.time) <= LONGEST_STEP:
        where, known = find(scene.ids, before.ids)
        with np.errstate(invalid="ignore", over="ignore"):
            steps = right_handed(scene.poses[known] - before.poses[where[known]])[:, LOCATION]
            steps[~(np.sqrt((steps**2).sum(axis=1)) <= possible_step(seconds))] = np.nan
        found[known] = steps / seconds
    recorded = scene.velocities
    if len(recorded):
        where, known = find(scene.ids, recorded["id"])
        with np.errstate(invalid="ignore"):
            values = right_handed_velocities(numbers(recorded)[where[known]].astype(np.float64))[:, :3]
        values[~np.isfinite(values).all(axis=1)] = np.nan
        found[known] = np.where(np.isnan(values), found[known], values)
    velocities: Floats = np.nan_to_num(found, posinf=0.0, neginf=0.0)
    return velocities
