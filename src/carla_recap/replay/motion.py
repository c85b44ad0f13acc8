"""The motion of actors in scenes, by the one rule of `carla_recap.model.motion`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.motion import steps_joined, velocities
from carla_recap.replay.events import Destroyed, Spawned
from carla_recap.replay.pose import LOCATION, right_handed, right_handed_velocities
from carla_recap.replay.selection import NO_IDS, array, find, latest, numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay.scene import SceneBatch
    from carla_recap.util.arrays import Floats, Ids


class SceneMotion:
    """Finds how actors move in scenes that come in order, from batch to batch.

    The frame behind a scene counts as far as it is known: in a running simulation, the one before counts alone.

    Attributes:
        accelerations: The changes of the velocities since the scene before in m/s², (scenes, ids, 3), of the latest batch;
            NaN where they are unknown.
    """

    def __init__(self) -> None:
        self._ids: Ids = NO_IDS
        self._time = np.nan  # of the latest scene, of which the places, and the velocities as recorded and as found are:
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
        rows = len(batch) + 2  # with the scene before, and the frame behind
        time, nothing = np.full(rows, np.nan), np.full((rows, len(ids), 3), np.nan)
        places, recorded, before = nothing.copy(), nothing.copy(), nothing[0]
        time[1:-1], places[1:-1] = batch.time, right_handed(poses)[..., LOCATION]
        recorded[1:-1] = right_handed_velocities(_numbers_of(ids, batch.records("velocities")))[..., LOCATION]
        if not batch.fresh:
            changed = [event.id for event in batch.events if isinstance(event, Destroyed)]
            changed += [event.actor.id for event in batch.events if isinstance(event, Spawned)]
            where, known = find(ids, self._ids)
            known &= ~np.isin(ids, changed)
            time[0], those = self._time, where[known]
            places[0, known], recorded[0, known] = self._places[those], self._recorded[those]
            before[known] = self._velocities[those]
        if (frame := batch.following) is not None:
            time[-1] = frame.elapsed
            places[-1] = right_handed(_numbers_of(ids, latest(array(frame["transforms"]))))[:, LOCATION]
            recorded[-1] = right_handed_velocities(_numbers_of(ids, latest(array(frame["velocities"]))))[:, LOCATION]
            changed = [actor.id for actor in frame["spawned"]] + array(frame["destroyed"])["id"].tolist()
            places[-1, np.isin(ids, changed)] = np.nan
        # One actor after the other:
        path, known_velocity = (values.transpose(2, 1, 0).reshape(3, -1) for values in (places, recorded))
        times, actor = np.tile(time, len(ids)), np.repeat(np.arange(len(ids)), rows)
        with np.errstate(invalid="ignore", over="ignore"):
            joined = steps_joined(times, path, np.sqrt((known_velocity**2).sum(axis=0)), actor)
            found = velocities(times, path, known_velocity, joined).reshape(3, len(ids), rows).transpose(2, 1, 0)[1:-1]
            follows = np.append(joined, False)[: len(times)].reshape(len(ids), rows).T[: len(batch), :, None]
            changes = np.diff(found, axis=0, prepend=before[None]) / np.diff(time[:-1])[:, None, None]
            self.accelerations = np.where(follows, changes, np.nan)
        self._ids, self._time = ids, time[-2]
        self._places, self._recorded, self._velocities = places[-2], recorded[-2], found[-1]
        return found


def _numbers_of(ids: Ids, records: NDArray[np.void]) -> Floats:
    """Return the numbers of the records of actors, (..., ids, 6), in records that ascend by id; NaN without one."""
    values = np.full((*records.shape[:-1], len(ids), 6), np.nan)
    if records.size:
        where, known = find(ids, records["id"] if records.ndim == 1 else records["id"][0])
        with np.errstate(invalid="ignore"):  # a signaling NaN
            values[..., known, :] = numbers(records)[..., where[known], :]
    return values
