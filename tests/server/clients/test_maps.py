"""Maps by all names that clients know them by."""

from __future__ import annotations

import carla
import pytest


@pytest.mark.parametrize("name", ["Town10HD_Opt", "Town10HD", "/Game/Carla/Maps/Town10HD_Opt"])
def test_a_map_is_loaded_under_the_name_that_was_asked_for(client: carla.Client, name: str) -> None:
    plain = name.rpartition("/")[2]
    assert plain in {known.rpartition("/")[2] for known in client.get_available_maps()}
    world = client.load_world(name)
    assert world.get_map().name.rpartition("/")[2] == plain
    assert world.get_map().get_spawn_points()


def test_layers_of_a_map_are_accepted(client: carla.Client) -> None:
    world = client.load_world("Town10HD_Opt", True, carla.MapLayer.NONE)
    world.unload_map_layer(carla.MapLayer.Buildings)
    world.load_map_layer(carla.MapLayer.All)
    assert world.get_map().name.endswith("Town10HD_Opt")


def test_yaws_of_spawn_points_are_those_that_vehicles_report(client: carla.Client) -> None:
    world = client.load_world("Town10HD")
    world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    points = world.get_map().get_spawn_points()
    model = world.get_blueprint_library().find("vehicle.tesla.model3")
    answers = client.apply_batch_sync([carla.command.SpawnActor(model, point) for point in points[::7]], True)
    snapshot = world.get_snapshot()
    for answer, point in zip(answers, points[::7], strict=True):
        assert not answer.error
        assert snapshot.find(answer.actor_id).get_transform().rotation.yaw == pytest.approx(point.rotation.yaw, abs=0.01)
