"""Calls about episodes and the world around the actors, and those that are accepted although there is nothing to be done."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import carla
import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.scene.materials import Tag
from carla_recap.server.snapshots import NO_LIGHT, LaneTracker, LightsAhead
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World
from tests.server.client import FAR, place, spawn, ticks
from tests.server.inside import Inside
from tests.sim.flat import LENGTH, at, flat_town, flat_world, lane, spawn_car
from tests.sim.flat import light as signal
from tests.sim.two_levels import BRIDGE, two_levels

if TYPE_CHECKING:
    from pathlib import Path


def test_rays_and_projections_meet_their_level(tmp_path: Path) -> None:
    inside = Inside(world=World(str(two_levels(tmp_path))))
    car, _ = (inside.world.spawn("vehicle.tesla.model3", at(0.0, 1.75, z=z + 0.3)) for z in (0.0, BRIDGE))
    inside.host.tick()
    height = 2 * car.box.extent.z
    for top, expected in ((12.0, [BRIDGE + height, BRIDGE]), (5.0, [height, 0.0])):
        met = inside.call("cast_ray", [0.0, 1.75, top], [0.0, 1.75, expected[-1] - 1])
        assert [location[2] for location, _ in met] == pytest.approx(expected, abs=0.05)
        assert [label for _, label in met] == [Tag.CAR, Tag.ROADS]
    assert inside.call("cast_ray", [0.0, 1.75, 12.0], [0.0, 1.75, 20.0]) == []
    _, (location, _) = inside.call("project_point", [20.0, 1.75, 3.0], [0.0, 0.0, -1.0], 10.0)
    assert location[2] == pytest.approx(0.0, abs=0.02)
    with pytest.raises(RecapError, match="expected a direction"):
        inside.call("project_point", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0)


def test_places_are_projected(world: carla.World) -> None:
    above = world.get_map().get_spawn_points()[3].location + carla.Location(z=5.0)
    point = world.ground_projection(above, 10.0)
    assert point.label == carla.CityObjectLabel.Roads
    assert (point.location.x, point.location.y, point.location.z) == pytest.approx((above.x, above.y, 0.0), abs=0.01)
    assert world.ground_projection(carla.Location(900.0, 900.0, 5.0), 10.0).label == carla.CityObjectLabel.Terrain
    assert world.ground_projection(above, 2.0) is None
    assert world.project_point(above, carla.Vector3D(0.0, 0.0, 1.0), 100.0) is None


def test_the_map_has_lights_and_signs_by_itself(world: carla.World) -> None:
    lights, signs = (world.get_actors().filter(pattern) for pattern in ("traffic.traffic_light", "traffic.*"))
    assert len(world.get_level_bbs(carla.CityObjectLabel.TrafficLight)) == len(lights)
    assert len(world.get_level_bbs()) == len(world.get_names_of_all_objects()) == len(signs)
    assert world.get_level_bbs(carla.CityObjectLabel.Buildings) == []
    objects = world.get_environment_objects(carla.CityObjectLabel.TrafficLight)
    assert {thing.id for thing in objects} == {light.id for light in lights}
    assert {thing.type for thing in objects} == {carla.CityObjectLabel.TrafficLight}
    world.enable_environment_objects({objects[0].id}, False)


def test_unsupported_calls_are_accepted(world: carla.World) -> None:
    world.debug.draw_line(carla.Location(), carla.Location(1.0, 1.0, 1.0))
    world.load_map_layer(carla.MapLayer.Buildings)
    texture = carla.TextureColor(2, 2)
    world.apply_color_texture_to_object("house", carla.MaterialParameter.Diffuse, texture)
    world.set_imui_sensor_gravity(1.62)
    assert world.get_imui_sensor_gravity() == pytest.approx(9.81)
    lights = world.get_lightmanager()
    assert lights.get_all_lights() == []
    world.set_annotations_traverse_translucency(True)
    car, walker = spawn(world), spawn(world, "walker.pedestrian.0001", FAR)
    camera = place(world, "sensor.camera.rgb", carla.Transform(), car)
    world.tick()
    camera.enable_for_ros()
    assert camera.is_enabled_for_ros() is False
    camera.set_ignored_vehicles([car.id])
    assert walker.get_bones().bone_transforms == []
    walker.set_bones(carla.WalkerBoneControlIn([("crl_hand__R", carla.Transform())]))
    walker.get_pose_from_animation()
    car.show_debug_telemetry(True)
    car.set_wheel_steer_direction(carla.VehicleWheelLocation.FL_Wheel, 10.0)
    car.set_wheel_pitch_angle(carla.VehicleWheelLocation.FL_Wheel, 10.0)
    car.enable_carsim("")
    car.enable_chrono_physics(1, 0.1, "", "", "", "")
    assert car.get_wheel_pitch_angle(carla.VehicleWheelLocation.FL_Wheel) == 0.0
    assert (car.get_bone_names(), car.get_component_names(), car.get_socket_names()) == ([], [], [])
    assert car.get_bone_world_transforms() == car.get_bone_relative_transforms() == []
    assert car.get_socket_world_transforms() == car.get_socket_relative_transforms() == []
    assert len(car.get_vehicle_bone_world_transforms()) == 0
    assert car.get_component_world_transform("x").location.distance(car.get_location()) < 1e-3
    assert car.get_component_relative_transform("x") == carla.Transform()
    assert world.tick() > 0


TEXT = load_town().opendrive


def test_files_are_not_read_by_their_paths(client: carla.Client, tmp_path: Path) -> None:
    (tmp_path / "secret.xodr").write_text(TEXT)
    with pytest.raises(RuntimeError, match="there is no such map"):
        client.load_world(str(tmp_path / "secret.xodr"))


def test_a_new_episode_has_no_actors_of_the_last_one_and_never_their_ids(client: carla.Client, world: carla.World) -> None:
    before, frame = spawn(world).id, world.tick()
    world = client.reload_world(reset_settings=False)
    assert world.tick() > frame
    assert not world.get_actors().filter("vehicle.*")
    assert spawn(world).id > before


@pytest.mark.parametrize("reset", [True, False])
def test_settings_are_reset_on_request(client: carla.Client, reset: bool) -> None:
    settings = client.reload_world(reset_settings=reset).get_settings()
    assert settings.synchronous_mode is not reset
    assert settings.fixed_delta_seconds == (None if reset else pytest.approx(0.05))


def test_a_map_that_a_client_sends_is_loaded(client: carla.Client) -> None:
    world = client.generate_opendrive_world(TEXT)
    assert world.get_map().name.endswith("OpenDriveMap")
    topology = {(entry.road_id, entry.lane_id) for entry, _ in world.get_map().get_topology()}
    assert len(world.get_map().get_spawn_points()) == len(topology)
    world = client.reload_world()
    assert world.get_map().name.endswith("OpenDriveMap")
    client.load_world("Brickfield")


def test_what_is_no_map_is_refused(client: carla.Client, world: carla.World) -> None:
    with pytest.raises(RuntimeError, match="OpenDriveMap"):
        client.generate_opendrive_world("<OpenDRIVE>nothing here")
    world.tick()


# --- traffic lights --------------------------------------------------------------------------------------------------------


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


def test_between_look_ups_a_place_on_a_lane_goes_on_with_its_vehicle() -> None:
    world = flat_world()
    car = spawn_car(world, at(20.0))
    tracker = LaneTracker(world.town, world.vehicles)
    for x in (20.0, 22.0, 30.0):
        car.transform = at(x)
        lanes, s = tracker.positions()
        assert (lanes.tolist(), s.tolist()) == ([0], [pytest.approx(x)])
