"""Collisions: which actors, the impulses, and the motion afterwards."""

from __future__ import annotations

from math import hypot

import numpy as np
import pytest

from carla_recap.sim.actors.moving import WalkerControl
from carla_recap.sim.geometry import Vector
from tests.sim.flat import at, collisions, flat_world, light, spawn_car, spawn_walker


def test_a_rear_end_collision_is_reported_for_the_hero_and_moves_both() -> None:
    world = flat_world()
    hero = spawn_car(world, at(0.0), speed=15.0, role_name="hero")
    other = spawn_car(world, at(10.0))
    found = collisions(world, 1.0)
    assert {(c.actor1, c.actor2) for c in found} == {(hero.id, other.id)}
    first = found[0]
    assert first.hero1
    assert not first.hero2
    assert first.number == 0
    assert first.location.x == pytest.approx(10.0 - 2.4, abs=0.8)
    assert first.impulse.x < 0
    assert hero.velocity.x < 9
    assert other.velocity.x > 6


def test_the_impulses_are_the_changes_of_momentum() -> None:
    world = flat_world()
    world.settings.collisions_of = "all"
    a, b = spawn_car(world, at(0.0), speed=12.0), spawn_car(world, at(14.0), "vehicle.carlamotors.firetruck")
    before = a.velocity.x
    while not world.events.collisions:
        before = a.velocity.x
        world.tick()
        assert world.elapsed < 5.0
    impulses = {(c.actor1, c.actor2): c.impulse.x for c in world.events.collisions}
    assert impulses[a.id, b.id] == pytest.approx((a.velocity.x - before) * a.physics_control.mass, rel=0.05)
    assert impulses[a.id, b.id] == pytest.approx(-impulses[b.id, a.id])
    assert 0 < b.velocity.x < 3 < before


def test_collisions_are_reported_for_heroes_and_actors_with_a_sensor_alone() -> None:
    for sensor in (False, True):
        world = flat_world()
        one, other = spawn_car(world, at(0.0), speed=10.0), spawn_car(world, at(8.0))
        if sensor:
            world.spawn("sensor.other.collision", at(0.0), parent=one)
            world.spawn("sensor.camera.rgb", at(0.0), parent=other)
        found = collisions(world, 1.0)
        assert {(c.actor1, c.actor2) for c in found} == ({(one.id, other.id)} if sensor else set())


def test_a_collision_of_two_heroes_is_reported_for_both_once_in_a_tick() -> None:
    world = flat_world()
    a = spawn_car(world, at(0.0), "vehicle.audi.tt", speed=10.0, role_name="hero")
    b = spawn_car(world, at(8.0), "vehicle.audi.tt", role_name="hero")
    world.settings.max_substep_delta_time = 0.01
    for _ in range(20):
        world.tick()
        pairs = [(c.actor1, c.actor2) for c in world.events.collisions]
        assert len(pairs) == len(set(pairs))
        if pairs:
            assert sorted(pairs) == [(a.id, b.id), (b.id, a.id)]
            break
    else:
        pytest.fail("they never met")


def test_a_barrier_stops_even_a_fast_car_and_is_no_actor() -> None:
    world = flat_world(barriers=[np.array(((50.0, -30.0, 0.0), (50.0, 30.0, 0.0)))])
    hero = spawn_car(world, at(0.0), speed=60.0, role_name="hero")
    found = collisions(world, 2.0)
    assert {(c.actor1, c.actor2) for c in found} == {(hero.id, None)}
    assert hero.transform.location.x < 50


def test_a_light_pole_is_an_actor() -> None:
    world = flat_world(signals=[light(0, (0,))], phases=((0,),))
    (pole,) = world.traffic_lights
    hero = spawn_car(world, at(80.0, 3.0), speed=15.0, role_name="hero")
    found = collisions(world, 2.0)
    assert (found[0].actor1, found[0].actor2) == (hero.id, pole.id)


def test_a_prop_stands_firm() -> None:
    world = flat_world()
    prop = world.spawn("static.prop.container", at(30.0))
    hero = spawn_car(world, at(0.0), speed=10.0, role_name="hero")
    assert (hero.id, prop.id) in {(c.actor1, c.actor2) for c in collisions(world, 4.0)}
    assert prop.transform == at(30.0)
    assert hero.transform.location.x < 30


def test_a_walker_that_is_hit_falls_and_stays() -> None:
    world = flat_world()
    walker = spawn_walker(world, at(20.0))
    walker.apply_control(WalkerControl(Vector(0.0, 1.0), 0.5))
    hero = spawn_car(world, at(5.0, 1.0), speed=10.0, role_name="hero")
    found = collisions(world, 1.5)
    assert {(c.actor1, c.actor2) for c in found} == {(hero.id, walker.id)}
    assert walker.has_fallen
    world.run(5)
    assert walker.velocity.length() == 0
    place = walker.transform
    world.run(1)
    assert walker.transform == place
    assert hero.transform.location.x > 20
    walker.transform = at(60.0, 8.0, yaw=30.0)
    world.run(1)
    assert (walker.transform.rotation.pitch, walker.transform.location.z) == (place.rotation.pitch, place.location.z)


def test_a_slow_push_lets_a_walker_stand() -> None:
    world = flat_world()
    walker = spawn_walker(world, at(20.0))
    spawn_car(world, at(17.0), speed=1.0)
    world.run(3)
    assert not walker.has_fallen
    assert walker.transform.location.x > 20


def test_a_vehicle_that_is_hit_off_centre_turns() -> None:
    world = flat_world()
    hit = spawn_car(world, at(0.0, yaw=90.0))
    spawn_car(world, at(-15.0, 1.8), speed=15.0)
    world.run(3)
    assert abs(hit.transform.rotation.yaw - 90) > 10


def test_a_vehicle_without_collisions_is_passed_through() -> None:
    world = flat_world()
    hero = spawn_car(world, at(0.0), speed=10.0, role_name="hero")
    ghost = spawn_car(world, at(8.0))
    ghost.set_collisions(False)
    assert not collisions(world, 1.5)
    assert hero.transform.location.x > 12
    assert ghost.transform.location.x == 8


def test_a_parked_car_that_is_hit_wakes_up() -> None:
    world = flat_world()
    parked = spawn_car(world, at(40.0))
    world.run(3)
    spawn_car(world, at(20.0), speed=12.0)
    world.run(2.5)
    assert hypot(parked.velocity.x, parked.velocity.y) > 1
    assert parked.transform.location.x > 40


def test_a_car_whose_physics_is_switched_off_stays_where_its_body_is() -> None:
    """Chipmunk pushes overlapping bodies apart in the step after the one in which it finds them."""
    world = flat_world()
    cars = [world.place("vehicle.tesla.model3", at(x)) for x in (20.0, 21.0)]
    world.tick()
    for car in cars:
        car.set_simulate_physics(False)
    spawn_car(world, at(100.0), speed=12.0)
    world.run(0.5)
    for position, body in zip(world.vehicles.position, world.vehicles.bodies, strict=True):
        assert body.position == pytest.approx(tuple(position[:2]), abs=1e-6)


@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, -90.0), (180.0, 90.0)])
def test_a_walker_that_is_hit_lies_on_its_face_or_on_its_back(yaw: float, pitch: float) -> None:
    world = flat_world()
    walker = spawn_walker(world, at(20.0, z=0.9, yaw=yaw))
    spawn_car(world, at(5.0), speed=10.0)
    world.run(3.0)
    assert walker.has_fallen
    assert walker.transform.rotation.pitch == pitch
    assert walker.transform.rotation.yaw == pytest.approx(yaw)
    assert walker.transform.location.z == pytest.approx(walker.box.extent.x, abs=0.01)
    low, high = walker.heights()
    assert (low, high) == pytest.approx((0.0, 2 * walker.box.extent.x), abs=0.02)
