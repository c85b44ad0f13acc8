"""Meshes as Rerun's archetypes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.scene.materials import Color, Material
from carla_recap.scene.mesh import Mesh
from carla_recap.scene.models import MODELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.scene.appearance import Look

_SIDE: Final = 0.72  # of full daylight, on what faces sideways
_LIGHT: Final = np.array((-0.06, 0.09, 0.28), np.float32)  # and the increase towards the light
_CORNERS: Final = 24  # of a shadow
_ROUNDNESS: Final = 0.5  # the exponent: 1 is an ellipse, 0 a rectangle
_SHADOW: Final = 0.06  # m beyond the box
_NARROW: Final = 0.6  # m; half the width up to which a vehicle has two wheels
_SLENDER: Final = 0.6
_SHADOW_HEIGHT: Final = 0.025  # m above the ground
_SHADOW_COLOR: Final[Color] = (48, 49, 52)
_LIFT: Final = 0.012  # m; of lit lamps in front of unlit ones


def mesh3d(mesh: Mesh, colors: NDArray[np.uint8]) -> rr.Mesh3D:
    """Return a mesh in the colours of its vertices, (vertices, 3), by daylight.

    The light is part of the colours: the viewer's own leaves the rear of cars in the dark.
    """
    return unlit(mesh, _lit(colors, mesh.normals))


def _lit(colors: NDArray[np.uint8], normals: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return colours as they look from where they face."""
    share = np.clip(_SIDE + normals @ _LIGHT, 0, 1)[:, None]
    return np.asarray(colors * share).astype(np.uint8)


def packed(colors: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return opaque colours, (n, 3), as Rerun stores them, (n,)."""
    red, green, blue = colors.astype(np.uint32).T
    return np.asarray(red << 24 | green << 16 | blue << 8 | 255, np.uint32)


def faded(opacity: float) -> tuple[int, int, int, int]:
    """Return the factor of colours that makes a mesh see-through."""
    return 255, 255, 255, round(255 * opacity)


def model_mesh(look: Look) -> Mesh:
    """Return the model of an actor in its own axes, in the size of its box, in m."""
    mesh = MODELS[look.model].mesh
    half = np.array(look.half_extents, np.float32)
    normals = mesh.normals / half
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return replace(mesh, vertices=mesh.vertices * half + np.array(look.center, np.float32), normals=normals)


def drawn(look: Look, mesh: Mesh, *, with_shadow: bool = False) -> rr.Mesh3D:
    """Return the mesh of an actor, painted, all lamps off."""
    vertex_colors = _lit(mesh.painted(look.color), mesh.normals)
    if with_shadow:
        below = shadow(look)
        mesh = Mesh.concatenate([mesh, below])
        dark = np.full((len(below.vertices), 3), _SHADOW_COLOR, np.uint8)
        vertex_colors = np.concatenate((vertex_colors, dark))
    return unlit(mesh, vertex_colors)


def lamps_of(mesh: Mesh, material: Material) -> Mesh | None:
    """Return the lamps of a material, a little in front of where they are in the mesh; None if it has none."""
    chosen = mesh.triangles[mesh.materials[mesh.triangles[:, 0]] == material]
    if not len(chosen):
        return None
    lamps = mesh.part(chosen)
    return replace(lamps, vertices=lamps.vertices + _LIFT * lamps.normals)


def unlit(mesh: Mesh, colors: NDArray[np.uint8] | None = None) -> rr.Mesh3D:
    """Return a mesh that is as bright as its colours, in whatever light."""
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.triangles,
        vertex_colors=None if colors is None else packed(colors),
    )


def shadow(look: Look) -> Mesh:
    """Return the shadow below a vehicle, as a mesh of the material of tyres."""
    half = np.array(look.half_extents[:2])
    half[1] *= 1.0 if half[1] > _NARROW else _SLENDER  # two-wheelers are wide at the handlebar alone
    rounded = circle(_CORNERS)
    rounded = np.sign(rounded) * np.abs(rounded) ** _ROUNDNESS * (half + _SHADOW)
    low = look.center[2] - look.half_extents[2] + _SHADOW_HEIGHT
    vertices = np.column_stack((rounded + look.center[:2], np.full(_CORNERS, low))).astype(np.float32)
    up = np.broadcast_to(np.array((0, 0, 1), np.float32), vertices.shape)
    return Mesh(vertices, up, np.full(_CORNERS, Material.TYRE, np.uint8), fan(_CORNERS))


def circle(corners: int) -> NDArray[np.float64]:
    """Return the corners of a polygon on the circle around the origin with a radius of 1, counterclockwise, (corners, 2)."""
    turns = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return np.stack((np.cos(turns), np.sin(turns)), axis=1)


def fan(corners: int) -> NDArray[np.uint32]:
    """Return the triangles of a convex polygon, as indices of its corners, (corners - 2, 3)."""
    corner = np.arange(1, corners - 1, dtype=np.uint32)
    return np.stack((np.zeros_like(corner), corner, corner + 1), axis=1)
