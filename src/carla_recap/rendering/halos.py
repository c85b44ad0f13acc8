"""The light around lit lamps: where the lamps of a model are, and the discs of light that are added to an RGB image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.materials import LAMPS, MATERIALS, Material

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.buffers import ModelShape
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh

    Floats = NDArray[np.float64]

HALO: Final = np.dtype([("center", "4f4"), ("light", "3f4")])
"""A disc of light: its centre relative to the camera and its radius in m, and its colour, from 0 to 1."""
_RADIUS: Final = 2.6  # of the halo, in those of the lamp
_LEAST_ANGLE: Final = 0.0022  # the radius of the smallest halo, as a part of the distance
_REACH: Final = 400.0  # m
_CLOSED: Final = 0.1  # the length of the mean normal of a lamp below which it is a closed body
_IN_FRONT: Final = 0.12  # m, of the lamp


class Halos:
    """Makes the halos of the lit lamps of instances.

    Args:
        models: The models that instances refer to.
    """

    def __init__(self, models: Sequence[ModelShape]) -> None:
        self._lamps = [_lamps_of(model.mesh) for model in models]

    def around(self, seen: Instances, offsets: Floats, strength: float) -> NDArray[np.void]:
        """Return the halos.

        Args:
            seen: Instances.
            offsets: Their centres relative to the camera.
            strength: The brightness of the halos: 1 at night.
        """
        lit = np.flatnonzero((seen.lamps & LAMPS != 0) & ((offsets**2).sum(axis=1) < _REACH**2))
        parts = [
            self._of_model(model, seen, offsets, lit[seen.models[lit] == model]) for model in np.unique(seen.models[lit])
        ]
        found = np.concatenate([np.zeros(0, HALO), *parts])
        found["light"] *= strength
        return found

    def _of_model(self, model: int, seen: Instances, offsets: Floats, rows: NDArray[np.intp]) -> NDArray[np.void]:
        materials, centers, normals, radii, colors = self._lamps[model]
        row, lamp = np.nonzero((seen.lamps[rows][:, None] >> materials[None]) & np.uint64(1))
        rows = rows[row]
        half = seen.half_extents[rows].astype(np.float64)
        turned = seen.rotations[rows].astype(np.float64)
        at = offsets[rows] + np.einsum("nij,nj->ni", turned, centers[lamp] * half)
        direction = np.einsum("nij,nj->ni", turned, normals[lamp] / np.maximum(half, 1e-3))
        distance = np.linalg.norm(at, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            facing = -np.einsum("ni,ni->n", direction, at) / (np.linalg.norm(direction, axis=1) * distance)
        found = np.zeros(len(rows), HALO)
        size = radii[lamp] * np.sqrt(half[:, 1] * half[:, 2])
        found["center"][:, :3] = at * np.maximum(1 - _IN_FRONT / np.maximum(distance, 1e-3), 0.0)[:, None]
        found["center"][:, 3] = np.maximum(_RADIUS * size, _LEAST_ANGLE * distance)
        found["light"] = colors[lamp] * np.clip(facing * 1.6, 0, 1)[:, None]
        shown: NDArray[np.void] = found[facing > 0]
        return shown


def _lamps_of(mesh: Mesh) -> tuple[NDArray[np.uint64], Floats, Floats, Floats, Floats]:
    """Return the lamps of a model: material, centre, direction, radius and colour; each side of a model has its own."""
    lamps = []
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    centers = corners.mean(axis=1)
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crossed, axis=1) / 2 + 1e-12
    materials = mesh.materials[mesh.triangles[:, 0]] if len(mesh.triangles) else np.zeros(0, np.uint8)
    sides = np.round(centers[:, 1] * 2).clip(-1, 1)  # the middle, or a side
    for material in np.unique(materials):
        glow = MATERIALS[Material(material)].glow
        if glow is None:
            continue
        for side in np.unique(sides[materials == material]):
            part = (materials == material) & (sides == side)
            weights = areas[part] / areas[part].sum()
            normal = weights @ mesh.normals[mesh.triangles[part, 0]]
            if np.linalg.norm(normal) < _CLOSED:  # its light goes out of the nearer end of the model
                normal = np.array((np.sign(weights @ centers[part, 0]), 0.0, 0.0))
            points = corners[part].reshape(-1, 3)
            radius = 0.5 * np.ptp(points[:, 1:], axis=0).max()
            lamps.append((material, weights @ centers[part], normal, radius, np.array(glow) / 255))
    columns = zip(*lamps, strict=True) if lamps else ((),) * 5
    material, center, normal, radius, color = (np.array(column, np.float64) for column in columns)
    return material.astype(np.uint64), center.reshape(-1, 3), normal.reshape(-1, 3), radius, color.reshape(-1, 3)
