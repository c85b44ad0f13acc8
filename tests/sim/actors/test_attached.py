"""Attached actors follow their parents."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from carla_recap.sim.actors.moving import Vehicle, VehicleControl
from carla_recap.sim.episode import Actor
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_world, spawn_car


def truck(world: World, x: float = 0.0) -> Vehicle:
    actor = spawn_car(world, at(x), "vehicle.carlamotors.firetruck")
    actor.apply_control(VehicleControl(throttle=0.8, steer=0.1))
    return actor


def place(transform: Transform) -> tuple[float, ...]:
    location, rotation = transform.location, transform.rotation
    return *astuple(location), *astuple(rotation)


@pytest.mark.parametrize("blueprint", ["vehicle.mini.cooper_s", "walker.pedestrian.0001", "static.prop.box01"])
def test_an_attached_actor_follows_its_vehicle(blueprint: str) -> None:
    world = flat_world()
    parent = truck(world)
    child = world.spawn(blueprint, at(-9.0, 1.0, yaw=10.0), parent=parent)
    for _ in range(120):
        world.tick()
        there = parent.transform.transform(Location(-9.0, 1.0))
        assert astuple(child.transform.location) == pytest.approx(astuple(there), abs=1e-6)
        assert np.cos(np.radians(child.transform.rotation.yaw - parent.transform.rotation.yaw - 10.0)) == pytest.approx(1.0)
        assert astuple(child.velocity) == pytest.approx(astuple(parent.velocity))
        assert astuple(child.acceleration) == pytest.approx(astuple(parent.acceleration))
    assert parent.transform.location.x > 5.0
    assert place(child.relative_transform) == place(at(-9.0, 1.0, yaw=10.0))


def test_an_attached_actor_exerts_no_forces_on_its_parent() -> None:
    world, alone = flat_world(), flat_world()
    parent, other = truck(world), truck(alone)
    world.spawn("vehicle.vespa.zx125", at(0.0, z=3.8), parent=parent)
    walker = world.spawn("walker.pedestrian.0001", at(2.0, z=1.0), parent=parent)
    walker.set_collisions(True)
    world.run(3)
    alone.run(3)
    assert place(parent.transform) == place(other.transform)


def test_an_attached_actor_follows_in_spite_of_its_control() -> None:
    world = flat_world()
    parent = truck(world)
    car = world.spawn("vehicle.mini.cooper_s", at(-9.0), parent=parent)
    car.set_simulate_physics(True)
    car.set_collisions(True)
    car.set_target_velocity(Vector(0.0, 50.0))
    car.apply_control(VehicleControl(throttle=1.0, steer=1.0))
    world.run(1)
    assert not car.simulates_physics
    assert car.transform.location.distance(parent.transform.transform(Location(-9.0))) < 1e-6


def test_the_transform_is_set_relative_to_the_parent() -> None:
    world = flat_world()
    parent = truck(world, 50.0)
    walker = world.spawn("walker.pedestrian.0001", at(0.0, z=4.0), parent=parent)
    walker.transform = at(-2.0, z=4.0)
    assert walker.transform.location.x == pytest.approx(48.0)
    world.run(1)
    assert walker.transform.location.distance(parent.transform.transform(Location(-2.0, 0.0, 4.0))) < 1e-6


def test_the_autopilot_of_a_parent_ignores_attached_actors() -> None:
    world = flat_world()
    parent = truck(world, 10.0)
    world.spawn("vehicle.vespa.zx125", at(1.0, z=3.8), parent=parent)
    world.spawn("vehicle.mini.cooper_s", at(-9.0), parent=parent)
    world.spawn("walker.pedestrian.0001", at(2.0, z=4.0), parent=parent)
    parent.set_autopilot(True)
    world.run(5)
    assert parent.velocity.length() > 3.0


def test_a_chain_of_any_length_follows_and_is_destroyed_from_its_end() -> None:
    world = flat_world()
    parent: Actor = truck(world)
    ids = [parent.id]
    for _ in range(1500):
        parent = world.spawn("static.prop.box01", at(0.01), parent=parent)
        ids.append(parent.id)
    world.tick()
    first = world.actors[ids[0]]
    there = first.transform.transform(Location(15.0))
    assert astuple(parent.transform.location) == pytest.approx(astuple(there), abs=1e-6)
    assert (parent.velocity, parent.acceleration) == (first.velocity, first.acceleration)
    last = parent.transform
    first.destroy()
    world.tick()
    assert world.events.destroyed == ids[::-1]
    assert parent.transform == last
