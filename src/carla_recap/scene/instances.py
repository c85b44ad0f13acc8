"""What is drawn of the actors at a moment, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from carla_recap.util.arrays import Ids


@dataclass(frozen=True, eq=False)
class Instances:
    """Models of actors at a moment: where they are, and how they look.

    A model is a mesh that fills the box from -1 to 1 along each axis; an instance of it is scaled by half the size of the
    actor's box, turned, and moved to the centre of the box.
    """

    ids: Ids  # the ids of the actors, ascending, (n,) of uint32
    models: NDArray[np.uint16]  # the model of each: an index of `carla_recap.scene.models.MODELS`, (n,) of uint16
    locations: NDArray[np.float64]  # the centres of the boxes in m, right-handed, (n, 3) of float64
    rotations: NDArray[np.float32]  # matrices whose columns point forward, left and up, (n, 3, 3) of float32
    half_extents: NDArray[np.float32]  # half the sizes of the boxes in m, (n, 3) of float32
    colors: NDArray[np.uint8]  # the paint: red, green, blue, (n, 3) of uint8
    lamps: NDArray[np.uint64]  # the lit lamps: a bit `1 << material` for each lamp `Material` that is lit, (n,) of uint64
    steering: NDArray[np.float32]  # the angles of the front wheels in radians, positive to the left, (n,) of float32
    opacity: NDArray[np.float32]  # 1, or less for what is behind to be seen, (n,) of float32
    tags: NDArray[np.uint8]  # the semantic tags, (n,) of uint8

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Return some of the instances."""
        return type(self)(*(column[index] for column in vars(self).values()))
