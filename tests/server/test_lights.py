"""Calls about traffic lights, and those ahead of vehicles."""

from __future__ import annotations

from dataclasses import replace

import carla
import numpy as np
import pytest

from carla_recap.server.snapshots import NO_LIGHT, LightsAhead
from tests.server.client import ticks
from tests.sim.flat import LENGTH, flat_town, lane
from tests.sim.flat import light as signal

RED, YELLOW, GREEN = carla.TrafficLightState.Red, carla.TrafficLightState.Yellow, carla.TrafficLightState.Green


@pytest.fixture
def lights(world: carla.World) -> list[carla.TrafficLight]:
    world.reset_all_traffic_lights()
    world.tick()
    return list(world.get_actors().filter("traffic.traffic_light"))


@pytest.mark.parametrize("whole", [True, False], ids=["by the world", "by a light, which the client takes for all"])
def test_time_stands_still_for_all(world: carla.World, lights: list[carla.TrafficLight], whole: bool) -> None:
    freeze = world.freeze_all_traffic_lights if whole else lights[0].freeze
    freeze(True)
    world.tick()
    elapsed = [light.get_elapsed_time() for light in lights]
    ticks(world, 4)
    assert all(light.is_frozen() for light in lights)
    assert [light.get_elapsed_time() for light in lights] == elapsed
    freeze(False)
    world.tick()
    assert not any(light.is_frozen() for light in lights)


def test_a_group_begins_again(world: carla.World, lights: list[carla.TrafficLight]) -> None:
    first = {light.id: light.state for light in lights}
    light = next(light for light in lights if light.state == GREEN)
    group = light.get_group_traffic_lights()
    assert light.id in [other.id for other in group]
    ticks(world, 210)
    assert light.state == YELLOW
    light.reset_group()
    world.tick()
    assert {other.id: other.state for other in group} == {other.id: first[other.id] for other in group}


def test_lights_are_found_from_the_map_and_back(world: carla.World, lights: list[carla.TrafficLight]) -> None:
    light = lights[0]
    assert world.get_traffic_light_from_opendrive_id(light.get_opendrive_id()).id == light.id
    (landmark,) = [
        mark for mark in world.get_map().get_all_landmarks_of_type("1000001") if mark.id == light.get_opendrive_id()
    ]
    assert world.get_traffic_light(landmark).id == light.id
    lane = light.get_affected_lane_waypoints()[0]
    assert light.id in [other.id for other in world.get_traffic_lights_from_waypoint(lane, 50.0)]
    inside = next(
        way
        for way in world.get_map().generate_waypoints(2.0)
        if way.is_junction and way.road_id == lane.next(5.0)[0].road_id
    )
    found = world.get_traffic_lights_in_junction(inside.get_junction().id)
    assert {other.id for other in found} == {other.id for other in light.get_group_traffic_lights()}
    assert light.get_pole_index() >= 0


def test_a_trigger_volume_is_where_one_stops(lights: list[carla.TrafficLight]) -> None:
    for light in lights:
        middle = light.get_transform().transform(light.trigger_volume.location)
        lanes = light.get_affected_lane_waypoints()
        mean = sum((lane.transform.location for lane in lanes), carla.Location()) / len(lanes)
        assert middle.distance_2d(mean) < 3.0
        stops = {(stop.road_id, stop.lane_id) for stop in light.get_stop_waypoints()}
        assert stops == {(lane.road_id, lane.lane_id) for lane in lanes}
        (box,) = light.get_light_boxes()
        assert box.location.distance_2d(light.get_location()) < 1e-3
        assert box.location.z > light.get_location().z + 2.0


def test_of_two_lights_ahead_the_nearer_one_counts() -> None:
    near, far = signal(0, (0,)), replace(signal(1, (0,)), stops=((0, 101.0),))  # stop lines at 95 m and 101 m
    for signals, rows in (([near, far], [0, 1]), ([far, near], [1, 0])):
        found = LightsAhead(flat_town(signals=signals)).at(np.zeros(5, np.int64), np.array([80.0, 84.0, 90.0, 96.0, 102.0]))
        assert found.tolist() == [NO_LIGHT, rows[0], rows[0], rows[1], NO_LIGHT]


def test_that_holds_on_the_lane_before() -> None:
    lanes = [replace(lane(), successors=(1,), predecessors=()), replace(lane(1), successors=(), predecessors=(0,))]
    near, far = replace(signal(0, ()), stops=((1, 3.0),)), replace(signal(1, ()), stops=((1, 7.0),))
    for signals, rows in (([near, far], [0, 1]), ([far, near], [1, 0])):
        ahead = LightsAhead(flat_town(lanes=lanes, signals=signals))
        found = ahead.at(np.array([0, 0, 0, 1, 1]), np.array([LENGTH - 10, LENGTH - 8, LENGTH - 4, 1, 5]))
        assert found.tolist() == [NO_LIGHT, rows[0], rows[0], rows[0], rows[1]]
