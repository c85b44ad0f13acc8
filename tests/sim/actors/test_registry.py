"""The actors of an episode, their motion and their traffic work without a world."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.sim.actors.blueprints import standard_library
from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.actors.registry import ActorIds, ActorRegistry
from carla_recap.sim.actors.stepping import ActorMotion
from carla_recap.sim.geometry import Transform
from carla_recap.sim.settings import Clock, Settings
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.traffic.controllers import Traffic

DELTA = 0.05


@pytest.fixture
def registry() -> ActorRegistry:
    registry = ActorRegistry(load_town(), Clock(delta=DELTA), Settings(), standard_library(), ActorIds())
    registry.traffic = Traffic(registry, np.random.default_rng(0), [])
    return registry


def tick(registry: ActorRegistry, motion: ActorMotion) -> None:
    collisions = motion.advance(DELTA)
    registry.clock.advance()
    registry.end_tick(collisions)


def test_the_autopilot_drives_the_vehicles_of_a_registry(registry: ActorRegistry) -> None:
    controllers = []
    registry.traffic = Traffic(registry, np.random.default_rng(0), controllers)
    place = registry.town.spawn_points[0]
    car = registry.place("vehicle.tesla.model3", place, None, {})
    assert isinstance(car, Vehicle)
    car.set_autopilot()
    motion = ActorMotion(registry)
    for _ in range(100):
        for controller in controllers:
            controller.step(DELTA)
        tick(registry, motion)
    assert car.velocity.length() > 3
    assert car.transform.location.distance(place.location) > 5


def test_walkers_of_a_registry_have_destinations(registry: ActorRegistry) -> None:
    start, goal = registry.traffic.pedestrians.random_place(), registry.traffic.pedestrians.random_place()
    walker = registry.place("walker.pedestrian.0001", Transform(start), None, {})
    assert isinstance(walker, Walker)
    walker.destination = goal
    assert walker.destination == goal
    walker.destination = None
    assert walker.destination is None


def test_events_are_pending_until_the_end_of_the_tick(registry: ActorRegistry) -> None:
    place = registry.town.spawn_points[0]
    car = registry.place("vehicle.tesla.model3", place, None, {})
    assert isinstance(car, Vehicle)
    car.set_door(0, True)
    assert registry.events.spawned == []
    assert registry.pending.spawned[-1] is car
    tick(registry, ActorMotion(registry))
    assert registry.events.spawned[-1] is car
    assert registry.events.doors == [(car.id, 0, True)]
    assert registry.pending.doors == []


def test_a_closed_registry_has_no_live_actors(registry: ActorRegistry) -> None:
    car = registry.place("vehicle.tesla.model3", registry.town.spawn_points[0], None, {})
    registry.close()
    assert not car.is_alive
    assert not registry.spectator.is_alive


def test_controllers_of_traffic_end_with_their_episode(registry: ActorRegistry) -> None:
    other = object()
    controllers = [other]
    traffic = Traffic(registry, np.random.default_rng(0), controllers)
    assert controllers == [other, traffic.autopilot, traffic.pedestrians]
    traffic.end()
    assert controllers == [other]
