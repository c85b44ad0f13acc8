"""Calls about episodes and the world around the actors, and those that are accepted although there is nothing to be done."""

from __future__ import annotations

from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.errors import RecapError
from carla_recap.scene.materials import Tag
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World
from tests.server.client import FAR, place, spawn
from tests.server.inside import Inside
from tests.sim.flat import at
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
    here, there = carla.Location(), carla.Location(1.0, 1.0, 1.0)
    world.debug.draw_point(here)
    world.debug.draw_line(here, there)
    world.debug.draw_arrow(here, there)
    world.debug.draw_box(carla.BoundingBox(here, carla.Vector3D(1, 1, 1)), carla.Rotation())
    world.debug.draw_string(here, "text")
    world.load_map_layer(carla.MapLayer.Buildings)
    world.unload_map_layer(carla.MapLayer.All)
    texture = carla.TextureColor(2, 2)
    world.apply_color_texture_to_object("house", carla.MaterialParameter.Diffuse, texture)
    world.apply_float_color_texture_to_object("house", carla.MaterialParameter.Diffuse, carla.TextureFloatColor(2, 2))
    world.set_imui_sensor_gravity(1.62)
    assert world.get_imui_sensor_gravity() == pytest.approx(9.81)
    lights = world.get_lightmanager()
    assert lights.get_all_lights() == []
    lights.turn_on([])
    lights.set_day_night_cycle(False)
    world.set_annotations_traverse_translucency(True)
    car, walker = spawn(world), spawn(world, "walker.pedestrian.0001", FAR)
    camera = place(world, "sensor.camera.rgb", carla.Transform(), car)
    world.tick()
    camera.enable_for_ros()
    assert camera.is_enabled_for_ros() is False
    camera.disable_for_ros()
    camera.set_ignored_vehicles([car.id])
    assert walker.get_bones().bone_transforms == []
    walker.set_bones(carla.WalkerBoneControlIn([("crl_hand__R", carla.Transform())]))
    walker.blend_pose(0.5)
    walker.show_pose()
    walker.hide_pose()
    walker.get_pose_from_animation()
    car.set_enable_gravity(False)
    car.show_debug_telemetry(True)
    car.set_wheel_steer_direction(carla.VehicleWheelLocation.FL_Wheel, 10.0)
    car.set_wheel_pitch_angle(carla.VehicleWheelLocation.FL_Wheel, 10.0)
    car.enable_carsim("")
    car.use_carsim_road(True)
    car.enable_chrono_physics(1, 0.1, "", "", "", "")
    car.restore_physx_physics()
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
    blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
    point = world.get_map().get_spawn_points()[0]
    before = world.spawn_actor(blueprint, point).id
    frame = world.tick()
    world = client.reload_world(reset_settings=False)
    assert world.tick() > frame
    assert not world.get_actors().filter("vehicle.*")
    assert world.spawn_actor(blueprint, point).id > before


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
