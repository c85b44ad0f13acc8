"""Meshes as Rerun's archetypes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.rendering.mesh import Mesh


def mesh3d(mesh: Mesh, colors: NDArray[np.uint8], *, opacity: float = 1.0) -> rr.Mesh3D:
    """Return a mesh in the colours of its vertices, (vertices, 3)."""
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        vertex_normals=mesh.normals,
        vertex_colors=packed(colors),
        triangle_indices=mesh.triangles,
        albedo_factor=None if opacity >= 1 else faded(opacity),
    )


def packed(colors: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return opaque colours, (n, 3), as Rerun stores them, (n,)."""
    red, green, blue = colors.astype(np.uint32).T
    return np.asarray(red << 24 | green << 16 | blue << 8 | 255, np.uint32)


def faded(opacity: float) -> tuple[int, int, int, int]:
    """Return the factor of colours that makes a mesh see-through."""
    return 255, 255, 255, round(255 * opacity)
