"""Rays against synthetic towns and models."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carla_recap.rendering.rays import RayScene
from carla_recap.scene.instances import Instances
from carla_recap.scene.materials import Material, Tag
from carla_recap.scene.mesh import Mesh

pytest.importorskip("embreex")

Floats = NDArray[np.float64]
DOWN, AHEAD = (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
ROAD = 50.0  # m: half the size of the ground


def quad(corners: list[tuple[float, float, float]], material: Material) -> Mesh:
    vertices = np.array(corners, np.float32)
    normal = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
    normals = np.repeat(normal[None] / np.linalg.norm(normal), 4, axis=0).astype(np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    return Mesh(vertices, normals, np.full(4, material, np.uint8), triangles)


def ground(z: float = 0.0, material: Material = Material.ROAD, half: float = ROAD) -> Mesh:
    return quad([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)], material)


def cube(material: Material = Material.PAINT) -> Mesh:
    """Return a cube without a roof of its own material: that is glass."""
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = (-1, 1, 1, -1), (-1, -1, 1, 1)
            corners = corners if sign > 0 else corners[::-1]
            sides.append(quad([tuple(corner) for corner in corners.tolist()], material))
    return Mesh.concatenate(sides)


def pyramid() -> Mesh:
    """Return a pyramid that fills the cube."""
    foot = [(-1.0, -1.0, -1.0), (1.0, -1.0, -1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, -1.0)]
    sides = [quad([foot[i], foot[(i + 1) % 4], (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)], Material.PAINT) for i in range(4)]
    return Mesh.concatenate(sides)


def actors(*rows: tuple[int, int, tuple[float, float, float], float, tuple[float, float, float]]) -> Instances:
    """Return instances of id, model, location, yaw in degrees, and half extents."""
    count = len(rows)
    yaws = np.radians([row[3] for row in rows])
    rotations = np.zeros((count, 3, 3), np.float32)
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(yaws)
    rotations[:, 1, 0], rotations[:, 0, 1] = np.sin(yaws), -np.sin(yaws)
    rotations[:, 2, 2] = 1
    return Instances(
        ids=np.array([row[0] for row in rows], np.uint32),
        models=np.array([row[1] for row in rows], np.uint8),
        locations=np.array([row[2] for row in rows], np.float64).reshape(-1, 3),
        rotations=rotations,
        half_extents=np.array([row[4] for row in rows], np.float32).reshape(-1, 3),
        colors=np.zeros((count, 3), np.uint8),
        lamps=np.zeros(count, np.uint64),
        steering=np.zeros(count, np.float32),
        opacity=np.ones(count, np.float32),
        tags=np.full(count, Tag.CAR, np.uint8),
    )


def models(*meshes: Mesh) -> list[Any]:
    return [SimpleNamespace(mesh=mesh) for mesh in meshes]


def test_a_ray_meets_the_ground_at_its_distance_and_angle() -> None:
    scene = RayScene([ground()], [])
    sloped = np.array([0.8, 0.0, -0.6])
    hits = scene.cast(np.array([1.0, 2.0, 3.0]), np.array([DOWN, tuple(sloped), (0.0, 0.0, 1.0)]), 100.0, actors())
    assert hits.ray.tolist() == [0, 1]
    assert hits.distance == pytest.approx([3.0, 5.0], abs=1e-4)
    assert hits.cosine == pytest.approx([1.0, 0.6], abs=1e-5)
    assert hits.tag.tolist() == [Tag.ROADS] * 2
    assert hits.actor.tolist() == [0, 0]


def test_rays_end_at_their_reach() -> None:
    scene = RayScene([ground()], models(cube()))
    car = actors((7, 0, (10.0, 0.0, 1.0), 0.0, (2.0, 1.0, 1.0)))
    assert not len(scene.cast(np.array([0.0, 0.0, 3.0]), np.array([DOWN]), 2.9, car).ray)
    assert not len(scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 7.9, car).ray)
    assert len(scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 8.1, car).ray) == 1


def test_an_actor_is_hit_where_its_model_is_with_its_id_tag_and_normal() -> None:
    scene = RayScene([ground()], models(cube()))
    turned = actors((7, 0, (10.0, 0.0, 1.0), 90.0, (2.0, 1.0, 1.0)))
    hits = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 50.0, turned)
    assert hits.distance == pytest.approx([9.0], abs=1e-4)
    assert (hits.actor.tolist(), hits.tag.tolist()) == ([7], [Tag.CAR])
    assert hits.cosine == pytest.approx([1.0], abs=1e-5)


def test_a_ray_passes_the_box_of_an_actor_where_its_model_leaves_room() -> None:
    scene = RayScene([ground()], models(pyramid()))
    tent = actors((7, 0, (10.0, 0.0, 1.0), 0.0, (1.0, 1.0, 1.0)))
    over = np.array([0.9, 0.0, -0.1])
    hits = scene.cast(np.array([0.0, 0.9, 1.9]), np.array([AHEAD, tuple(over / np.linalg.norm(over))]), 40.0, tent)
    assert hits.actor.tolist() == [0]
    level = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, tent)
    assert level.distance == pytest.approx([9.5], abs=1e-4)
    assert level.cosine == pytest.approx([2 / np.sqrt(5)], abs=1e-4)


def test_the_nearest_of_actors_and_walls_is_hit() -> None:
    wall = quad([(15.0, -5.0, 0.0), (15.0, 5.0, 0.0), (15.0, 5.0, 9.0), (15.0, -5.0, 9.0)], Material.CONCRETE)
    scene = RayScene([ground(), wall], models(cube(), pyramid()))
    both = actors((3, 1, (20.0, 0.0, 1.0), 0.0, (1.0, 1.0, 1.0)), (8, 0, (10.0, 0.0, 1.0), 0.0, (1.0, 1.0, 1.0)))
    assert scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, both).actor.tolist() == [8]
    behind = actors((3, 1, (20.0, 0.0, 1.0), 0.0, (1.0, 1.0, 1.0)))
    hits = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, behind)
    assert (hits.actor.tolist(), hits.distance.tolist()) == ([0], pytest.approx([15.0], abs=1e-3))


def test_actors_without_size_or_with_impossible_poses_are_no_harm() -> None:
    scene = RayScene([], models(cube()))
    odd = actors(
        (1, 0, (np.nan, 0.0, 0.0), 0.0, (1.0, 1.0, 1.0)),
        (2, 0, (10.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0)),
        (3, 0, (20.0, 0.0, 0.0), 0.0, (1.0, 1.0, 1.0)),
    )
    odd.rotations[2] = np.inf
    assert not set(scene.cast(np.zeros(3), np.array([AHEAD]), 40.0, odd).actor.tolist()) - {2}


def test_no_rays_hit_nothing() -> None:
    assert not len(RayScene([ground()], models(cube())).cast(np.zeros(3), np.empty((0, 3)), 40.0, actors()).ray)
