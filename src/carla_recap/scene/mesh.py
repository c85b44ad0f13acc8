"""Triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from carla_recap.scene.materials import MATERIALS, Color, Material, palette

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a material for each vertex.

    Corners where the material or the direction of the surface changes are separate vertices, so that a surface is shaded by
    its normals alone. Seen from outside, the corners of a triangle run counterclockwise.
    """

    vertices: Floats  # the points, in m, (vertices, 3)
    normals: Floats  # the directions away from the surface, of length 1, (vertices, 3)
    materials: NDArray[np.uint8]  # the `Material` of each vertex, (vertices,); all corners of a triangle have the same
    triangles: NDArray[np.uint32]  # the indices of the corners, (triangles, 3)
    # red, green and blue of each vertex, (vertices, 3); None: those of the materials
    colors: NDArray[np.uint8] | None = None

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
            None if all(mesh.colors is None for mesh in meshes) else np.concatenate([mesh.painted() for mesh in meshes]),
        )

    def part(self, triangles: NDArray[np.uint32]) -> Mesh:
        """Return a mesh of some of the triangles, with their vertices alone."""
        used, corners = np.unique(triangles, return_inverse=True)
        return Mesh(
            self.vertices[used],
            self.normals[used],
            self.materials[used],
            corners.reshape(-1, 3).astype(np.uint32),
            None if self.colors is None else self.colors[used],
        )

    def painted(self, paint: Color = MATERIALS[Material.PAINT].color) -> NDArray[np.uint8]:
        """Return the colour of each vertex, all lamps off, (vertices, 3)."""
        colors = palette()[self.materials] if self.colors is None else self.colors.copy()
        colors[self.materials == Material.PAINT] = paint
        return colors
