"""The actors of a scene as instances of models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.replay.selection import index_in
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.instances import Instances
from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.scene.materials import MATERIALS, Color, Material, Tag
from carla_recap.scene.models import INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.replay import Scene
    from carla_recap.replay.player import Player
    from carla_recap.scene.description import LookColumns, SceneDescription
    from carla_recap.scene.falls import Fall, RecordedContacts
    from carla_recap.util.arrays import Floats


_MARK_IDS: Final = 0xFFFF_0000  # ids from here on are those of marks
_MARK_COLOR: Final[Color] = MATERIALS[Material.COLLISION_MARK].color


def instances(
    actors: LookColumns, poses: Floats, lamps: NDArray[np.uint64] | None = None, steering: Floats | None = None
) -> Instances:
    """Return instances of actors that are drawn.

    Args:
        actors: The actors.
        poses: Their poses in m and degrees, right-handed, (actors, 6).
        lamps: Their lit lamps: a bit `1 << material` for each, (actors,); None: all are off.
        steering: The angles of their front wheels in radians, positive to the left, (actors,); None: all are straight.
    """
    turned = rotations(poses)
    count = len(actors.ids)
    return Instances(
        actors.ids,
        actors.models,
        poses[:, LOCATION] + (turned @ actors.centers[..., None])[..., 0],
        turned.astype(np.float32),
        actors.half_extents,
        actors.colors,
        np.zeros(count, np.uint64) if lamps is None else lamps,
        np.zeros(count, np.float32) if steering is None else steering.astype(np.float32),
        np.ones(count, np.float32),
        actors.tags,
    )


def described_instances(description: SceneDescription, row: int = 0, *, marks: bool = True) -> Instances:
    """Return the instances of one of the scenes of a description."""
    found = instances(description.actors, description.poses[row], description.lamps[row], description.steering[row])
    _lay(found, description.actors.centers, description.fallen_at(row))
    if not description.shown[row].all():
        found = found.take(description.shown[row])
    return _with_marks(found, description.marks_at(row)) if marks else found


class SceneActors:
    """Makes the instances of the scenes of a replay, one after the other.

    Args:
        marks: Whether collisions are marked on the ground for some seconds.
        signs: Whether signs are drawn; those of a map are part of its `TownMesh`.
    """

    def __init__(self, *, marks: bool = True, signs: bool = False) -> None:
        self._marks = marks
        self._describer = SceneDescriber(signs=signs)

    def at(self, scene: Scene) -> Instances:
        """Return the instances of a scene."""
        batch = scene.batch if len(scene.batch) == 1 else scene.batch[scene.row : scene.row + 1]
        return described_instances(self._describer.describe(batch), marks=self._marks)

    def recall(self, player: Player, contacts: RecordedContacts | None = None) -> None:
        """Learn what of the time before a player's start is still to be seen then; see `SceneDescriber.recall`."""
        self._describer.recall(player, contacts)


def _lay(found: Instances, centers: Floats, fallen: Mapping[int, Fall]) -> None:
    """Lay down the walkers that were knocked down."""
    for id, fall in fallen.items():
        row = index_in(found.ids, id)
        if row is not None:
            upright = found.rotations[row].astype(np.float64)
            found.rotations[row] = upright @ fall.matrix
            found.locations[row] += upright @ (fall.offset - centers[row])


def _with_marks(found: Instances, locations: Floats) -> Instances:
    if not len(locations):
        return found
    count = len(locations)
    added = Instances(
        np.arange(_MARK_IDS, _MARK_IDS + count, dtype=np.uint32),
        np.full(count, INDEX["collision mark"], np.uint16),
        locations,
        np.broadcast_to(np.eye(3, dtype=np.float32), (count, 3, 3)),
        np.broadcast_to(np.array((MARK_RADIUS, MARK_RADIUS, 0.001), np.float32), (count, 3)),
        np.broadcast_to(np.array(_MARK_COLOR, np.uint8), (count, 3)),
        np.zeros(count, np.uint64),
        np.zeros(count, np.float32),
        np.ones(count, np.float32),
        np.full(count, Tag.ROADS, np.uint8),
    )
    columns = zip(vars(found).values(), vars(added).values(), strict=True)
    return Instances(*(np.concatenate(pair) for pair in columns))
