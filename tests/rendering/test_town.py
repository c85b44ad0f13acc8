"""The surfaces of towns, by their areas, heights and materials."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.maps.road_geometry import read_roads
from carla_recap.rendering.materials import Material
from carla_recap.rendering.mesh import Mesh
from carla_recap.rendering.town import TownMesh, build_town, load_town_mesh, town_mesh_of
from tests.maps.towns import lane, opendrive, road, section


def built(*roads: str) -> TownMesh:
    return TownMesh.of_tiles("", *build_town(opendrive(*roads)))


def faces(town: TownMesh, *materials: Material) -> np.ndarray:
    """Return the triangles of materials: (triangles, 3, 3)."""
    mesh = Mesh.concatenate(town.tiles)
    return mesh.vertices[mesh.triangles[np.isin(mesh.materials[mesh.triangles[:, 0]], materials)]].astype(np.float64)


def area(triangles: np.ndarray) -> float:
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


def test_the_area_of_the_asphalt_is_that_of_the_lanes():
    assert area(faces(built(road()), Material.ROAD)) == pytest.approx(100 * 7, rel=1e-4)


def test_a_bend_has_the_area_of_a_ring():
    bent = built(road(length=20 * np.pi, shape='<arc curvature="0.05"/>', sections=section(0, right=lane(-1))))
    assert area(faces(bent, Material.ROAD)) == pytest.approx(np.pi / 2 * (23.5**2 - 20**2), rel=2e-3)


def test_a_sidewalk_is_above_the_road():
    walk = built(road(height=3, sections=section(0, right=lane(-1) + lane(-2, 2, "sidewalk"))))
    assert walk.ground_height(np.array([[50, -1.75], [50, -4.5]])) == pytest.approx([3, 3.12], abs=1e-4)


def test_the_ground_around_is_just_below_the_road():
    town = built(road(height=3))
    around = town.ground_height(np.array([[50.0, 40.0], [50.0, -200.0]]))
    assert ((around > 2.8) & (around < 3)).all()


def test_all_faces_are_seen_from_the_side_of_their_normals():
    right = lane(-1) + lane(-2, 1, "shoulder") + lane(-3, 2, "sidewalk")
    mesh = Mesh.concatenate(built(road(sections=section(0, lane(1) + lane(2, 2, "sidewalk"), right))).tiles)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles].astype(np.float64), 1, 0)
    normals = mesh.normals[mesh.triangles].mean(axis=1)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), normals) > 0).all()


def test_an_inner_lane_without_a_type_is_grass():
    town = built(road(sections=section(0, right=lane(-1, 3) + lane(-2, 2, "none") + lane(-3, 3))))
    assert town.ground_height(np.array([[50, -4.0]])) == pytest.approx([-0.024], abs=1e-4)


def test_a_road_with_invalid_numbers_is_left_out():
    assert area(faces(built(road(1), road(2, x="nan"), road(3, length="inf")), Material.ROAD)) == pytest.approx(
        700, rel=1e-4
    )


def test_the_same_map_gives_the_same_bytes():
    text = opendrive(road(shape='<arc curvature="0.01"/>'))
    (first, _), (second, _) = build_town(text), build_town(text)
    for one, other in zip(first, second, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(vars(one).values(), vars(other).values(), strict=True))


def test_a_town_is_made_once_in_a_child_process():
    text = opendrive(road())
    town = town_mesh_of(text, "small")
    assert town.name == "small"
    assert len(town.bounds) == len(town.tiles) > 1
    assert town_mesh_of(text, "small") is town


@pytest.mark.parametrize("text", ["", "no map", "<html/>", opendrive()])
def test_what_is_no_map_is_refused(text: str):
    with pytest.raises(RecapError, match="an OpenDRIVE map was expected"):
        town_mesh_of(text)


def test_the_lanes_are_where_carla_has_them(tmp_path):
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    from carla_recap.maps import find_map

    path = find_map("Brickfield")
    assert path is not None
    text = path.read_text()
    waypoints = carla.Map("", text).generate_waypoints(2.0)
    points = np.array([(w.transform.location.x, -w.transform.location.y, w.transform.location.z) for w in waypoints])
    town = load_town_mesh(path)
    assert np.abs(town.ground_height(points) - points[:, 2]).max() < 0.03
    assert len(read_roads(text)) == 73
