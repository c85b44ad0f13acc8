"""Walkers who lie on the ground after a vehicle has knocked them down, although their recorded poses are upright."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export.rerun import paths
from carla_recap.model.records import ActorKind
from carla_recap.rendering.looks import look_of_present
from carla_recap.replay import Collided, right_handed
from carla_recap.replay.pose import LOCATION, ROTATION, rotations
from carla_recap.replay.selection import find

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream, TimeColumns, TimePoint
    from carla_recap.replay import SceneBatch

    Floats = NDArray[np.float64]

_KNOCKED: Final = 1.5  # m/s: from this speed on, a vehicle knocks a walker down
_UPRIGHT: Final = 45.0  # degrees; one that leans more lies already
_WALKING: Final = 20.0  # cm/s; one that walks again has got up


class FallenWriter:
    """Lays down the models of walkers; the transforms of their entities stay those that are recorded.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._fallen: set[int] = set()
        self._before: SceneBatch | None = None

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        for event in batch.events:
            if isinstance(event, Collided):
                self._collide(event, batch, times.point(0))
        if self._fallen:
            self._raise(batch, times)
        self._before = batch

    def _collide(self, contact: Collided, batch: SceneBatch, time: TimePoint) -> None:
        pair = contact.actor1, contact.actor2
        kinds = [batch.actors[id].kind if id in batch.actors else None for id in pair]
        if set(kinds) != {ActorKind.VEHICLE, ActorKind.WALKER}:
            return
        vehicle, walker = pair if kinds[0] == ActorKind.VEHICLE else pair[::-1]
        pose = batch.pose_of(walker, 0)
        look = look_of_present(batch.actors[walker])
        velocity = self._velocity(vehicle, batch)
        speed = float(np.hypot(*velocity))
        if walker in self._fallen or pose is None or look is None or not speed > _KNOCKED or not np.isfinite(pose).all():
            return
        if np.abs(pose[ROTATION][:2]).max() > _UPRIGHT:
            return
        self._fallen.add(walker)
        upright = rotations(right_handed(pose))
        direction = np.array((*velocity / speed, 0.0))
        head = np.array((0.0, 0.0, 1.0 if upright[:, 0] @ direction <= 0 else -1.0))  # it falls on its back, or on its face
        lying = np.column_stack((head, np.cross(direction, head), direction))
        turned = upright.T @ lying
        down = np.array((0, 0, look.half_extents[0] - look.half_extents[2]))
        center = np.array(look.center)
        self._stream.log(
            paths.actor(walker),
            time,
            rr.InstancePoses3D(translations=[upright.T @ down + center - turned @ center], mat3x3=[turned]),
        )

    def _velocity(self, id: int, batch: SceneBatch) -> Floats:
        """Return the velocity of an actor over the ground in m/s, right-handed: as recorded, else that of its last step."""
        rows = batch.records("velocities")[0]
        index, known = find(np.array([id], np.uint32), rows["id"])
        if known[0]:
            return np.array((rows["x"][index[0]], -rows["y"][index[0]]), np.float64)
        before, pose = self._before, batch.pose_of(id, 0)
        if before is not None and pose is not None and (seconds := float(batch.time[0] - before.time[-1])) > 0:
            last = before.pose_of(id, len(before) - 1)
            if last is not None:
                return np.asarray(right_handed(pose - last)[LOCATION][:2] / seconds)
        return np.zeros(2)

    def _raise(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Raise the walkers that walk again, and forget those that have disappeared."""
        controls = batch.records("walker_controls")
        for id in list(self._fallen):
            index, known = find(np.array([id], np.uint32), controls["id"][0])
            speeds = controls["speed"][:, index[0]] if known[0] else np.zeros(0)
            walks = np.flatnonzero(speeds > _WALKING)
            if id not in batch.actors:
                self._fallen.remove(id)
            elif len(walks):
                self._fallen.remove(id)
                standing = rr.InstancePoses3D(translations=[(0, 0, 0)], mat3x3=[np.eye(3)])
                self._stream.log(paths.actor(id), times.point(int(walks[0])), standing)
