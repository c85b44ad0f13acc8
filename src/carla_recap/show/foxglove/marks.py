"""Marks on the ground where actors have collided."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.scene.models import INDEX, MODELS
from carla_recap.show.foxglove import shapes
from carla_recap.show.foxglove.bodies import TIMESTAMP
from carla_recap.show.foxglove.messages import ALL_DELETED, WORLD, MessagePart, SceneEntity, SceneUpdate, single

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.scene.description import SceneDescription
    from carla_recap.show.foxglove.messages import Stamps, TopicMessages

    Floats = NDArray[np.float64]

MARKS: Final = "/scene/marks"

_ABOVE: Final = 0.02  # m; of a drawn mark above its location


def mark_messages(description: SceneDescription, stamps: Stamps) -> Iterator[TopicMessages]:
    """Yield the messages of the marks: each has all of them, whenever one appears or disappears.

    Args:
        description: The scenes.
        stamps: The timestamp of each.
    """
    changes = description.marks
    if description.batch.fresh and not (changes and changes[0][0] == 0):
        changes = [(0, description.marked), *changes]
    for row, locations in changes:
        data = b"".join(_mark(number, location, stamps[row]) for number, location in enumerate(locations))
        yield single(MARKS, row, ALL_DELETED.SerializeToString() + data)


def _mark(number: int, location: Floats, stamp: Stamps) -> bytes:
    entity = SceneEntity(frame_id=WORLD, id=f"collision {number}")
    model = MODELS[INDEX["collision mark"]].mesh
    vertices = model.vertices * (MARK_RADIUS, MARK_RADIUS, 0.0) + location + (0.0, 0.0, _ABOVE)
    placed = replace(model, vertices=vertices.astype(np.float32))
    shape = MessagePart(entity.SerializeToString() + shapes.mesh(placed)) + TIMESTAMP
    return shape.within(SceneUpdate.ENTITIES_FIELD_NUMBER).data[: -stamp.size] + stamp.tobytes()
