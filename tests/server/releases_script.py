"""A script for the client of any release: it tries what scripts do, step by step, and prints what came of each step.

It needs nothing but that client, and runs in an environment of its own: `python releases_script.py PORT FOLDER TM_PORT`.
Only a few sensors listen at once: the client's threads wait for Python's lock in the callbacks.
"""

from __future__ import annotations

import json
import math
import queue
import re
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import carla

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

STEPS: list[Callable[[Session], None]] = []
PATIENCE = 60.0
DELTA = 0.05


class Absent(Exception):
    """The release has no such thing."""


class Session:
    """A client, its world, and the actors that steps share."""

    def __init__(self, port: int, folder: str, manager: int) -> None:
        self.folder = Path(folder)
        self.client = carla.Client("127.0.0.1", port)
        self.client.set_timeout(PATIENCE)
        if hasattr(self.client, "set_files_base_folder"):
            self.client.set_files_base_folder(folder)
        self.manager = manager
        self.world = self.client.get_world()
        self.release = self.client.get_client_version()
        self.car: Any = None

    def ticks(self, count: int = 1) -> int:
        return [self.world.tick() for _ in range(count)][-1]

    def synchronize(self) -> None:
        settings = self.world.get_settings()
        settings.synchronous_mode, settings.fixed_delta_seconds = True, DELTA
        self.world.apply_settings(settings)

    def find(self, pattern: str) -> Any:
        found = self.world.get_blueprint_library().filter(pattern)
        if not len(found):
            raise Absent(pattern)
        return found[0]

    def car_blueprint(self) -> Any:
        return self.find("vehicle.lincoln.mkz*")

    def spawn(self, blueprint: Any, point: int = 0, ahead: float = 0.0) -> Any:
        at = self.world.get_map().get_spawn_points()[point]
        at.location += at.get_forward_vector() * ahead
        actor = self.world.spawn_actor(blueprint, at)
        self.ticks()
        return actor

    @contextmanager
    def another_car(self, ahead: float) -> Iterator[Any]:
        """Have a car ahead of the first spawn point, where the session's own car is put, until the end of the block."""
        self.car.set_transform(self.world.get_map().get_spawn_points()[0])
        self.ticks()
        other = self.spawn(self.car_blueprint(), ahead=ahead)
        yield other
        self.stop()
        assert other.destroy()
        self.ticks()

    def stop(self, ticks: int = 20) -> None:
        """Let the car brake, by default until it stands."""
        self.car.apply_control(carla.VehicleControl(brake=1.0))
        self.ticks(ticks)

    def speed(self) -> float:
        """Return the speed of the car over the ground, in m/s."""
        velocity = self.car.get_velocity()
        return math.hypot(velocity.x, velocity.y)

    def listen(self, sensor: Any, count: int = 1, ticks: int = 40) -> list[Any]:
        """Return the first data of a sensor, while the world ticks, and destroy it."""
        data: queue.Queue[Any] = queue.Queue()
        sensor.listen(data.put)
        found: list[Any] = []
        end = time.monotonic() + PATIENCE
        while len(found) < count and ticks and time.monotonic() < end:
            self.ticks()
            ticks -= 1
            with suppress(queue.Empty):
                found.append(data.get(timeout=0.2))
        sensor.stop()
        sensor.destroy()
        self.ticks()
        assert len(found) == count, f"{len(found)} data"
        return found

    def sense(self, name: str, z: float = 2.0, count: int = 1, **attributes: str) -> list[Any]:
        blueprint = self.find(name)
        for key, value in attributes.items():
            blueprint.set_attribute(key, value)
        at = carla.Transform(carla.Location(x=1.0, z=z))
        return self.listen(self.world.spawn_actor(blueprint, at, attach_to=self.car), count)


def step(function: Callable[[Session], None]) -> Callable[[Session], None]:
    STEPS.append(function)
    return function


def needs(owner: Any, *names: str) -> None:
    for name in names:
        if not hasattr(owner, name):
            raise Absent(name)


def near(found: float, expected: float, within: float = 1e-3) -> None:
    assert abs(found - expected) <= within, (found, expected)


# --- world, map, settings --------------------------------------------------------------------------------------------------


@step
def the_server_has_the_version_of_the_client(session: Session) -> None:
    assert session.client.get_server_version() == session.release


@step
def the_maps_can_be_listed(session: Session) -> None:
    assert any(name.endswith("Brickfield") for name in session.client.get_available_maps())


@step
def the_map_has_waypoints_at_its_spawn_points(session: Session) -> None:
    town = session.world.get_map()
    assert town.name.endswith("Brickfield")
    point = town.get_spawn_points()[0]
    assert town.get_waypoint(point.location).transform.location.distance(point.location) < 1.0


@step
def time_passes_by_itself_in_asynchronous_mode(session: Session) -> None:
    first = session.world.wait_for_tick(PATIENCE)
    assert session.world.wait_for_tick(PATIENCE).frame > first.frame


@step
def settings_are_applied_and_read_back(session: Session) -> None:
    session.synchronize()
    settings = session.world.get_settings()
    assert settings.synchronous_mode
    near(settings.fixed_delta_seconds, DELTA)
    assert settings.max_substeps == 10


@step
def a_tick_is_a_frame(session: Session) -> None:
    frame = session.ticks()
    assert session.ticks() == frame + 1
    snapshot = session.world.get_snapshot()
    assert snapshot.frame == frame + 1
    near(snapshot.timestamp.delta_seconds, DELTA)


@step
def callbacks_hear_of_ticks(session: Session) -> None:
    heard: queue.Queue[Any] = queue.Queue()
    number = session.world.on_tick(heard.put)
    frame = session.ticks()
    assert heard.get(timeout=PATIENCE).frame <= frame
    session.world.remove_on_tick(number)


@step
def the_weather_is_kept(session: Session) -> None:
    weather = session.world.get_weather()
    weather.cloudiness, weather.wetness, weather.sun_altitude_angle = 42.0, 7.0, -12.0
    session.world.set_weather(weather)
    found = session.world.get_weather()
    assert (found.cloudiness, found.wetness, found.sun_altitude_angle) == (42.0, 7.0, -12.0)


@step
def the_spectator_can_be_moved(session: Session) -> None:
    spectator = session.world.get_spectator()
    spectator.set_transform(carla.Transform(carla.Location(10.0, 20.0, 30.0), carla.Rotation(-90.0, 4.0, 5.0)))
    session.ticks(2)
    assert spectator.get_location().distance(carla.Location(10.0, 20.0, 30.0)) < 0.01
    turn = spectator.get_transform().rotation
    for found, expected in ((turn.pitch, -90.0), (turn.yaw, 4.0), (turn.roll, 5.0)):
        near(found, expected)


@step
def blueprints_have_readable_attributes(session: Session) -> None:
    library = session.world.get_blueprint_library()
    for blueprint in library:
        for attribute in blueprint:
            str(attribute), list(attribute.recommended_values)
            if attribute.id == "color":
                attribute.as_color()
            elif attribute.id == "number_of_wheels":
                assert attribute.as_int() in (2, 4, 6)
    assert len(library.filter("vehicle.*")) >= 17
    assert len(library.filter("walker.pedestrian.*")) >= 37


# --- vehicles --------------------------------------------------------------------------------------------------------------


@step
def a_vehicle_is_spawned_with_its_attributes(session: Session) -> None:
    blueprint = session.car_blueprint()
    blueprint.set_attribute("role_name", "hero")
    session.car = session.spawn(blueprint)
    (found,) = session.world.get_actors().filter("vehicle.*")
    assert (found.id, found.type_id, found.attributes["role_name"]) == (session.car.id, blueprint.id, "hero")
    extent = session.car.bounding_box.extent
    assert 2.0 < extent.x < 3.0, extent
    assert 0.7 < extent.z < 1.0, extent


@step
def an_occupied_place_is_refused(session: Session) -> None:
    assert session.world.try_spawn_actor(session.car_blueprint(), session.car.get_transform()) is None


@step
def the_tags_of_a_car_and_a_light_are_the_releases(session: Session) -> None:
    labels = carla.CityObjectLabel
    assert session.car.semantic_tags == [int(labels.Vehicles if hasattr(labels, "Vehicles") else labels.Car)]
    light = session.world.get_actors().filter("traffic.traffic_light")[0]
    assert light.semantic_tags == [int(labels.TrafficLight)]


@step
def a_control_drives_a_vehicle(session: Session) -> None:
    start = session.car.get_location()
    session.car.apply_control(carla.VehicleControl(throttle=0.8, steer=0.01))
    session.ticks(60)
    assert session.car.get_location().distance(start) > 2.0
    control = session.car.get_control()
    near(control.throttle, 0.8)
    near(control.steer, 0.01)
    assert control.gear > 0
    assert session.car.get_speed_limit() > 0.0
    session.stop(60)
    near(session.speed(), 0.0, 0.1)


@step
def an_ackermann_control_drives_a_vehicle(session: Session) -> None:
    needs(session.car, "apply_ackermann_control", "get_ackermann_controller_settings")
    session.car.apply_ackermann_control(carla.VehicleAckermannControl(speed=4.0, acceleration=3.0))
    session.ticks(40)
    near(session.speed(), 4.0, 0.7)
    settings = session.car.get_ackermann_controller_settings()
    near(settings.speed_kp, 0.15)
    settings.speed_kp, settings.accel_kd = 1.5, 2.5
    session.car.apply_ackermann_controller_settings(settings)
    assert session.car.get_ackermann_controller_settings() == settings
    session.car.apply_control(carla.VehicleControl(brake=0.9))  # the client does not send what it has sent last
    session.ticks(40)
    near(session.speed(), 0.0, 0.1)


@step
def physics_are_read_changed_and_read_back(session: Session) -> None:
    control = session.car.get_physics_control()
    wheels = control.wheels
    assert len(wheels) == 4
    assert 1000.0 < control.mass < 3000.0
    radius = "radius" if hasattr(wheels[0], "radius") else "wheel_radius"
    assert 25.0 < getattr(wheels[0], radius) < 50.0
    control.mass, control.max_rpm = 1234.0, 5678.0
    for wheel in wheels:
        wheel.max_brake_torque = 999.0
        setattr(wheel, radius, 33.0)
    control.wheels = wheels
    session.car.apply_physics_control(control)
    session.ticks()
    found = session.car.get_physics_control()
    near(found.mass, 1234.0)
    near(found.max_rpm, 5678.0)
    assert [(wheel.max_brake_torque, getattr(wheel, radius)) for wheel in found.wheels] == [(999.0, 33.0)] * 4
    assert [(p.x, p.y) for p in found.torque_curve] == [(p.x, p.y) for p in control.torque_curve]


@step
def lights_of_a_vehicle_are_kept(session: Session) -> None:
    lit = carla.VehicleLightState(carla.VehicleLightState.LowBeam | carla.VehicleLightState.Brake)
    session.car.set_light_state(lit)
    session.ticks()
    assert int(session.car.get_light_state()) == int(lit)
    lights = session.world.get_vehicles_light_states()
    assert int(lights[session.car.id]) == int(lit)


@step
def a_constant_velocity_holds(session: Session) -> None:
    session.car.enable_constant_velocity(carla.Vector3D(3.0, 0.0, 0.0))
    session.ticks(10)
    near(session.speed(), 3.0, 0.05)
    session.car.disable_constant_velocity()


@step
def impulses_and_forces_are_accepted(session: Session) -> None:
    session.car.add_impulse(carla.Vector3D(100.0, 0.0, 0.0))
    session.car.add_force(carla.Vector3D(100.0, 0.0, 0.0))
    session.car.add_angular_impulse(carla.Vector3D(0.0, 0.0, 1.0))
    session.car.add_torque(carla.Vector3D(0.0, 0.0, 1.0))
    session.car.set_target_velocity(carla.Vector3D())


@step
def doors_wheels_and_physics_are_switched(session: Session) -> None:
    session.car.open_door(carla.VehicleDoor.All)
    session.car.close_door(carla.VehicleDoor.All)
    near(session.car.get_wheel_steer_angle(carla.VehicleWheelLocation.FL_Wheel), 0.0, 1.0)
    session.car.set_simulate_physics(False)
    session.car.set_simulate_physics(True)
    session.car.set_enable_gravity(True)


@step
def a_transform_is_set(session: Session) -> None:
    point = session.world.get_map().get_spawn_points()[1]
    session.car.set_transform(point)
    session.ticks()
    found = session.car.get_location()
    assert math.hypot(found.x - point.location.x, found.y - point.location.y) < 0.2
    session.car.set_location(found + 5.0 * point.get_forward_vector())
    session.ticks()
    near(session.car.get_location().distance(found), 5.0, 0.2)
    near(session.car.get_transform().rotation.yaw, point.rotation.yaw, 0.1)


@step
def target_velocities_are_taken_over(session: Session) -> None:
    session.car.set_transform(carla.Transform(carla.Location(500.0, 500.0, 0.5)))
    session.car.set_target_velocity(carla.Vector3D(10.0, 0.0, 0.0))
    session.ticks()
    near(session.car.get_velocity().x, 10.0, 0.5)
    near(session.car.get_location().x, 500.5, 0.05)
    session.car.set_target_angular_velocity(carla.Vector3D(0.0, 0.0, 20.0))
    session.ticks()
    assert session.car.get_transform().rotation.yaw > 0.2
    session.car.set_transform(session.world.get_map().get_spawn_points()[1])
    session.car.set_target_velocity(carla.Vector3D())


@step
def telemetry_is_read(session: Session) -> None:
    needs(session.car, "get_telemetry_data")
    assert len(session.car.get_telemetry_data().wheels) == 4


@step
def names_in_the_engine_are_read_and_textures_accepted(session: Session) -> None:
    needs(session.car, "get_actor_name")
    assert str(session.car.id) in session.car.get_actor_name()
    assert session.car.type_id in session.car.get_actor_class_name()
    texture = carla.TextureColor(2, 2)
    session.car.apply_texture(carla.MaterialParameter.Diffuse, texture)


# --- town ------------------------------------------------------------------------------------------------------------------


@step
def traffic_lights_are_set_and_frozen(session: Session) -> None:
    light = session.world.get_actors().filter("traffic.traffic_light")[0]
    for set_time, seconds in ((light.set_green_time, 7.0), (light.set_yellow_time, 2.5), (light.set_red_time, 1.5)):
        set_time(seconds)
    light.set_state(carla.TrafficLightState.Green)
    light.freeze(True)
    session.ticks(2)
    assert light.get_state() == carla.TrafficLightState.Green
    assert light.is_frozen()
    assert (light.get_green_time(), light.get_yellow_time(), light.get_red_time()) == (7.0, 2.5, 1.5)
    assert light.id in [each.id for each in light.get_group_traffic_lights()]
    light.freeze(False)
    session.world.reset_all_traffic_lights()


@step
def boxes_and_objects_of_the_map_are_listed(session: Session) -> None:
    labels = carla.CityObjectLabel
    lights = len(session.world.get_actors().filter("traffic.traffic_light"))
    assert len(session.world.get_level_bbs(labels.TrafficLight)) == lights
    found = session.world.get_environment_objects(labels.TrafficLight)
    assert [each.type for each in found] == [labels.TrafficLight] * lights


@step
def rays_meet_the_road(session: Session) -> None:
    here = session.world.get_map().get_spawn_points()[2].location
    above, below = carla.Location(here.x, here.y, here.z + 5.0), carla.Location(here.x, here.y, here.z - 5.0)
    assert carla.CityObjectLabel.Roads in [point.label for point in session.world.cast_ray(above, below)]
    assert session.world.ground_projection(above, 10.0).label == carla.CityObjectLabel.Roads


@step
def debug_shapes_are_accepted(session: Session) -> None:
    session.world.debug.draw_point(carla.Location())
    session.world.debug.draw_string(carla.Location(), "text")
    session.world.debug.draw_box(session.car.bounding_box, carla.Rotation())


# --- batches ---------------------------------------------------------------------------------------------------------------


@step
def a_batch_spawns_and_then_commands(session: Session) -> None:
    points = session.world.get_map().get_spawn_points()
    command, future = carla.command, carla.command.FutureActor
    lit = carla.VehicleLightState(carla.VehicleLightState.Fog)
    spawns = [
        command.SpawnActor(session.car_blueprint(), point)
        .then(command.SetVehicleLightState(future, lit))
        .then(command.ApplyVehicleControl(future, carla.VehicleControl(throttle=0.5)))
        for point in points[4:6]
    ]
    answers = session.client.apply_batch_sync(spawns, True)
    assert [answer.error for answer in answers] == ["", ""]
    first, second = (answer.actor_id for answer in answers)
    session.ticks(10)
    cars = session.world.get_actors([first, second])
    assert [int(car.get_light_state()) for car in cars] == [int(lit)] * 2
    near(cars[0].get_control().throttle, 0.5)
    physics = cars[0].get_physics_control()
    physics.mass = 2345.0
    batch = [
        command.ApplyVehiclePhysicsControl(first, physics),
        command.ApplyTransform(second, points[6]),
        command.ApplyTargetVelocity(second, carla.Vector3D()),
        command.ApplyImpulse(first, carla.Vector3D()),
        command.ApplyForce(first, carla.Vector3D()),
        command.ApplyTorque(first, carla.Vector3D()),
        command.ApplyAngularImpulse(first, carla.Vector3D()),
        command.ApplyTargetAngularVelocity(first, carla.Vector3D()),
        command.SetSimulatePhysics(second, True),
        command.SetEnableGravity(second, True),
        command.SetVehicleLightState(first, carla.VehicleLightState.NONE),
        command.ApplyVehicleControl(first, carla.VehicleControl(brake=1.0)),
        command.ApplyVehicleControl(second, carla.VehicleControl(brake=1.0)),
    ]
    assert [(answer.actor_id, answer.error) for answer in session.client.apply_batch_sync(batch[:2], True)] == [
        (first, ""),
        (second, ""),
    ]
    assert not any(answer.error for answer in session.client.apply_batch_sync(batch[2:], True))
    session.client.apply_batch([command.ApplyVehicleControl(first, carla.VehicleControl(brake=0.75))])
    session.ticks(2)
    near(cars[0].get_control().brake, 0.75)
    near(cars[0].get_physics_control().mass, 2345.0)
    assert int(cars[0].get_light_state()) == 0
    assert cars[1].get_location().distance(points[6].location) < 1.5
    answers = session.client.apply_batch_sync([command.DestroyActor(id) for id in (first, second, 999_999)], True)
    assert [bool(answer.error) for answer in answers] == [False, False, True]
    session.ticks()
    assert len(session.world.get_actors().filter("vehicle.*")) == 1


@step
def a_batch_drives_by_ackermann(session: Session) -> None:
    needs(carla.command, "ApplyVehicleAckermannControl")
    control = carla.VehicleAckermannControl(speed=2.0, acceleration=3.0)
    (answer,) = session.client.apply_batch_sync([carla.command.ApplyVehicleAckermannControl(session.car, control)], True)
    assert answer.error == ""
    session.stop(10)


@step
def a_prop_is_attached_to_a_vehicle(session: Session) -> None:
    at = carla.Transform(carla.Location(z=2.0))
    prop = session.world.spawn_actor(session.find("static.prop.*"), at, attach_to=session.car)
    session.ticks(2)
    assert prop.parent.id == session.car.id
    near(prop.get_location().z - session.car.get_location().z, 2.0, 0.2)
    assert prop.destroy()


@step
def a_walker_walks(session: Session) -> None:
    at = carla.Transform(carla.Location(500.0, 500.0, 1.0))
    walker = session.world.spawn_actor(session.find("walker.pedestrian.*"), at)
    session.ticks()
    walker.apply_control(carla.WalkerControl(carla.Vector3D(1.0, 0.0, 0.0), 1.5))
    session.ticks(20)
    near(walker.get_location().x, 501.5, 0.1)
    near(walker.get_velocity().x, 1.5, 0.01)
    near(walker.get_control().speed, 1.5)
    assert walker.semantic_tags == [int(carla.CityObjectLabel.Pedestrians)]
    control = carla.WalkerControl(carla.Vector3D(0.0, 1.0, 0.0), 1.5)
    session.client.apply_batch_sync([carla.command.ApplyWalkerControl(walker, control)], True)
    session.ticks(20)
    near(walker.get_location().y, 501.5, 0.1)
    near(walker.get_transform().rotation.yaw, 90.0)
    assert walker.destroy()


# --- sensors ---------------------------------------------------------------------------------------------------------------

SMALL = {"image_size_x": "32", "image_size_y": "24"}


def camera(name: str) -> None:
    def look(session: Session) -> None:
        (image,) = session.sense(f"sensor.camera.{name}", **SMALL)
        assert (image.width, image.height) == (32, 24)
        assert len(image) == 32 * 24

    look.__name__ = f"{name}_images_arrive"
    STEPS.append(look)


for each in ("rgb", "depth", "instance_segmentation", "optical_flow", "normals", "cosmos_visualization"):
    camera(each)


@step
def semantic_images_have_the_releases_labels(session: Session) -> None:
    (image,) = session.sense("sensor.camera.semantic_segmentation", **SMALL)
    tags = set(bytes(image.raw_data)[2::4])
    assert int(carla.CityObjectLabel.Roads) in tags, tags
    known = {int(label) for label in carla.CityObjectLabel.values.values()}
    assert tags <= known, tags - known


@step
def events_of_a_dvs_arrive(session: Session) -> None:
    session.car.apply_control(carla.VehicleControl(throttle=0.5))
    (events,) = session.sense("sensor.camera.dvs", **SMALL)
    assert (events.width, events.height) == (32, 24)
    session.stop()


@step
def lidar_points_arrive(session: Session) -> None:
    (points,) = session.sense("sensor.lidar.ray_cast", rotation_frequency="20", points_per_second="20000")
    assert points.channels == 32
    assert len(points) > 50


@step
def semantic_lidar_points_have_the_releases_labels(session: Session) -> None:
    (points,) = session.sense("sensor.lidar.ray_cast_semantic", rotation_frequency="20", points_per_second="20000")
    tags = {point.object_tag for point in points}
    assert int(carla.CityObjectLabel.Roads) in tags, tags


@step
def radar_detections_arrive(session: Session) -> None:
    with session.another_car(ahead=12.0):
        (found,) = session.sense("sensor.other.radar", z=0.7)
    assert len(found) > 0


@step
def positions_arrive(session: Session) -> None:
    (fix,) = session.sense("sensor.other.gnss")
    assert fix.latitude != 0.0


@step
def an_imu_measures_gravity(session: Session) -> None:
    session.ticks(10)
    found = session.sense("sensor.other.imu", count=3)
    near(found[-1].accelerometer.z, 9.81, 0.5)


@step
def a_collision_names_the_other_actor(session: Session) -> None:
    with session.another_car(ahead=9.0) as other:
        session.car.apply_control(carla.VehicleControl(throttle=1.0))
        sensor = session.world.spawn_actor(session.find("sensor.other.collision"), carla.Transform(), attach_to=session.car)
        (event,) = session.listen(sensor, ticks=120)
        assert (event.actor.id, event.other_actor.id) == (session.car.id, other.id)
        assert event.other_actor.type_id == other.type_id


@step
def an_obstacle_is_detected(session: Session) -> None:
    with session.another_car(ahead=9.0) as other:
        (found,) = session.sense("sensor.other.obstacle", z=0.8, distance="20", only_dynamics="true")
    assert found.other_actor.id == other.id


@step
def a_lane_invasion_is_found(session: Session) -> None:
    session.car.set_transform(session.world.get_map().get_spawn_points()[0])
    session.ticks()
    session.car.apply_control(carla.VehicleControl(throttle=0.7, steer=-0.15))
    sensor = session.world.spawn_actor(session.find("sensor.other.lane_invasion"), carla.Transform(), attach_to=session.car)
    (event,) = session.listen(sensor, ticks=150)
    assert event.crossed_lane_markings
    session.stop()


@step
def v2x_messages_arrive(session: Session) -> None:
    session.find("sensor.other.v2x")
    other = session.spawn(session.car_blueprint(), 1)
    sender = session.world.spawn_actor(session.find("sensor.other.v2x"), carla.Transform(), attach_to=other)
    session.sense("sensor.other.v2x")
    sender.destroy()
    assert other.destroy()


# --- recordings ------------------------------------------------------------------------------------------------------------


@step
def a_drive_is_recorded(session: Session) -> None:
    session.car.set_transform(session.world.get_map().get_spawn_points()[0])
    assert session.client.start_recorder(str(session.folder / "drive.log"), True).endswith("drive.log")
    session.car.apply_control(carla.VehicleControl(throttle=1.0))
    session.ticks(60)
    session.client.stop_recorder()


@step
def a_recording_is_queried(session: Session) -> None:
    name = str(session.folder / "drive.log")
    text = session.client.show_recorder_file_info(name, False)
    assert re.search(rf"Create {session.car.id}: {re.escape(session.car.type_id)}", text), text
    assert "Frames: 60" in text or "Frames: 61" in text, text
    assert " Positions: " in session.client.show_recorder_file_info(name, True)
    assert "Duration" in session.client.show_recorder_collisions(name, "a", "a")
    assert "Duration" in session.client.show_recorder_actors_blocked(name, 60.0, 100.0)


@step
def a_recording_is_replayed(session: Session) -> None:
    recorded = session.car.type_id
    assert session.car.destroy()
    session.ticks(2)
    answer = session.client.replay_file(str(session.folder / "drive.log"), 0.0, 0.0, 0, False)
    assert "Replaying File" in answer, answer
    session.ticks(5)
    (played,) = session.world.get_actors().filter(recorded)
    start = played.get_location()
    session.client.set_replayer_time_factor(1.0)
    session.ticks(45)
    assert played.get_location().distance(start) > 1.0
    session.client.stop_replayer(False)
    session.ticks(2)
    assert not len(session.world.get_actors().filter("vehicle.*"))


# --- traffic, episodes -----------------------------------------------------------------------------------------------------


def drive_traffic(session: Session, manager: Any) -> None:
    points = session.world.get_map().get_spawn_points()
    cars = [session.world.spawn_actor(session.car_blueprint(), point) for point in points[:4]]
    session.ticks()
    for car in cars:
        car.set_autopilot(True, session.manager)
    starts = [car.get_location() for car in cars]
    session.ticks(160)
    moved = [car.get_location().distance(start) for car, start in zip(cars, starts, strict=True)]
    assert sum(moved) > 20.0, moved
    for car in cars:
        car.set_autopilot(False, session.manager)
    answers = session.client.apply_batch_sync([carla.command.DestroyActor(car) for car in cars], True)
    assert not any(answer.error for answer in answers)


@step
def a_traffic_manager_drives(session: Session) -> None:
    manager = session.client.get_trafficmanager(session.manager)
    manager.set_synchronous_mode(True)
    manager.set_random_device_seed(1)
    manager.global_percentage_speed_difference(10.0)
    session.ticks()
    drive_traffic(session, manager)


@step
def walkers_with_controllers_walk(session: Session) -> None:
    walkers, controllers = [], []
    for _ in range(3):
        at = session.world.get_random_location_from_navigation()
        assert at is not None
        walkers.append(session.world.spawn_actor(session.find("walker.pedestrian.*"), carla.Transform(at)))
    session.ticks()
    for walker in walkers:
        blueprint = session.find("controller.ai.walker")
        controllers.append(session.world.spawn_actor(blueprint, carla.Transform(), walker))
    session.ticks()
    starts = [walker.get_location() for walker in walkers]
    for controller in controllers:
        controller.start()
        controller.go_to_location(session.world.get_random_location_from_navigation())
        controller.set_max_speed(1.6)
    session.ticks(80)
    moved = [walker.get_location().distance(start) for walker, start in zip(walkers, starts, strict=True)]
    assert max(moved) > 1.0, moved
    for controller in controllers:
        controller.stop()
    session.ticks()
    for actor in (*controllers, *walkers):
        actor.destroy()


@step
def a_world_is_loaded_beside_a_traffic_manager(session: Session) -> None:
    for _ in range(2):
        before = session.world.id
        session.world = session.client.load_world("Brickfield")
        assert session.world.id != before
        session.synchronize()
        session.ticks(3)
        assert session.world.get_map().name.endswith("Brickfield")
        drive_traffic(session, session.client.get_trafficmanager(session.manager))


@step
def a_world_is_reloaded_in_synchronous_mode(session: Session) -> None:
    session.spawn(session.car_blueprint())
    before = session.world.id
    session.world = session.client.reload_world(False)
    assert session.world.id != before
    session.ticks(3)
    assert session.world.get_settings().synchronous_mode
    assert not len(session.world.get_actors().filter("vehicle.*"))


@step
def an_error_has_a_text(session: Session) -> None:
    text = ""
    try:
        session.client.load_world("Atlantis")
    except RuntimeError as error:
        text = str(error)
    assert "Atlantis" in text or text == "std::exception", text  # the client of 0.10 loses the text


@step
def asynchronous_mode_returns(session: Session) -> None:
    session.client.get_trafficmanager(session.manager).set_synchronous_mode(False)
    settings = session.world.get_settings()
    settings.synchronous_mode = False
    session.world.apply_settings(settings)
    assert session.world.wait_for_tick(PATIENCE).frame > 0


def main() -> None:
    session = Session(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
    results: dict[str, str] = {"release": session.release}
    for each in STEPS:
        try:
            each(session)
            session.ticks()
            result = "passed"
        except Absent as absent:
            result = f"absent: {absent}"
        except Exception as error:
            result = f"{type(error).__name__}: {error} (line {sys.exc_info()[2].tb_next.tb_lineno})"
        results[each.__name__] = result
        print(each.__name__, result, file=sys.stderr, flush=True)
    print(json.dumps(results), flush=True)
    time.sleep(0.1)


if __name__ == "__main__":
    main()
