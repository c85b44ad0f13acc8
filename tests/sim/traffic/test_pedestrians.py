"""Pedestrian navigation."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.sim.actors.moving import Walker, WalkerControl
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.signals import GREEN, RED
from carla_recap.sim.town.sidewalks import WalkwayGraph
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_world, light, spawn_car, spawn_walker

# Sidewalks on both sides of the road, a crossing between them, and an island far away.
NODES = [(80.0, 5.0), (100.0, 5.0), (100.0, -5.0), (80.0, -5.0), (500.0, 50.0), (510.0, 50.0)]
EDGES = [(0, 1), (1, 2), (2, 3), (4, 5)]


def graph() -> WalkwayGraph:
    nodes = np.array([(x, y, 0.0) for x, y in NODES])
    return WalkwayGraph(nodes, np.array(EDGES), np.array([False, True, False, False]))


def walker(world: World, x: float, y: float) -> Walker:
    return spawn_walker(world, at(x, y), "walker.pedestrian.0015")


def test_a_walker_reaches_its_destination_and_takes_another_one() -> None:
    world = flat_world(walks=graph())
    person = walker(world, 80.0, 5.0)
    person.destination = Location(80.0, -5.0)
    assert person.destination == Location(80.0, -5.0)
    way = []
    for _ in range(1200):
        world.tick()
        way.append(person.transform.location)
        if person.destination != Location(80.0, -5.0):
            break
    assert way[-1].distance(Location(80.0, -5.0, 0.9)) < 1
    assert max(place.x for place in way) == pytest.approx(100, abs=0.5)
    assert world.elapsed == pytest.approx(50 / 1.4, rel=0.1)


def test_a_walker_waits_until_cars_have_red() -> None:
    world = flat_world(walks=graph(), signals=[light(0, (0,), y=9.0)], phases=((0,),))
    person = walker(world, 95.0, 5.0)
    person.destination = Location(80.0, -5.0)
    world.traffic_lights[0].freeze()
    assert world.traffic_lights[0].state == GREEN
    world.run(20)
    assert person.transform.location.y == pytest.approx(5, abs=0.1)
    assert person.velocity.length() == 0
    world.traffic_lights[0].state = RED
    world.run(9)
    assert person.transform.location.y == pytest.approx(-5, abs=0.3)


@pytest.mark.parametrize("yaw", [0.0, 60.0])
def test_a_walker_lets_a_car_pass(yaw: float) -> None:
    world = flat_world(walks=graph())
    person = walker(world, 99.0, 5.0)
    person.destination = Location(80.0, -5.0)
    ahead = at(0.0, yaw=yaw).forward()
    car = spawn_car(world, at(100.0 - 54 * ahead.x, -54 * ahead.y, yaw), "vehicle.audi.tt", role_name="hero")
    for _ in range(400):  # its front is there in less than 4 s when the walker comes, its rear is not
        car.set_target_velocity(ahead * 12.0)
        world.tick()
        assert not world.events.collisions
        if person.transform.location.y < -4.5:
            break
    assert person.transform.location.y < -4
    assert car.transform.location.x > 100


@pytest.mark.parametrize(("x", "y", "yaw"), [(100.5, 0.0, 0.0), (99.7, 0.0, 180.0), (100.1, 0.5, 90.0), (100.0, 0.0, 40.0)])
def test_a_walker_goes_around_a_car_that_stands_on_the_crossing(x: float, y: float, yaw: float) -> None:
    world = flat_world(walks=graph())
    world.settings.collisions_of = "all"
    person = walker(world, 99.0, 5.0)
    person.destination = Location(80.0, -5.0)
    world.spawn("vehicle.audi.tt", at(x, y, yaw=yaw))
    for _ in range(500):
        world.tick()
        assert not world.events.collisions
    assert person.transform.location.y < -4


def test_a_walker_stops_for_a_car_that_drives_over_the_crossing() -> None:
    world = flat_world(walks=graph())
    person = walker(world, 100.0, 5.0)
    person.destination = Location(80.0, -5.0)
    car = spawn_car(world, at(99.5), "vehicle.audi.tt")
    stood = False
    for _ in range(200):
        car.set_target_velocity(Vector(0.4))
        world.tick()
        stood |= person.velocity.length() == 0 and 1 < person.transform.location.y < 2
    assert stood
    assert not person.has_fallen


def test_a_control_clears_the_destination() -> None:
    world = flat_world(walks=graph())
    person = walker(world, 80.0, 5.0)
    person.destination = Location(100.0, 5.0)
    person.apply_control(WalkerControl(Vector(-1.0), 1.0))
    assert person.destination is None
    world.run(2)
    assert person.transform.location.x == pytest.approx(78)
    person.destination = Location(100.0, 5.0)
    person.destination = None
    assert person.destination is None


@pytest.mark.parametrize(
    ("speed", "expected"), [("2.5", 2.5), ("2.5f", 2.5), ("0", 1.4), ("abc", 1.4), ("nan", 1.4), ("inf", 1.4), ("-3", 1.4)]
)
def test_a_walker_walks_at_the_speed_of_its_attribute_if_it_is_one(speed: str, expected: float) -> None:
    world = flat_world(walks=graph())
    person = world.spawn("walker.pedestrian.0015", at(80.0, 5.0), speed=speed)
    person.destination = Location(100.0, 5.0)
    world.run(2)
    assert person.velocity.length() == pytest.approx(expected)


def test_a_destination_that_cannot_be_reached_is_an_error() -> None:
    world = flat_world(walks=graph())
    person = walker(world, 80.0, 5.0)
    with pytest.raises(SimError, match=r"no sidewalk leads from \(80\.0, 5\.0\) to \(505\.0, 60\.0\)"):
        person.destination = Location(505.0, 60.0)
    with pytest.raises(SimError, match="Flat has no sidewalks"):
        walker(flat_world(), 0.0, 0.0).destination = Location(1.0, 1.0)


def test_destroyed_and_fallen_walkers_have_no_destination() -> None:
    world = flat_world(walks=graph())
    gone, fallen = walker(world, 80.0, 5.0), walker(world, 80.0, -5.0)
    for person in (gone, fallen):
        person.destination = Location(100.0, 5.0)
    gone.destroy()
    fallen.rows.fall(fallen.row)
    world.run(1)
    assert fallen.destination is None
    assert fallen.transform.location.x == 80


def test_a_walker_ignores_cars_that_are_hidden_below_a_crossing() -> None:
    world = flat_world(walks=graph())
    world.spawn("vehicle.tesla.model3", at(100.0, z=-50.0))
    person = walker(world, 100.0, 5.0)
    person.destination = Location(80.0, -5.0)
    for _ in range(150):
        world.tick()
        assert person.transform.location.x == pytest.approx(100.0) or person.transform.location.y < -4.5
    assert person.transform.location.y < -4.5


def test_walkers_walk_whatever_the_order_of_their_ids() -> None:
    world = flat_world(walks=graph())
    world.episode.ids.reserve(5000)
    places, ids = [at(*node) for node in NODES[:3]], (5000, 4000, 3000)
    walkers = [world.place("walker.pedestrian.0001", each, wanted_id=id) for each, id in zip(places, ids, strict=True)]
    for person in walkers:
        person.destination = Location(80.0, -5.0)
    world.run(4.0)
    assert [person.id for person in walkers] == [5000, 4000, 3000]
    gone = [person.transform.location.distance(start.location) for person, start in zip(walkers, places, strict=True)]
    assert min(gone) > 2.0
