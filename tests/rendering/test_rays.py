"""Rays against synthetic towns and models."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carla_recap.rendering.rays import RayScene
from carla_recap.scene.materials import Material, Tag
from carla_recap.scene.mesh import Mesh
from tests.rendering.shapes import boxes, cube, square

pytest.importorskip("embreex")
DOWN, AHEAD = (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
GROUND = square(-50, -50, 100)


def quad(corners: list[tuple[float, float, float]], material: Material) -> Mesh:
    vertices = np.array(corners, np.float32)
    normal = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
    normals = np.repeat(normal[None] / np.linalg.norm(normal), 4, axis=0).astype(np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    return Mesh(vertices, normals, np.full(4, material, np.uint8), triangles)


def pyramid() -> Mesh:
    """Return a pyramid that fills the cube."""
    foot = [(-1.0, -1.0, -1.0), (1.0, -1.0, -1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, -1.0)]
    sides = [quad([foot[i], foot[(i + 1) % 4], (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)], Material.PAINT) for i in range(4)]
    return Mesh.concatenate(sides)


def models(*meshes: Mesh) -> list[Any]:
    return [SimpleNamespace(mesh=mesh) for mesh in meshes]


def test_a_ray_meets_the_ground_at_its_distance_and_angle() -> None:
    scene = RayScene([GROUND], [])
    sloped = np.array([0.8, 0.0, -0.6])
    hits = scene.cast(np.array([1.0, 2.0, 3.0]), np.array([DOWN, tuple(sloped), (0.0, 0.0, 1.0)]), 100.0, boxes())
    assert hits.ray.tolist() == [0, 1]
    assert hits.distance == pytest.approx([3.0, 5.0], abs=1e-4)
    assert hits.cosine == pytest.approx([1.0, 0.6], abs=1e-5)
    assert hits.tag.tolist() == [Tag.ROADS] * 2
    assert hits.actor.tolist() == [0, 0]


def test_rays_end_at_their_reach() -> None:
    scene = RayScene([GROUND], models(cube()))
    car = boxes((10, 0, 1), half=(2, 1, 1), ids=[7])
    assert not len(scene.cast(np.array([0.0, 0.0, 3.0]), np.array([DOWN]), 2.9, car).ray)
    assert not len(scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 7.9, car).ray)
    assert len(scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 8.1, car).ray) == 1


def test_an_actor_is_hit_where_its_model_is_with_its_id_tag_and_normal() -> None:
    scene = RayScene([GROUND], models(cube()))
    turned = boxes((10, 0, 1), half=(2, 1, 1), ids=[7], yaws=90.0)
    hits = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 50.0, turned)
    assert hits.distance == pytest.approx([9.0], abs=1e-4)
    assert (hits.actor.tolist(), hits.tag.tolist()) == ([7], [Tag.CAR])
    assert hits.cosine == pytest.approx([1.0], abs=1e-5)


def test_a_ray_passes_the_box_of_an_actor_where_its_model_leaves_room() -> None:
    scene = RayScene([GROUND], models(pyramid()))
    tent = boxes((10, 0, 1), ids=[7])
    over = np.array([0.9, 0.0, -0.1])
    hits = scene.cast(np.array([0.0, 0.9, 1.9]), np.array([AHEAD, tuple(over / np.linalg.norm(over))]), 40.0, tent)
    assert hits.actor.tolist() == [0]
    level = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, tent)
    assert level.distance == pytest.approx([9.5], abs=1e-4)
    assert level.cosine == pytest.approx([2 / np.sqrt(5)], abs=1e-4)


def test_the_nearest_of_actors_and_walls_is_hit() -> None:
    wall = quad([(15.0, -5.0, 0.0), (15.0, 5.0, 0.0), (15.0, 5.0, 9.0), (15.0, -5.0, 9.0)], Material.CONCRETE)
    scene = RayScene([GROUND, wall], models(cube(), pyramid()))
    both = boxes((20, 0, 1), (10, 0, 1), ids=[3, 8], models=[1, 0])
    assert scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, both).actor.tolist() == [8]
    behind = boxes((20, 0, 1), ids=[3], models=1)
    hits = scene.cast(np.array([0.0, 0.0, 1.0]), np.array([AHEAD]), 40.0, behind)
    assert (hits.actor.tolist(), hits.distance.tolist()) == ([0], pytest.approx([15.0], abs=1e-3))


def test_actors_without_size_or_with_impossible_poses_are_no_harm() -> None:
    scene = RayScene([], models(cube()))
    odd = boxes((np.nan, 0, 0), (10, 0, 0), (20, 0, 0), half=[(1, 1, 1), (0, 0, 0), (1, 1, 1)], ids=[1, 2, 3])
    odd.rotations[2] = np.inf
    assert not set(scene.cast(np.zeros(3), np.array([AHEAD]), 40.0, odd).actor.tolist()) - {2}
