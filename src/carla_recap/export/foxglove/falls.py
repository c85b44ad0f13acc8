"""Walkers that were knocked down, and marks on the ground where actors have collided."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.foxglove import shapes
from carla_recap.export.foxglove.bodies import TIMESTAMP, Fall
from carla_recap.export.foxglove.messages import ALL_DELETED, WORLD, MessagePart, SceneEntity, SceneUpdate, single
from carla_recap.model.records import ActorKind
from carla_recap.rendering.actors import MARKED, SceneActors
from carla_recap.rendering.models import INDEX, MODELS
from carla_recap.replay import Collided, right_handed
from carla_recap.replay.pose import LOCATION, rotations

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.export.foxglove.messages import Indices, Stamps, TopicMessages
    from carla_recap.rendering.instances import Instances
    from carla_recap.replay import Scene, SceneBatch

    Floats = NDArray[np.float64]

MARKS: Final = "/scene/marks"

_MARK: Final = 1.1  # m, the radius
_AGAIN: Final = 1.0  # s after which the marks of contacts that go on are written again
_ABOVE: Final = 0.02  # m
_WALKING: Final = 20.0  # cm/s; one that walks again has got up
_LYING: Final = 0.7  # the cosine of the angle to the upright


class CollisionMarks:
    """Marks on the ground where actors have collided, for some seconds."""

    def __init__(self) -> None:
        self._actors = SceneActors()
        self._pairs: set[frozenset[int]] = set()  # of actors that have collided in the latest scene with a message
        self._latest = -math.inf  # its elapsed seconds

    def messages(self, batch: SceneBatch, rows: Indices, stamps: Stamps) -> Iterator[TopicMessages]:
        """Yield a message with all marks if actors collide, at most once a second while the same ones do.

        Args:
            batch: The scenes; only the first one has events.
            rows: The positions of the scenes that are shown.
            stamps: The timestamp of each of these.
        """
        if batch.fresh and not rows[0]:
            self._pairs, self._latest = set(), -math.inf
            yield single(MARKS, 0, ALL_DELETED)
        pairs = {frozenset((event.actor1, event.actor2)) for event in batch.events if isinstance(event, Collided)}
        time = batch.time[0].item()
        if not pairs or rows[0] or (pairs <= self._pairs and time < self._latest + _AGAIN):
            return
        self._pairs, self._latest = pairs, time
        found = self._actors.at(batch.scene(0))
        marks = found.locations[found.models == INDEX["collision mark"]]
        if len(marks):
            data = b"".join(_mark(number, place, stamps[0]) for number, place in enumerate(marks))
            yield single(MARKS, 0, ALL_DELETED.SerializeToString() + data)


def _mark(number: int, place: Floats, stamp: Stamps) -> bytes:
    entity = SceneEntity(frame_id=WORLD, id=f"collision {number}")
    entity.lifetime.FromMilliseconds(round(1000 * (MARKED + _AGAIN)))
    model = MODELS[INDEX["collision mark"]].mesh
    vertices = model.vertices * (_MARK, _MARK, 0.0) + place + (0.0, 0.0, _ABOVE)
    placed = replace(model, vertices=vertices.astype(np.float32))
    shape = MessagePart(entity.SerializeToString() + shapes.mesh(placed)) + TIMESTAMP
    return shape.within(SceneUpdate.ENTITIES_FIELD_NUMBER).data[: -stamp.size] + stamp.tobytes()


class Falls:
    """The walkers that lie, from batch to batch."""

    def __init__(self) -> None:
        self._actors = SceneActors(marks=False)
        self._latest: SceneBatch | None = None
        self._falls: dict[int, Fall] = {}

    def of(self, batch: SceneBatch) -> dict[int, Fall]:
        """Return how walkers lie in the scenes of a batch, by their ids; each batch has to be given, in order."""
        if batch.fresh or any(id not in batch.actors for id in self._falls):
            self._falls = {} if batch.fresh else {id: fall for id, fall in self._falls.items() if id in batch.actors}
        collided = any(isinstance(event, Collided) for event in batch.events)
        before, self._latest = self._latest, batch
        if not self._falls and not collided:
            return {}
        scene = batch.scene(0)
        controls = scene.walker_controls
        for id in controls["id"][controls["speed"] > _WALKING].tolist():
            self._falls.pop(id, None)
        hit = {id for event in scene.collisions for id in (event.actor1, event.actor2)}
        walkers = [id for id in hit if id in batch.actors and batch.actors[id].kind == ActorKind.WALKER]
        if walkers and len(hit) > 1:
            if before is not None:
                self._actors.at(before.scene(len(before) - 1))  # from which velocities are known
            found = self._actors.at(scene)
            for id in walkers:
                fall = _fall(id, scene, found)
                if fall is not None and id not in self._falls:
                    self._falls[id] = fall
        return dict(self._falls)


def _fall(id: int, scene: Scene, found: Instances) -> Fall | None:
    """Return how an instance lies whose recorded pose is upright; None if it stands."""
    pose, row = scene.pose_of(id), int(np.searchsorted(found.ids, id))
    if pose is None or row >= len(found) or found.ids[row] != id:
        return None
    recorded = right_handed(pose)
    turned = rotations(recorded[None])[0]
    shown = found.rotations[row].astype(np.float64)
    if not (shown[2, 2] < _LYING < turned[2, 2]):
        return None
    rotation = turned.T @ shown
    x, y, z = (turned.T @ (found.locations[row] - recorded[LOCATION])).round(4).tolist()
    return Fall(tuple(rotation.round(4).ravel().tolist()), (x, y, z))
