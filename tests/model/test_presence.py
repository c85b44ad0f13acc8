"""Which actors are far from the height of the roads, by lights, signs and road users."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.model.lives import ActorLife
from carla_recap.model.presence import RoadHeights
from carla_recap.model.records import ActorKind, Spawn

M = 100.0  # cm
KINDS = {
    "vehicle": ActorKind.VEHICLE,
    "walker": ActorKind.WALKER,
    "traffic": ActorKind.TRAFFIC_LIGHT,
    "sensor": ActorKind.SENSOR,
}


def actor(id, type_id="vehicle.audi.tt", x=0.0, z=0.0):
    return ActorLife.of(Spawn(id, KINDS[type_id.split(".")[0]], x * M, 0.0, z * M, type_id=type_id), 0.0)


def hero(id):
    spawn = actor(id).spawn
    return ActorLife(id, "vehicle.audi.tt", "vehicle", "hero", 0.0, spawn=spawn)


def light(id, x=0.0, z=0.0):
    return actor(id, "traffic.traffic_light", x, z)


def away(actors, *places):
    """Return the ids of the actors that are away at each moment, given x and z of all with an id below 100, in m."""
    heights, ids = RoadHeights(actors), np.array([each.id for each in actors if each.id < 100])
    rows = np.array([[(x * M, 0.0, z * M, 0.0) for x, z in moment] for moment in places])
    return [ids[row].tolist() for row in heights.away(ids, rows)]


def test_a_car_parked_below_the_ground_is_away_until_it_is_set_on_the_road():
    actors = [actor(1), actor(2), light(100)]
    assert away(actors, [(0, 0.3), (20, -499)], [(5, 0.3), (20, -499)], [(10, 0.3), (20, 0.2)]) == [[2], [2], []]


@pytest.mark.parametrize("depth", [50, 100, 200, 500])
def test_every_depth_at_which_scenario_runner_hides_actors_is_away(depth):
    assert away([actor(1), actor(2)], [(0, 0.3), (10, 0.3 - depth)]) == [[2]]


def test_the_height_of_the_map_does_not_matter():
    actors = [actor(1), actor(2), light(100, z=2400)]
    assert away(actors, [(0, 2400), (20, 1901)], [(0, -430), (20, -430)]) == [[2], [1, 2]]


def test_bridges_are_there():
    actors = [actor(1), actor(2), actor(3), light(100)]
    assert away(actors, [(0, 0), (0, 8), (0, 25)], [(0, 0), (0, 28), (0, 52)]) == [[], []]


def test_a_hill_is_there_if_roads_lead_to_it():
    actors = [actor(1), actor(2), light(100)]
    assert away(actors, [(0, 0), (400, 100)], [(0, 0), (100, 100)]) == [[], [2]]


def test_a_hill_is_there_if_others_are_on_the_way_to_it():
    actors = [actor(id) for id in range(1, 6)]
    assert away(actors, [(id, 25 * id) for id in range(5)]) == [[]]


def test_lights_count_more_than_many_hidden_actors():
    actors = [actor(1), *(actor(id, "walker.pedestrian.0001") for id in range(2, 6)), light(100)]
    assert away(actors, [(0, 0.3), *[(5, -200)] * 4]) == [[2, 3, 4, 5]]


def test_without_lights_a_hero_counts_more_than_many_hidden_actors():
    actors = [hero(1), *(actor(id) for id in range(2, 6))]
    assert away(actors, [(0, 0.3), *[(5, -200)] * 4]) == [[2, 3, 4, 5]]


def test_without_lights_and_heroes_most_road_users_count():
    actors = [actor(id) for id in range(1, 5)]
    assert away(actors, [(0, 0), (5, 0), (9, 0), (5, 200)]) == [[4]]


def test_a_single_actor_is_there_wherever_it_is():
    assert away([actor(1)], [(0, -499)], [(0, 300)]) == [[], []]


def test_a_sensor_may_be_anywhere():
    actors = [actor(1), actor(2, "sensor.camera.rgb"), light(100)]
    assert away(actors, [(0, 0), (0, 400)]) == [[]]


def test_unknown_places_are_not_away():
    actors = [actor(1), actor(2), actor(3)]
    assert away(actors, [(0, 0), (np.nan, np.nan), (0, -499)], [(np.nan, np.inf), (np.nan, 0), (0, -1e12)]) == [[3], []]


def test_what_has_no_road_users_and_lights_is_there():
    assert RoadHeights().away(np.array([7, 8]), np.array([[(0.0, 0.0, 0.0), (0.0, 0.0, -5e4)]])).tolist() == [[False, False]]


def test_there_may_be_no_actors():
    assert RoadHeights().away(np.zeros(0, np.uint32), np.zeros((3, 0, 6))).shape == (3, 0)
