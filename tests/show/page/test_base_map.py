"""The base map: outlines that cover what the triangles of a town cover, and the paths of vehicles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carla_recap.scene.materials import Material
from carla_recap.scene.mesh import Mesh
from carla_recap.show.page.base_map import LAYERS, base_map, outlines
from carla_recap.town.mesh import TownMesh, load_town_mesh
from tests.samples import CROSSING
from tests.show.page.conftest import sampled

BRICKFIELD = Path(__file__).parents[3] / "src" / "carla_recap" / "sim" / "towns" / "Brickfield.xodr"


def area(ring: np.ndarray) -> float:
    """Return the signed area of a closed line."""
    x, y = ring.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def mesh(points: list[tuple[float, float]], triangles: list[tuple[int, int, int]], material: Material) -> Mesh:
    vertices = np.column_stack((np.array(points, np.float32), np.zeros(len(points), np.float32))).astype(np.float32)
    up = np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    return Mesh(vertices, up, np.full(len(points), material, np.uint8), np.array(triangles, np.uint32))


def test_a_hole_runs_the_other_way_around() -> None:
    outer, inner = [(0, 0), (9, 0), (9, 9), (0, 9)], [(3, 3), (6, 3), (6, 6), (3, 6)]
    around = [triangle for i in range(4) for triangle in ((i, (i + 1) % 4, 4 + i), ((i + 1) % 4, 4 + (i + 1) % 4, 4 + i))]
    (found,) = outlines(TownMesh("", [mesh([*outer, *inner], around, Material.SIDEWALK)]))
    assert sorted(area(ring) for ring in found.rings) == pytest.approx([-9, 81])


def test_the_outlines_of_a_town_have_the_area_of_its_triangles() -> None:
    town = load_town_mesh(BRICKFIELD)
    for layer, materials in LAYERS.items():
        covered = 0.0
        for tile in town.tiles:
            first = tile.triangles[:, 0]
            chosen = np.isin(tile.materials[first], materials) & (tile.normals[first, 2] > 0.3)
            a, b, c = np.moveaxis(tile.vertices[tile.triangles[chosen]][:, :, :2].astype(float), 1, 0)
            (x, y), (u, v) = (b - a).T, (c - a).T
            covered += float(np.abs(x * v - y * u).sum()) / 2
        drawn = sum(area(ring) for group in outlines(town) if group.layer == layer for ring in group.rings)
        assert drawn == pytest.approx(covered, rel=0.02, abs=1), layer


def test_the_second_of_two_recordings_has_its_paths_below_the_surfaces_of_the_first() -> None:
    town = TownMesh("", [mesh([(0, 0), (4, 0), (4, 2)], [(0, 1, 2)], Material.ROAD)])
    replay = sampled(CROSSING)
    assert not base_map(town, [replay]).paths
    found = base_map(town, [replay, replay])
    assert len(found.surfaces) == 1
    alone = base_map(None, [replay])
    assert not alone.surfaces
    assert sum(map(len, found.paths)) == sum(map(len, alone.paths)) > 100
