"""Collecting triangles of many surfaces, and cutting them in tiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.heights import TriangleGrid
from carla_recap.scene.mesh import Mesh

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from carla_recap.scene.materials import Material

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

TILE: Final = 50.0
"""The side of a tile, in m."""

UP: Final = np.array((0.0, 0.0, 1.0))
_LEAST_AREA: Final = 1e-4  # square metres; smaller triangles are left out
_MOST_TILES: Final = 1 << 20


class MeshBuilder:
    """Collects triangles."""

    def __init__(self) -> None:
        self._vertices: list[Floats] = []
        self._normals: list[Floats] = []
        self._materials: list[NDArray[np.uint8]] = []
        self._triangles: list[Integers] = []
        self._count = 0

    def add(self, vertices: Floats, normals: Floats, triangles: Integers, material: Material) -> None:
        """Add triangles of one material; those without an area, or that are not finite, are left out later.

        Args:
            vertices: The points, (n, 3).
            normals: The normals, (n, 3) or (3,).
            triangles: The indices of the corners, (m, 3).
            material: The material.
        """
        if not len(triangles):
            return
        self._vertices.append(vertices)
        self._normals.append(np.broadcast_to(normals, vertices.shape))
        self._materials.append(np.full(len(vertices), material, np.uint8))
        self._triangles.append(triangles + self._count)
        self._count += len(vertices)

    def add_strip(self, left: Floats, right: Floats, normals: Floats, material: Material, wanted: NDArray[np.bool_]) -> None:
        """Add the surface between two lines of points, as seen in their direction; seen from above if left is left.

        Args:
            left: The points of one line, (n, 3).
            right: Those of the other.
            normals: The normals at the points, (n, 3) or (3,).
            material: The material.
            wanted: Which parts between two successive points, (n - 1,).
        """
        n = len(left)
        first = np.flatnonzero(wanted)
        triangles = np.concatenate(
            (np.stack((first + n, first + n + 1, first + 1), 1), np.stack((first + n, first + 1, first), 1))
        )
        both = np.broadcast_to(normals, left.shape)
        self.add(np.concatenate((left, right)), np.concatenate((both, both)), triangles, material)

    def add_quads(self, corners: Floats, normals: Floats, material: Material) -> None:
        """Add quadrangles.

        Args:
            corners: The corners, counterclockwise as seen from outside, (n, 4, 3).
            normals: The normals, (n, 3) or (3,).
            material: The material.
        """
        n = len(corners)
        first = 4 * np.arange(n)[:, None]
        triangles = np.concatenate((first + np.array((0, 1, 2)), first + np.array((0, 2, 3))))
        of_corners = np.broadcast_to(np.asarray(normals).reshape(-1, 1, 3), (n, 4, 3)).reshape(-1, 3)
        self.add(corners.reshape(-1, 3), of_corners, triangles, material)

    def add_polygon(self, corners: Floats, normal: Floats, material: Material) -> None:
        """Add a convex polygon, its corners counterclockwise as seen from outside, (n, 3)."""
        index = np.arange(1, len(corners) - 1)
        self.add(corners, normal, np.stack((np.zeros_like(index), index, index + 1), axis=1), material)

    def arrays(self) -> tuple[Floats, Floats, NDArray[np.uint8], Integers]:
        """Return vertices, normals, materials and triangles that have an area."""
        if not self._triangles:
            return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros((0, 3), np.int64)
        vertices, triangles = np.concatenate(self._vertices), np.concatenate(self._triangles)
        a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
        x, y, z = (b - a).T
        u, v, w = (c - a).T
        squares = (y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2
        triangles = triangles[squares > (2 * _LEAST_AREA) ** 2]
        return vertices, np.concatenate(self._normals), np.concatenate(self._materials), triangles

    def grid(self, materials: Collection[Material]) -> TriangleGrid:
        """Return the triangles of some materials so far, as surfaces."""
        vertices, _, of_vertices, triangles = self.arrays()
        return TriangleGrid(vertices, triangles[np.isin(of_vertices[triangles[:, 0]], list(materials))])

    def tiles(self) -> list[Mesh]:
        """Return the triangles by the tile in which their middle is; those of high numbers of materials first.

        Markings and lanes come before the grass below them, so that a renderer need not shade the grass there.
        """
        vertices, normals, materials, triangles = self.arrays()
        if not len(triangles):
            return []
        middles = vertices[triangles, :2].mean(axis=1)
        low = middles.min(axis=0)
        extent = float(np.ptp(middles, axis=0).max())
        cells = np.floor((middles - low) / max(TILE, extent / np.sqrt(_MOST_TILES))).astype(np.int64)
        tiles = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        order = np.lexsort((-materials[triangles[:, 0]].astype(np.int64), tiles))
        starts = np.flatnonzero(np.diff(tiles[order], prepend=-1))
        parts = []
        for part in np.split(triangles[order], starts[1:]):
            used, renumbered = np.unique(part, return_inverse=True)
            parts.append(
                Mesh(
                    vertices[used].astype(np.float32),
                    normals[used].astype(np.float32),
                    materials[used],
                    renumbered.reshape(-1, 3).astype(np.uint32),
                )
            )
        return parts
