"""The blueprint library."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.model.records import ActorKind
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.errors import SpawnError
from tests.samples import carla_log

LIBRARY = standard_library()


def test_names_are_carlas_and_uids_are_places_in_the_list() -> None:
    names = [blueprint.id for blueprint in LIBRARY]
    assert names == sorted(set(names))
    assert [blueprint.uid for blueprint in LIBRARY] == list(range(1, len(LIBRARY) + 1))
    assert {"vehicle.tesla.model3", "walker.pedestrian.0001", "sensor.other.collision", "static.prop.barrel"} <= set(names)
    assert len(names) == 214
    families = ("vehicle.*", "walker.*", "static.prop.*", "sensor.*")
    assert [len(LIBRARY.filter(family)) for family in families] == [41, 52, 99, 19]
    assert {b.attributes["number_of_wheels"] for b in LIBRARY.filter("vehicle.*")} == {"2", "4", "6"}


def test_patterns_find_blueprints() -> None:
    assert [b.id for b in LIBRARY.filter("vehicle.audi.*")] == ["vehicle.audi.a2", "vehicle.audi.etron", "vehicle.audi.tt"]
    assert [b.id for b in LIBRARY.filter("model3")] == ["vehicle.tesla.model3"]
    assert LIBRARY.filter("nothing.*") == []


@pytest.mark.parametrize("blueprint", LIBRARY.filter("vehicle.*"), ids=lambda blueprint: blueprint.id)
def test_the_parameters_of_a_vehicle_are_consistent(blueprint) -> None:  # type: ignore[no-untyped-def]
    physics, extent = blueprint.physics, blueprint.box.extent
    assert blueprint.box.location.z == extent.z
    assert len(physics.wheels) == max(4, int(blueprint.attributes["number_of_wheels"]))
    front, rear = physics.wheels[0], physics.wheels[-1]
    behind = [wheel.position.x for wheel in physics.wheels if not wheel.max_steer_angle]
    assert 50 * extent.x < front.position.x - sum(behind) / len(behind) < 200 * extent.x
    assert all(
        left.position.y < 0 < right.position.y for left, right in zip(physics.wheels[::2], physics.wheels[1::2], strict=True)
    )
    assert front.max_steer_angle > 0 == rear.max_steer_angle
    assert front.max_handbrake_torque == 0 < rear.max_handbrake_torque
    assert [speed for speed, _ in physics.torque_curve] == sorted(speed for speed, _ in physics.torque_curve)
    assert [gear.ratio for gear in physics.forward_gears] == sorted((g.ratio for g in physics.forward_gears), reverse=True)


def test_physics_that_was_recorded_is_that_of_the_recording() -> None:
    control = LIBRARY.get("vehicle.lincoln.mkz_2017").physics
    with open_recording(carla_log("carla-0.9.13-lane-center.log")) as recording:
        table = recording.table("physics").to_pandas().iloc[0]
        spawn = recording.actors[int(table.id)].spawn
    assert (spawn.type_id, spawn.yaw) == ("vehicle.lincoln.mkz_2017", pytest.approx(90.0, abs=0.001))
    names = ("max_rpm", "moi", "clutch_strength", "final_ratio", "mass", "drag_coefficient")
    dampings = [name for name in table.index if name.startswith("damping")]
    assert len(dampings) == 3
    for name in (*names, *dampings):
        assert getattr(control, name) == pytest.approx(table[name], abs=1e-6), name
    for name in ("torque_curve", "steering_curve"):
        recorded = np.array([tuple(point.values()) for point in table[name]])
        assert recorded == pytest.approx(np.array(getattr(control, name)), abs=1e-6)
    gears = [tuple(gear.values()) for gear in table.forward_gears]
    assert gears == [pytest.approx((gear.ratio, gear.down_ratio, gear.up_ratio)) for gear in control.forward_gears]
    assert (table.center_of_mass_x, table.center_of_mass_z) == pytest.approx(
        (control.center_of_mass.x, control.center_of_mass.z)
    )
    for wheel, found in zip(control.wheels, table.wheels, strict=True):
        same = {name: getattr(wheel, name) for name in found if not name.startswith("position")}
        assert same == pytest.approx({name: found[name] for name in same}, abs=1e-4)
        place = found["position_y"] - spawn.y, spawn.x - found["position_x"]  # it stands in the direction of y
        assert place == pytest.approx((wheel.position.x, wheel.position.y), abs=0.05)


@pytest.mark.parametrize(
    ("name", "length", "width", "height"),
    [
        ("static.prop.container", 1.9318, 1.0124, 1.7142),
        ("static.prop.dirtdebris01", 1.8574, 1.5139, 0.1490),
        ("vehicle.gazelle.omafiets", 1.8434, 0.6590, 1.7758),
        ("vehicle.tesla.model3", 4.7918, 2.1635, 1.4877),
        ("vehicle.bh.crossbike", 1.5093, 0.8659, 1.6124),
        ("vehicle.kawasaki.ninja", 2.0437, 0.7969, 1.5232),
        ("vehicle.mercedes.sprinter", 5.9152, 1.9884, 2.5607),
        ("walker.pedestrian.0001", 0.3754, 0.3754, 1.86),
        ("walker.pedestrian.0010", 0.5, 0.5, 1.1),
    ],
)
def test_sizes_are_those_of_carla(name: str, length: float, width: float, height: float) -> None:
    extent = LIBRARY.get(name).box.extent
    assert (2 * extent.x, 2 * extent.y, 2 * extent.z) == pytest.approx((length, width, height), rel=0.01)


def test_random_traffic_consists_of_the_same_models_as_ever() -> None:
    vehicles, walkers = (LIBRARY.traffic(kind) for kind in (ActorKind.VEHICLE, ActorKind.WALKER))
    assert (len(vehicles), len(walkers)) == (20, 51)
    assert [vehicles[0].id, vehicles[-1].id] == ["vehicle.audi.a2", "vehicle.volkswagen.t2"]


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
