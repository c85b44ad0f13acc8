"""Actors above each other: hidden below the street, as ScenarioRunner hides them, or stacked in the air."""

from __future__ import annotations

import time

import carla

from tests.server.clients.calls import ahead, drive, spawn, straight
from tests.waiting import wait_until

DEEP = -500.0  # m


def test_a_car_drives_over_one_that_is_hidden_below_the_street(world: carla.World) -> None:
    start = straight(world, 60.0)
    hidden = spawn(world, "vehicle.audi.tt", ahead(start, 20.0))
    hidden.set_simulate_physics(False)
    world.tick()
    hidden.set_location(hidden.get_location() + carla.Location(z=DEEP))
    world.tick()
    driver = spawn(world, "vehicle.tesla.model3", start)
    collisions: list[carla.CollisionEvent] = []
    sensor = world.spawn_actor(world.get_blueprint_library().find("sensor.other.collision"), carla.Transform(), driver)
    sensor.listen(collisions.append)
    assert drive(world, driver, 120) > 40.0
    time.sleep(0.5)
    assert not collisions
    assert hidden.get_location().z < DEEP + 50.0


def test_an_actor_is_spawned_below_another_one(world: carla.World) -> None:
    start = straight(world, 60.0)
    above = spawn(world, "vehicle.tesla.model3", start)
    walker = spawn(world, "walker.pedestrian.0001", ahead(start, 0.0, up=-50.0))
    world.tick()
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
    world.tick()
    driver = spawn(world, "vehicle.tesla.model3", start)
    collisions: list[carla.CollisionEvent] = []
    sensor = world.spawn_actor(world.get_blueprint_library().find("sensor.other.collision"), carla.Transform(), driver)
    sensor.listen(collisions.append)
    drive(world, driver, 120)
    wait_until(lambda: collisions)
    assert collisions[0].other_actor.id == other.id


def test_props_are_stacked(world: carla.World) -> None:
    point = world.get_map().get_spawn_points()[3]
    props = [
        blueprint.id for blueprint in world.get_blueprint_library().filter("static.prop.*") if "mesh" not in blueprint.id
    ]
    for height, prop in enumerate(props):
        spawn(world, prop, ahead(point, 0.0, up=100.0 * height))
    world.tick()
    assert len(world.get_actors().filter("static.prop.*")) == len(props)
