"""What vehicles meet on the road: walkers, debris, and actors above or below, such as those that ScenarioRunner hides."""

from __future__ import annotations

import carla

from tests.server.client import Data, ahead, drive, sensor, settle, spawn, speed, straight
from tests.waiting import PATIENCE

DEEP = -500.0  # m


def collisions_of(world: carla.World, car: carla.Actor) -> Data:
    return Data(sensor(world, "other.collision", car, carla.Transform()))


def test_a_walker_who_is_hit_lies_on_the_road_and_is_reported(world: carla.World) -> None:
    start = straight(world, 60.0)
    walker = spawn(world, "walker.pedestrian.0004", ahead(start, 25.0, up=0.5), is_invincible="false")
    car = spawn(world, at=start)
    collisions = collisions_of(world, car)
    drive(world, car, 100, throttle=1.0)
    assert collisions.get(timeout=PATIENCE).other_actor.id == walker.id
    rotation = walker.get_transform().rotation
    assert max(abs(rotation.pitch), abs(rotation.roll)) > 45.0


def test_debris_is_driven_over(world: carla.World) -> None:
    start = straight(world, 60.0)
    for number in (1, 2, 3):
        spawn(world, f"static.prop.dirtdebris0{number}", ahead(start, 20.0))
    car = spawn(world, at=start)
    assert drive(world, car, 100) > 30.0
    assert speed(car) > 5.0


def test_a_car_drives_over_one_that_is_hidden_below_the_street(world: carla.World) -> None:
    start = straight(world, 60.0)
    hidden = spawn(world, "vehicle.audi.tt", ahead(start, 20.0))
    hidden.set_simulate_physics(False)
    hidden.set_location(hidden.get_location() + carla.Location(z=DEEP))
    driver = spawn(world, at=start)
    collisions = collisions_of(world, driver)
    assert drive(world, driver, 120) > 40.0
    settle()
    assert collisions.empty()
    assert hidden.get_location().z < DEEP + 50.0


def test_an_actor_is_spawned_below_another_one(world: carla.World) -> None:
    start = straight(world, 60.0)
    above = spawn(world, at=start)
    walker = spawn(world, "walker.pedestrian.0001", ahead(start, 0.0, up=-50.0))
    assert above.is_alive
    assert walker.is_alive


def test_a_hidden_car_comes_back_and_is_in_the_way(world: carla.World) -> None:
    start = straight(world, 60.0)
    place = ahead(start, 20.0)
    other = spawn(world, "vehicle.audi.tt", place)
    other.set_simulate_physics(False)
    other.set_transform(ahead(place, 0.0, up=DEEP))
    world.tick()
    other.set_transform(place)
    other.set_simulate_physics(True)
    driver = spawn(world, at=start)
    collisions = collisions_of(world, driver)
    drive(world, driver, 120)
    assert collisions.get(timeout=PATIENCE).other_actor.id == other.id


def test_props_are_stacked(client: carla.Client, world: carla.World) -> None:
    point = world.get_map().get_spawn_points()[3]
    props = [prop for prop in world.get_blueprint_library().filter("static.prop.*") if "mesh" not in prop.id]
    commands = [carla.command.SpawnActor(prop, ahead(point, 0.0, up=100.0 * height)) for height, prop in enumerate(props)]
    assert [answer.error for answer in client.apply_batch_sync(commands, True)] == [""] * len(props)
    assert len(world.get_actors().filter("static.prop.*")) == len(props)
