"""Triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a material for each vertex.

    Corners where the material or the direction of the surface changes are separate vertices, so that a surface is shaded by
    its normals alone. Seen from outside, the corners of a triangle run counterclockwise.

    Attributes:
        vertices: The points, in m, (vertices, 3).
        normals: The directions away from the surface, of length 1, (vertices, 3).
        materials: The `Material` of each vertex, (vertices,); all corners of a triangle have the same.
        triangles: The indices of the corners, (triangles, 3).
    """

    vertices: Floats
    normals: Floats
    materials: NDArray[np.uint8]
    triangles: NDArray[np.uint32]

    @classmethod
    def empty(cls) -> Self:
        """Return a mesh without triangles."""
        nothing = np.zeros((0, 3), np.float32)
        return cls(nothing, nothing, np.zeros(0, np.uint8), np.zeros((0, 3), np.uint32))

    @classmethod
    def concatenate(cls, meshes: Sequence[Mesh]) -> Self:
        """Return a mesh of the triangles of several."""
        if not meshes:
            return cls.empty()
        offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
        return cls(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.normals for mesh in meshes]),
            np.concatenate([mesh.materials for mesh in meshes]),
            np.concatenate([mesh.triangles + np.uint32(offset) for mesh, offset in zip(meshes, offsets, strict=True)]),
        )
