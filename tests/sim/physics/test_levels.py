"""Whether what is above and below each other stays apart."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from carla_recap.sim.actors.moving import VehicleControl
from carla_recap.sim.errors import SpawnError
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.town.junctions import Signal, SignalKind
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.world import World
from tests.sim.flat import at, collisions, flat_world, spawn_car
from tests.sim.two_levels import BRIDGE, two_levels


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Town:
    return load_town(two_levels(tmp_path_factory.mktemp("maps")))


@pytest.mark.parametrize("depth", [-500.0, -50.0, 105.0])
def test_a_parked_car_far_below_or_above_the_road_stops_no_car(depth: float) -> None:
    world = flat_world()
    parked = spawn_car(world, at(40.0, z=depth))
    parked.set_simulate_physics(False)
    hero = spawn_car(world, at(20.0), speed=15.0, role_name="hero")
    assert not collisions(world, 3.0)
    assert hero.transform.location.x > 55
    assert parked.transform == at(40.0, z=depth)


@pytest.mark.parametrize("name", ["vehicle.tesla.model3", "walker.pedestrian.0001", "static.prop.container"])
def test_an_actor_can_be_spawned_and_hidden_below_a_car(name: str) -> None:
    world = flat_world()
    hero = spawn_car(world, at(20.0), role_name="hero")
    with pytest.raises(SpawnError):
        world.spawn(name, at(20.0, z=0.5))
    hidden = world.spawn(name, at(20.0, z=-50.0))
    assert not collisions(world, 0.5)
    assert hidden.transform.location.z == -50
    assert hero.transform.location.x == pytest.approx(20.0)


def test_an_actor_far_above_the_road_falls_on_it() -> None:
    world = flat_world()
    high = spawn_car(world, at(40.0, z=100.0))
    world.run(1.0)
    assert high.transform.location.z == pytest.approx(100 - 9.81 / 2, abs=0.5)
    assert high.velocity.z == pytest.approx(-9.81, abs=0.5)
    world.run(5.0)
    assert high.transform.location.z == 0
    assert high.velocity.z == 0


def test_a_car_hidden_by_teleport_and_brought_back_collides_again() -> None:
    world = flat_world()
    other = spawn_car(world, at(30.0))
    world.run(1.0)
    other.transform = at(30.0, z=-200.0)
    hero = spawn_car(world, at(10.0), speed=10.0, role_name="hero")
    assert not collisions(world, 3.0)
    other.transform = at(hero.transform.location.x + 8)
    assert collisions(world, 3.0)


def test_cars_pass_over_debris_and_not_over_a_cone() -> None:
    world = flat_world()
    debris = world.spawn("static.prop.dirtdebris01", at(30.0))
    assert debris.box.extent.z < 0.1
    hero = spawn_car(world, at(10.0), speed=10.0, role_name="hero")
    assert not collisions(world, 3.0)
    world.spawn("static.prop.constructioncone", at(hero.transform.location.x + 10))
    hero.set_target_velocity(Vector(10.0))
    assert collisions(world, 3.0)


def test_the_autopilot_ignores_what_is_hidden_below_the_road_and_what_is_flat() -> None:
    world = flat_world()
    world.spawn("static.prop.dirtdebris01", at(60.0))
    spawn_car(world, at(80.0, z=-50.0)).set_simulate_physics(False)
    driven = spawn_car(world, at(20.0))
    driven.set_autopilot()
    world.run(15.0)
    assert driven.transform.location.x > 100


@pytest.mark.filterwarnings("ignore:of a map of")
@pytest.mark.parametrize("far", [0.0, 3000.0, 20000.0])
def test_the_height_at_each_lane_is_its_own(tmp_path: Path, far: float) -> None:
    town = load_town(two_levels(tmp_path, far))
    for lane in town.lanes:
        x, y, z = lane.points.T
        beside = x - np.sin(lane.heading), y + np.cos(lane.heading)
        assert town.height(*beside, z + 0.1) == pytest.approx(z, abs=0.01)


def test_a_bridge_has_room_for_a_car_above_another(town: Town) -> None:
    world = World(town, seed=1, date=0)
    world.settings.collisions_of = "all"
    lower, upper = spawn_car(world, at(0.0, 1.75, z=0.3)), spawn_car(world, at(0.0, 1.75, 90.0, z=BRIDGE + 0.3))
    assert not collisions(world, 1.0)
    assert lower.transform.location.z == pytest.approx(0.0, abs=0.05)
    assert upper.transform.location.z == pytest.approx(BRIDGE, abs=0.05)
    with pytest.raises(SpawnError, match=repr(upper).replace("(", r"\(").replace(")", r"\)")):
        spawn_car(world, at(0.0, 1.75, z=BRIDGE + 0.5))


def test_traffic_on_two_levels_stays_level_and_apart(town: Town) -> None:
    world = World(town, seed=3, date=0)
    world.settings.collisions_of = "all"
    cars = [spawn_car(world, place) for place in town.spawn_points[::4]]
    for vehicle in cars:
        vehicle.set_autopilot()
    crossings = 0
    for _ in range(800):
        world.tick()
        fleet = world.vehicles
        assert not world.events.collisions
        assert np.abs(fleet.rotation[:, 0]).max() < 20
        assert np.abs(fleet.velocity[:, 2]).max() < 2
        near = np.flatnonzero(np.hypot(*fleet.position[:, :2].T) < 8)
        crossings += any(abs(fleet.position[a, 2] - fleet.position[b, 2]) > 4 for a, b in combinations(near, 2))
    assert crossings > 10
    assert np.hypot(*fleet.velocity[:, :2].T).mean() > 3


def test_a_car_is_pitched_as_the_road(town: Town) -> None:
    pitches = []
    for lane in town.lanes:
        slopes = np.degrees(np.arctan(np.gradient(lane.points[:, 2], lane.s)))
        point = int(np.abs(slopes).argmax())
        (x, y, z), yaw = lane.points[point].tolist(), np.degrees(lane.heading[point]).item()
        world = World(town, seed=1, date=0)
        parked = spawn_car(world, at(x, y, yaw, z=z))
        world.tick()
        pitches.append(parked.transform.rotation.pitch)
        assert pitches[-1] == pytest.approx(slopes[point], abs=0.1)
        assert parked.transform.location.z == pytest.approx(z, abs=0.01)
    assert min(pitches) < -1.5
    assert max(pitches) > 1.5


def test_a_car_that_leaves_a_bridge_sideways_does_not_stand_on_its_nose(town: Town) -> None:
    world = World(town, seed=1, date=0)
    falling = spawn_car(world, at(-1.75, 30.0, 180.0, z=BRIDGE), speed=12.0)
    falling.apply_control(VehicleControl(throttle=0.5))
    for _ in range(100):
        world.tick()
        assert abs(falling.transform.rotation.pitch) < 30


def test_a_walker_below_the_bridge_stays_below(town: Town) -> None:
    world = World(town, seed=1, date=0)
    walker = world.spawn("walker.pedestrian.0001", at(0.0, 4.5, z=1.0))
    above = world.spawn("walker.pedestrian.0001", at(4.5, 0.0, z=BRIDGE + 1.0))
    world.run(0.5)
    assert walker.transform.location.z == pytest.approx(0.9, abs=0.05)
    assert above.transform.location.z == pytest.approx(BRIDGE + 0.9, abs=0.05)
    assert walker.transform.location.distance(Location(0.0, 4.5, 0.9)) < 0.1


@pytest.mark.parametrize(("z", "has_pole"), [(0.5, True), (BRIDGE + 3.0, False)])
def test_a_sign_has_a_pole_unless_it_is_over_the_road_of_its_own_level(town: Town, z: float, has_pole: bool) -> None:
    under_the_bridge = at(1.0, 6.0, z=z)  # beside the lower road
    sign = Signal(0, "0", SignalKind.STOP, under_the_bridge, None, 1, "0", (), ())
    world = World(replace(town, signals=[sign]), seed=1, date=0)
    world.settings.collisions_of = "all"
    hero = spawn_car(world, at(-12.0, 6.0), speed=10.0)
    found = collisions(world, 1.5)
    assert bool(found) is has_pole
    assert (hero.transform.location.x > 0) is not has_pole
