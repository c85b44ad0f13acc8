"""The models of actors: they fill their box, are closed, and face outward."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.scene.gltf import read_glb
from carla_recap.scene.materials import Material
from carla_recap.scene.models import INDEX, MODELS
from tools.models.__main__ import FOLDER, models

SOLID = [model for model in MODELS if model.name != "collision mark"]

CARS = [
    "sedan",
    "hatchback",
    "coupe",
    "suv",
    "off-roader",
    "microcar",
    "van",
    "minibus",
    "bus",
    "police car",
    "taxi",
    "pickup",
]
TRUCKS = ["box truck", "lorry", "fire engine", "ambulance"]


def test_the_files_are_what_the_tool_makes():
    """With a tolerance, since the last digits of a sine differ from machine to machine."""
    for name, data in models().items():
        made, kept = read_glb(data), read_glb((FOLDER / name).read_bytes())
        assert [(part.material, part.color) for part in made] == [(part.material, part.color) for part in kept], name
        for one, other in zip(made, kept, strict=True):
            assert one.positions == pytest.approx(other.positions, abs=1e-4), name
            assert one.normals == pytest.approx(other.normals, abs=2e-3), name
            assert (one.triangles == other.triangles).all(), name
    assert {path.name for path in FOLDER.iterdir()} == set(models()), "run 'make models'"


def test_a_model_fills_the_box_and_nothing_else():
    for model in MODELS:
        flat = np.array(model.size) < 1e-3
        assert np.abs(model.mesh.vertices).max(axis=0)[~flat] == pytest.approx(1), model.name
        assert model.mesh.vertices.min(axis=0)[~flat] == pytest.approx(-1), model.name


def test_corners_of_a_triangle_are_of_one_material_and_its_normals_have_length_1():
    for model in MODELS:
        materials = model.mesh.materials[model.mesh.triangles]
        assert (materials == materials[:, :1]).all(), model.name
        assert np.linalg.norm(model.mesh.normals, axis=1) == pytest.approx(1, abs=1e-4), model.name


def test_corners_run_counterclockwise_about_the_normals():
    for model in MODELS:
        corners = model.mesh.vertices[model.mesh.triangles].astype(np.float64) * np.array(model.size)
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = model.mesh.normals[model.mesh.triangles].mean(axis=1) / np.maximum(model.size, 1e-6)
        large = np.linalg.norm(facing, axis=1) > 1e-7
        assert ((facing * normals).sum(axis=1)[large] > 0).all(), model.name


def test_the_sides_face_outward():
    """Of all that a ray from outside meets first, the front is seen."""
    for model in SOLID:
        corners = model.mesh.vertices[model.mesh.triangles].astype(np.float64)
        volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        assert volume > 0, model.name


@pytest.mark.parametrize(
    ("material", "ahead", "left"),
    [
        (Material.HEADLIGHT, 1, 0),
        (Material.TAIL_LIGHT, -1, 0),
        (Material.BRAKE_LIGHT, -1, 0),
        (Material.REVERSE_LIGHT, -1, 0),
        (Material.LEFT_INDICATOR, 0, 1),
        (Material.RIGHT_INDICATOR, 0, -1),
    ],
)
def test_lamps_are_where_they_belong(material, ahead, left):
    for name in (*CARS, *TRUCKS):
        mesh = MODELS[INDEX[name]].mesh
        points = mesh.vertices[mesh.materials == material]
        assert len(points), name
        assert not ahead or (points[:, 0] * ahead).max() > 0.95, name
        assert not ahead or (points[:, 0] * ahead > 0.2).all() or name == "pickup"  # with a lamp on its cab
        assert not left or (points[:, 1] * left > 0).all(), name


def test_front_wheels_are_steered_about_their_middle():
    model = MODELS[INDEX["sedan"]]
    wheels = model.mesh.vertices[model.steered]
    assert set(model.mesh.materials[model.steered]) <= {Material.TYRE, Material.RIM, Material.TRIM}
    assert (wheels[:, 0] > 0.3).all()
    left = model.steered & (model.mesh.vertices[:, 1] > 0)
    spread = model.mesh.vertices[left]
    assert (spread.max(axis=0)[:2] + spread.min(axis=0)[:2]) / 2 == pytest.approx(model.pivots[left][0], abs=0.02)
    assert (model.pivots[~model.steered] == 0).all()


def test_the_lamps_of_a_light_face_right_and_red_is_on_top():
    mesh = MODELS[INDEX["traffic light"]].mesh
    heights = []
    for material in (Material.RED_LAMP, Material.YELLOW_LAMP, Material.GREEN_LAMP):
        lit = mesh.materials == material
        assert (mesh.normals[lit][:, 1] < -0.99).all()
        heights.append(mesh.vertices[lit][:, 2].mean())
    assert heights[0] > heights[1] > heights[2]
