"""Walkers that the client's own `controller.ai.walker` steers over the navigation mesh of the server."""

from __future__ import annotations

import carla
import numpy as np
import pytest

from carla_recap.sim.town.loading import load_town

WALKERS = 8
SPEED = 1.4  # m/s
SECONDS = 30
FROM_THE_MIDDLE = 3.0  # m: so far from the middle of a sidewalk they walk, at most, at corners


@pytest.fixture
def steered(world: carla.World) -> list[carla.Walker]:
    """Walkers on their way to random places."""
    world.set_pedestrians_seed(1)
    world.set_pedestrians_cross_factor(0.0)
    blueprints = world.get_blueprint_library()
    kinds = blueprints.filter("walker.pedestrian.*")
    walkers = []
    while len(walkers) < WALKERS:
        place = world.get_random_location_from_navigation()
        place.z += 1
        walker = world.try_spawn_actor(kinds[len(walkers)], carla.Transform(place))
        if walker is not None:
            walkers.append(walker)
    world.tick()
    controller = blueprints.find("controller.ai.walker")
    controllers = [world.spawn_actor(controller, carla.Transform(), attach_to=walker) for walker in walkers]
    world.tick()
    for each in controllers:
        each.start()
        each.go_to_location(world.get_random_location_from_navigation())
        each.set_max_speed(SPEED)
    return walkers


def test_walkers_walk_on_sidewalks_and_crossings(world: carla.World, steered: list[carla.Walker]) -> None:
    tracks = []
    for _ in range(20 * SECONDS):
        world.tick()
        tracks.append([(place.x, place.y, place.z) for place in (walker.get_location() for walker in steered)])
    places = np.array(tracks)
    town = load_town()
    walks = town.walks
    starts, ends = walks.nodes[walks.edges].transpose(1, 0, 2)[..., :2]
    for number, walker in enumerate(steered):
        track = places[20:, number]
        walked = np.linalg.norm(np.diff(track, axis=0), axis=1)
        assert walked.max() < 1.2 * SPEED / 20
        assert walked.sum() > SPEED * SECONDS / 4  # they wait before crossings
        for x, y, _ in track[::20]:
            share = ((x, y) - starts) * (ends - starts)
            share = np.clip(share.sum(axis=1) / ((ends - starts) ** 2).sum(axis=1), 0, 1)
            assert np.hypot(*((x, y) - starts - share[:, None] * (ends - starts)).T).min() < FROM_THE_MIDDLE
        ground = town.height(track[:, 0], track[:, 1])
        assert np.abs(track[:, 2] - ground - walker.bounding_box.extent.z).max() < 0.5
    assert np.linalg.norm(places[-1] - places[0], axis=1).max() > SPEED * SECONDS / 3
