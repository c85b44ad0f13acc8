"""What can be spawned."""

from __future__ import annotations

import pytest

from carla_recap.records import ActorKind
from carla_recap.sim.actors.attributes import attribute_type
from carla_recap.sim.actors.blueprints import standard_library
from carla_recap.sim.errors import SpawnError

LIBRARY = standard_library()


def test_names_are_carlas_and_uids_are_places_in_the_list() -> None:
    names = [blueprint.id for blueprint in LIBRARY]
    assert names == sorted(set(names))
    assert [blueprint.uid for blueprint in LIBRARY] == list(range(1, len(LIBRARY) + 1))
    assert {"vehicle.tesla.model3", "walker.pedestrian.0001", "sensor.other.collision", "static.prop.barrel"} <= set(names)
    assert len(LIBRARY.filter("vehicle.*")) >= 14
    assert {b.attributes["number_of_wheels"] for b in LIBRARY.filter("vehicle.*")} == {"2", "4"}


def test_patterns_find_blueprints() -> None:
    assert [b.id for b in LIBRARY.filter("vehicle.audi.*")] == ["vehicle.audi.a2", "vehicle.audi.etron", "vehicle.audi.tt"]
    assert [b.id for b in LIBRARY.filter("model3")] == ["vehicle.tesla.model3"]
    assert LIBRARY.filter("nothing.*") == []


@pytest.mark.parametrize("blueprint", LIBRARY.filter("vehicle.*"), ids=lambda blueprint: blueprint.id)
def test_vehicles_are_of_one_piece(blueprint) -> None:  # type: ignore[no-untyped-def]
    physics, extent = blueprint.physics, blueprint.box.extent
    assert 0.5 * extent.x < blueprint.wheelbase < 2 * extent.x
    assert blueprint.box.location.z == extent.z
    assert len(physics.wheels) == int(blueprint.attributes["number_of_wheels"])
    front, rear = physics.wheels[0], physics.wheels[-1]
    assert front.position.x - rear.position.x == pytest.approx(100 * blueprint.wheelbase)
    assert front.max_steer_angle > 0 == rear.max_steer_angle
    assert front.max_handbrake_torque == 0 < rear.max_handbrake_torque
    assert [speed for speed, _ in physics.torque_curve] == sorted(speed for speed, _ in physics.torque_curve)
    assert [gear.ratio for gear in physics.forward_gears] == sorted((g.ratio for g in physics.forward_gears), reverse=True)
    assert blueprint.attributes["color"] in blueprint.choices["color"]


def test_the_box_of_a_walker_is_around_its_middle() -> None:
    for walker in LIBRARY.filter("walker.*"):
        assert walker.kind == ActorKind.WALKER
        assert walker.box.location.z == 0
        assert 1.0 < 2 * walker.box.extent.z < 2.0


def test_unknown_names_are_refused() -> None:
    with pytest.raises(SpawnError, match=r"did you mean walker\.pedestrian\.0"):
        LIBRARY.get("walker.pedestrian.9901")
    with pytest.raises(SpawnError, match=r"no blueprint 'x'; there are vehicle\.\*"):
        LIBRARY.get("x")


def test_attributes_have_carlas_types() -> None:
    keys = ("sticky_control", "number_of_wheels", "speed", "role_name", "color")
    assert [attribute_type(key) for key in keys] == [0, 1, 2, 3, 4]


def test_the_library_is_pure() -> None:
    blueprint = LIBRARY.get("vehicle.audi.tt")
    with pytest.raises(TypeError):
        blueprint.attributes["color"] = "0,0,0"  # type: ignore[index]
