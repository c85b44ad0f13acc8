"""The motion of actors in scenes, by the one rule of `carla_recap.model.motion`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.motion import LONGEST_STEP, motion_of
from carla_recap.replay.events import Destroyed, Spawned
from carla_recap.replay.pose import LOCATION, right_handed, right_handed_velocities
from carla_recap.replay.selection import NO_IDS, array, find, latest, numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay.scene import SceneBatch
    from carla_recap.util.arrays import Booleans, Floats, Ids


class SceneMotion:
    """Finds how actors move in scenes that come in order, from batch to batch.

    What is behind a scene counts as far as the next frame: in a running simulation, the scenes before count alone. An actor
    that is where it was last, since a frame has no pose of it, has its last velocity for up to 1 s.

    Attributes:
        accelerations: The changes of the velocities since the scene before in m/s², (scenes, ids, 3), of the latest batch;
            NaN where they are unknown.
    """

    def __init__(self) -> None:
        self._ids: Ids = NO_IDS  # of the actors whose latest scene is known:
        self._time = np.zeros(0)  # its time, and in it the places, and the velocities as recorded and as found
        self._places = self._recorded = self._velocities = np.zeros((0, 3))
        self.accelerations: Floats = np.zeros((0, 0, 3))

    def velocities(self, batch: SceneBatch, ids: Ids | None = None, poses: Floats | None = None) -> Floats:
        """Return the velocities in m/s, right-handed, (scenes, ids, 3); NaN where they are unknown.

        Args:
            batch: The next scenes.
            ids: The actors, ascending, which may be others in each batch; None: those of the batch.
            poses: Their poses in cm and degrees, left-handed, (scenes, ids, 6); None: those of the batch.
        """
        ids, poses = batch.ids if ids is None else ids, batch.poses if poses is None else poses
        there = np.isin(ids, batch.ids[~batch.held])
        if not there.all():
            carried = [id for id, actor in batch.actors.items() if actor.attached and batch.index_of(id) is None]
            there |= np.isin(ids, carried)  # without poses of their own
        if not there.all():
            velocities, accelerations = np.full((2, len(batch), len(ids), 3), np.nan)
            velocities[:, there] = self.velocities(batch, ids[there], poses[:, there])
            accelerations[:, there], self.accelerations = self.accelerations, accelerations
            where, known = find(ids, self._ids)  # of an actor of which the frames have no pose, those of before are held
            absent, where = np.flatnonzero(known & ~there), where[known & ~there]
            recent = batch.time[:, None] - self._time[where] <= LONGEST_STEP
            velocities[:, absent] = np.where(recent[..., None], self._velocities[where], np.nan)
            return np.asarray(velocities)
        rows = len(batch) + 2  # with the scene before, and the frame behind
        time, before = np.full((rows, len(ids)), np.nan), np.full((len(ids), 3), np.nan)
        places, recorded = np.full((2, rows, len(ids), 3), np.nan)
        behind, motion = recorded_motion(batch, ids)
        places[1:], recorded[1:], time[1:] = motion[..., :3], motion[..., 3:], behind[:, None]
        time[1:-1], places[1:-1] = batch.time[:, None], right_handed(poses)[..., LOCATION]
        changed = [event.id for event in batch.events if isinstance(event, Destroyed)]
        changed += [event.actor.id for event in batch.events if isinstance(event, Spawned)]
        self._keep(~np.isin(self._ids, changed) & (batch.time[0] - self._time <= LONGEST_STEP) & (not batch.fresh))
        where, known = find(ids, self._ids)
        those = where[known]
        time[0, known], places[0, known], recorded[0, known] = self._time[those], self._places[those], self._recorded[those]
        before[known] = self._velocities[those]
        # One actor after the other:
        path, known_velocity = (values.transpose(2, 1, 0).reshape(3, -1) for values in (places, recorded))
        with np.errstate(invalid="ignore", over="ignore"):
            found, joined = motion_of(time.T.ravel(), path, known_velocity, np.repeat(np.arange(len(ids)), rows))
            found = found.reshape(3, len(ids), rows).transpose(2, 1, 0)[1:-1]
            follows = np.append(joined, False)[: time.size].reshape(len(ids), rows).T[: len(batch), :, None]
            changes = np.diff(found, axis=0, prepend=before[None]) / np.diff(time[:-1], axis=0)[..., None]
            self.accelerations = np.where(follows, changes, np.nan)
        self._keep(~np.isin(self._ids, ids))
        order = np.argsort(every := np.concatenate((self._ids, ids)))
        self._ids = every[order]
        self._time, self._places, self._recorded, self._velocities = (
            np.concatenate(parts)[order]
            for parts in (
                (self._time, time[-2]),
                (self._places, places[-2]),
                (self._recorded, recorded[-2]),
                (self._velocities, found[-1]),
            )
        )
        return found

    def _keep(self, kept: Booleans) -> None:
        """Forget the other actors."""
        if not kept.all():
            self._ids, self._time, self._places = self._ids[kept], self._time[kept], self._places[kept]
            self._recorded, self._velocities = self._recorded[kept], self._velocities[kept]


def recorded_motion(batch: SceneBatch, ids: Ids) -> tuple[Floats, Floats]:
    """Return the motion of actors, whose ids ascend, in the frames of scenes and the one behind; NaN where it is unknown.

    Returns:
        The elapsed seconds of the frames, (scenes + 1,), and the places in m and recorded velocities in m/s, right-handed,
        (scenes + 1, ids, 6).
    """
    time, motion = np.append(batch.frames.elapsed, np.nan), np.full((len(batch) + 1, len(ids), 6), np.nan)

    def add(rows: slice | int, transforms: NDArray[np.void], velocities: NDArray[np.void]) -> None:
        motion[rows, :, :3] = right_handed(numbers_of(ids, transforms))[..., LOCATION]
        motion[rows, :, 3:] = right_handed_velocities(numbers_of(ids, velocities))[..., LOCATION]

    add(slice(-1), batch.records("transforms"), batch.records("velocities"))
    if (frame := batch.following) is not None:
        time[-1] = frame.elapsed
        add(-1, latest(array(frame["transforms"])), latest(array(frame["velocities"])))
        changed = [actor.id for actor in frame["spawned"]] + array(frame["destroyed"])["id"].tolist()
        motion[-1, np.isin(ids, changed)] = np.nan
    return time, motion


def numbers_of(ids: Ids, records: NDArray[np.void]) -> Floats:
    """Return the numbers of the records of actors, (..., ids, 6), in records that ascend by id; NaN without one."""
    values = np.full((*records.shape[:-1], len(ids), 6), np.nan)
    if records.size:
        where, known = find(ids, records["id"] if records.ndim == 1 else records["id"][0])
        with np.errstate(invalid="ignore"):  # a signaling NaN
            values[..., known, :] = numbers(records)[..., where[known], :]
    return values
