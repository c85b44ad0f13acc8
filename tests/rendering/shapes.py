"""Shapes to draw: a plane, boxes and their models, and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.rendering.camera import Camera, ImageKind
from carla_recap.rendering.renderer import Renderer
from carla_recap.replay.pose import right_handed, rotations
from carla_recap.scene.instances import Instances
from carla_recap.scene.materials import Material, Tag
from carla_recap.scene.mesh import Mesh
from carla_recap.scene.models import Model

ALL = tuple(ImageKind)
RGB, DEPTH, SEMANTIC, INSTANCE, NORMALS, FLOW = ALL


@dataclass(frozen=True, eq=False)
class Plane:
    """A town of tiles."""

    tiles: list[Mesh]


def square(x: float, y: float, size: float, z: float = 0.0, material: Material = Material.ROAD) -> Mesh:
    corners = np.array([(x, y, z), (x + size, y, z), (x + size, y + size, z), (x, y + size, z)], np.float32)
    normals = np.tile(np.float32((0, 0, 1)), (4, 1))
    return Mesh(corners, normals, np.full(4, material, np.uint8), np.array([(0, 1, 2), (0, 2, 3)], np.uint32))


def cube(material: Material = Material.PAINT) -> Mesh:
    """Return the sides of a box from -1 to 1."""
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.zeros(3)
            normal[axis] = sign
            across = np.roll(normal, 1)
            up = np.cross(normal, across)
            corners = [normal - across - up, normal + across - up, normal + across + up, normal - across + up]
            vertices, normals = np.array(corners, np.float32), np.tile(normal.astype(np.float32), (4, 1))
            triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
            sides.append(Mesh(vertices, normals, np.full(4, material, np.uint8), triangles))
    return Mesh.concatenate(sides)


def shape(mesh: Mesh, *, steered: bool = False) -> Model:
    count, size = len(mesh.vertices), (2.0, 2.0, 2.0)
    return Model("shape", mesh, np.full(count, steered), np.zeros((count, 2), np.float32), size, (0.0, 0.0, 0.0))


def plate(material: Material) -> Mesh:
    """Return the back of a box from -1 to 1."""
    whole = cube(material)
    return Mesh(whole.vertices[:4], whole.normals[:4], whole.materials[:4], whole.triangles[:2])


MODELS = (shape(cube()), shape(plate(Material.TAIL_LIGHT)), shape(cube(), steered=True))


def boxes(
    *centres: tuple[float, float, float],
    half: Any = (1, 1, 1),
    ids: Sequence[int] | None = None,
    models: int | Sequence[int] = 0,
    yaws: float | Sequence[float] = 0.0,
) -> Instances:
    """Return instances at places, whose half sizes and yaws in degrees are the same or those of each."""
    count = len(centres)
    angles = np.radians(np.broadcast_to(yaws, count))
    rotations = np.tile(np.eye(3, dtype=np.float32), (count, 1, 1))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
    rotations[:, 1, 0], rotations[:, 0, 1] = np.sin(angles), -np.sin(angles)
    return Instances(
        ids=np.array(range(0x1234, 0x1234 + count) if ids is None else ids, np.uint32),
        models=np.broadcast_to(np.uint8(models), count).copy(),
        locations=np.array(centres, np.float64).reshape(-1, 3),
        rotations=rotations,
        half_extents=np.broadcast_to(np.float32(half), (count, 3)).copy(),
        colors=np.tile(np.uint8((200, 30, 30)), (count, 1)),
        lamps=np.zeros(count, np.uint64),
        steering=np.zeros(count, np.float32),
        opacity=np.ones(count, np.float32),
        tags=np.full(count, Tag.CAR, np.uint8),
    )


def camera(
    location: tuple[float, float, float] = (0, 0, 2),
    *,
    roll: float = 0,
    pitch: float = 0,
    yaw: float = 0,
    width: int = 160,
    height: int = 120,
    fov: float = 90,
) -> Camera:
    """Return a camera; its angles are CARLA's, in degrees."""
    pose = right_handed(np.array((0, 0, 0, roll, pitch, yaw), np.float64))
    return Camera(width, height, fov, np.array(location, np.float64), rotations(pose))


PLANE = Plane([square(x, y, 50) for x in range(-1000, 1000, 50) for y in range(-1000, 1000, 50)])


def create(town: Plane | None = PLANE, **options: object) -> Renderer:
    pytest.importorskip("moderngl", reason="moderngl is not installed")
    try:
        return Renderer(town.tiles if town else (), models=MODELS, **options)  # type: ignore[arg-type]
    except RecapError as error:
        pytest.skip(str(error))
