"""Which actors are far from the height of the roads, by lights, signs and road users."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.model.lives import ActorLife
from carla_recap.model.presence import RoadHeights
from carla_recap.model.records import ActorKind, Spawn, attributes

M = 100.0  # cm
KINDS = {
    "vehicle": ActorKind.VEHICLE,
    "walker": ActorKind.WALKER,
    "traffic": ActorKind.TRAFFIC_LIGHT,
    "sensor": ActorKind.SENSOR,
}


def actor(id, type_id="vehicle.audi.tt", x=0.0, z=0.0, role=""):
    kind = KINDS[type_id.partition(".")[0]]
    return ActorLife.of(Spawn(id, kind, x * M, 0.0, z * M, type_id=type_id, attributes=attributes(role_name=role)), 0.0)


CARS = [actor(id) for id in range(1, 6)]
WALKERS = [actor(id, "walker.pedestrian.0001") for id in range(2, 6)]
LIGHT, HIGH_LIGHT = actor(100, "traffic.traffic_light"), actor(100, "traffic.traffic_light", z=2400)
HIDDEN = [(0, 0.3), *[(5, -200)] * 4]


@pytest.mark.parametrize(
    ("actors", "places", "away"),
    [
        # parked below the ground until it is set on the road
        ([*CARS[:2], LIGHT], [[(0, 0.3), (20, -499)], [(5, 0.3), (20, -499)], [(10, 0.3), (20, 0.2)]], [[2], [2], []]),
        # every depth at which ScenarioRunner hides actors
        *((CARS[:2], [[(0, 0.3), (10, 0.3 - depth)]], [[2]]) for depth in (50, 100, 200, 500)),
        # a map far above the origin
        ([*CARS[:2], HIGH_LIGHT], [[(0, 2400), (20, 1901)], [(0, -430), (20, -430)]], [[2], [1, 2]]),
        # bridges
        ([*CARS[:3], LIGHT], [[(0, 0), (0, 8), (0, 25)], [(0, 0), (0, 28), (0, 52)]], [[], []]),
        # a hill, if roads lead to it, or others are on the way to it
        ([*CARS[:2], LIGHT], [[(0, 0), (400, 100)], [(0, 0), (100, 100)]], [[], [2]]),
        (CARS, [[(id, 25 * id) for id in range(5)]], [[]]),
        # lights count more than many hidden actors, else a hero, else most road users
        ([CARS[0], *WALKERS, LIGHT], [HIDDEN], [[2, 3, 4, 5]]),
        ([actor(1, role="hero"), *CARS[1:]], [HIDDEN], [[2, 3, 4, 5]]),
        (CARS[:4], [[(0, 0), (5, 0), (9, 0), (5, 200)]], [[4]]),
        # a single actor, and a sensor, wherever they are
        (CARS[:1], [[(0, -499)], [(0, 300)]], [[], []]),
        ([CARS[0], actor(2, "sensor.camera.rgb"), LIGHT], [[(0, 0), (0, 400)]], [[]]),
        # unknown places
        (CARS[:3], [[(0, 0), (np.nan, np.nan), (0, -499)], [(np.nan, np.inf), (np.nan, 0), (0, -1e12)]], [[3], []]),
    ],
)
def test_what_is_far_from_the_height_of_the_roads_is_away(actors, places, away):
    """Places are x and z of all actors with an id below 100, at each moment, in m."""
    heights, ids = RoadHeights(actors), np.array([each.id for each in actors if each.id < 100])
    rows = np.array([[(x * M, 0.0, z * M, 0.0) for x, z in moment] for moment in places])
    assert [ids[row].tolist() for row in heights.away(ids, rows)] == away


def test_what_has_no_road_users_and_lights_is_there():
    assert RoadHeights().away(np.array([7, 8]), np.array([[(0.0, 0.0, 0.0), (0.0, 0.0, -5e4)]])).tolist() == [[False, False]]


def test_there_may_be_no_actors():
    assert RoadHeights().away(np.zeros(0, np.uint32), np.zeros((3, 0, 6))).shape == (3, 0)
