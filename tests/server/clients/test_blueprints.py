"""Everything in the library of 0.9.16, spawned as clients spawn it."""

from __future__ import annotations

import carla
import pytest

from tests.server.clients.calls import ahead, drive, spawn, speed, straight

NEEDED = (
    "vehicle.lincoln.mkz_2017",
    "static.trigger.friction",
    "sensor.camera.cosmos_visualization",
    "sensor.other.v2x",
    "sensor.other.v2x_custom",
    "static.prop.warningconstruction",
    "static.prop.warningaccident",
    "static.prop.dirtdebris02",
)


@pytest.mark.parametrize("blueprint", NEEDED)
def test_blueprints_that_clients_name_are_there(world: carla.World, blueprint: str) -> None:
    assert world.get_blueprint_library().find(blueprint).id == blueprint


def test_all_blueprints_are_spawned_once_with_all_attributes_set(client: carla.Client, world: carla.World) -> None:
    library = world.get_blueprint_library()
    assert len(library) >= 214
    point = world.get_map().get_spawn_points()[5]
    commands = []
    for height, blueprint in enumerate(sorted(library, key=lambda found: found.id)):
        for attribute in blueprint:
            assert bool(attribute.recommended_values) == attribute.is_modifiable, f"{blueprint.id} {attribute.id}"
            for value in attribute.recommended_values[:1]:
                blueprint.set_attribute(attribute.id, value)
        commands.append(carla.command.SpawnActor(blueprint, ahead(point, 0.0, up=1.0 + 20.0 * height)))
    answers = client.apply_batch_sync(commands, True)
    assert [answer.error for answer in answers] == [""] * len(commands)
    ids = [answer.actor_id for answer in answers]
    for _ in range(5):
        world.tick()
    assert len(world.get_actors(ids)) == len(ids)
    answers = client.apply_batch_sync([carla.command.DestroyActor(id) for id in ids], True)
    assert [answer.error for answer in answers] == [""] * len(commands)


def test_debris_is_driven_over(world: carla.World) -> None:
    start = straight(world, 60.0)
    for name in ("static.prop.dirtdebris01", "static.prop.dirtdebris02", "static.prop.dirtdebris03"):
        spawn(world, name, ahead(start, 20.0, up=start.location.z))
    car = spawn(world, "vehicle.tesla.model3", start)
    world.tick()
    assert drive(world, car, 100) > 30.0
    assert speed(car) > 5.0
