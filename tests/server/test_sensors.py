"""Sensors, as the official client reads them."""

from __future__ import annotations

import queue
import socket
import struct
from typing import Any

import carla
import numpy as np
import pytest

from tests.server.client import Data, of_frame, sensor, settle, start, vehicle
from tests.waiting import PATIENCE, wait_until


def is_silent(world: carla.World, data: Data) -> bool:
    """Return whether a sensor sends nothing in a tick; the client does not wait for the end of its subscription."""
    world.tick()
    settle()
    comes = not data.empty()
    while not data.empty():
        data.get()
    return not comes


def tick_until(world: carla.World, data: Data, most: int = 200) -> Any:
    """Tick until a sensor sends data."""
    for _ in range(most):
        world.tick()
        try:
            return data.get(timeout=0.02)
        except queue.Empty:
            continue
    pytest.fail("the sensor has told nothing")


def test_each_frame_comes_to_queues_of_several_sensors_on_several_vehicles(world: carla.World) -> None:
    kinds = {
        "other.gnss": carla.GnssMeasurement,
        "other.imu": carla.IMUMeasurement,
        "other.radar": carla.RadarMeasurement,
        "lidar.ray_cast": carla.LidarMeasurement,
        "lidar.ray_cast_semantic": carla.SemanticLidarMeasurement,
        "camera.rgb": carla.Image,
        "camera.depth": carla.Image,
        "camera.optical_flow": carla.OpticalFlowImage,
        "camera.dvs": carla.DVSEventArray,
    }
    small = {"image_size_x": "64", "image_size_y": "48"}
    sensors = [
        (sensor(world, kind, car, **(small if kind.startswith("camera") else {})), expected)
        for car in (vehicle(world, 0), vehicle(world, 10), vehicle(world, 20))
        for kind, expected in kinds.items()
    ]
    queues = [(Data(actor), expected) for actor, expected in sensors]
    start(world, *(data for data, _ in queues))
    for _ in range(20):
        frame = world.tick()
        elapsed = world.get_snapshot().timestamp.elapsed_seconds
        for (actor, _), (data, expected) in zip(sensors, queues, strict=True):
            measurement = of_frame(data, frame)
            assert isinstance(measurement, expected)
            assert measurement.timestamp == pytest.approx(elapsed)
            assert measurement.transform.location.distance(actor.get_transform().location) < 1e-3
    assert all(data.empty() for data, _ in queues)


def test_synchronous_mode(world: carla.World) -> None:
    """As CARLA's documentation shows it: each tick has the datum of a sensor that has just begun to listen."""
    car = vehicle(world)
    for _ in range(10):
        gnss = Data(sensor(world, "other.gnss", car))
        for _ in range(3):
            frame = world.tick()
            assert gnss.get(timeout=PATIENCE).frame == frame
        gnss.sensor.destroy()


def test_a_collision_is_told_with_whom_and_how_hard(world: carla.World) -> None:
    car, other = vehicle(world), vehicle(world, distance=15.0)
    data = Data(sensor(world, "other.collision", car))
    car.apply_control(carla.VehicleControl(throttle=1.0))
    event = tick_until(world, data)
    assert isinstance(event, carla.CollisionEvent)
    assert (event.actor.id, event.other_actor.id) == (car.id, other.id)
    assert event.other_actor.type_id == other.type_id
    assert event.frame == world.get_snapshot().frame
    along = car.get_transform().get_forward_vector()
    assert event.normal_impulse.dot(along) < -1000.0  # N s, against the way of the car


def test_gnss_agrees_with_the_map(world: carla.World) -> None:
    car = vehicle(world)
    data = Data(sensor(world, "other.gnss", car))
    start(world, data)
    car.apply_control(carla.VehicleControl(throttle=0.5))
    for _ in range(10):
        measurement = of_frame(data, world.tick())
        expected = world.get_map().transform_to_geolocation(measurement.transform.location)
        assert (measurement.latitude, measurement.longitude) == pytest.approx(
            (expected.latitude, expected.longitude), abs=1e-9
        )
        assert measurement.altitude == pytest.approx(expected.altitude, abs=1e-4)


def test_a_lane_invasion_is_found_by_the_client(world: carla.World) -> None:
    car = vehicle(world)
    data = Data(sensor(world, "other.lane_invasion", car, carla.Transform()))
    car.apply_control(carla.VehicleControl(throttle=0.5, steer=0.15))
    event = tick_until(world, data)
    assert isinstance(event, carla.LaneInvasionEvent)
    assert event.frame == world.get_snapshot().frame
    assert len(event.crossed_lane_markings) >= 1


def test_radar_and_lidars_see_the_car_ahead(world: carla.World) -> None:
    car, other = vehicle(world), vehicle(world, distance=14.0)
    radar = Data(sensor(world, "other.radar", car))
    rays = {"range": "50", "rotation_frequency": "20", "lower_fov": "-10"}
    exact = {"dropoff_general_rate": "0", "dropoff_intensity_limit": "0"}
    lidar = Data(sensor(world, "lidar.ray_cast", car, carla.Transform(carla.Location(z=1.0)), **rays, **exact))
    labels = Data(sensor(world, "lidar.ray_cast_semantic", car, carla.Transform(carla.Location(z=1.0)), **rays))
    start(world, radar, lidar, labels)
    frame = world.tick()
    found = list(of_frame(radar, frame))
    assert min(abs(detection.depth - (14.0 - 4.79 / 2 - 2.5)) for detection in found) < 0.1
    cloud = of_frame(lidar, frame)
    assert cloud.channels == 32
    assert len(cloud) == sum(cloud.get_point_count(channel) for channel in range(32)) > 15
    points = np.frombuffer(cloud.raw_data, "<f4").reshape(-1, 4)
    assert points[:, 0].min() < 0 < 14.0 - 4.79 / 2 < points[:, 0].max() + 0.1
    assert (other.id, 14) in {(point.object_idx, point.object_tag) for point in of_frame(labels, frame)}


def test_a_sensor_can_be_stopped_and_listened_to_again(world: carla.World) -> None:
    gnss = sensor(world, "other.gnss", vehicle(world))
    assert not gnss.is_listening()
    first = Data(gnss)
    settle()
    assert gnss.is_listening()
    of_frame(first, world.tick())
    gnss.stop()
    assert not gnss.is_listening()
    wait_until(lambda: is_silent(world, first))
    again = Data(gnss)
    of_frame(again, world.tick())
    assert gnss.destroy()
    wait_until(lambda: is_silent(world, again))


def test_a_subscriber_that_stops_reading_holds_up_no_other(world: carla.World, port: int) -> None:
    camera = sensor(world, "camera.rgb", vehicle(world), image_size_x="1280", image_size_y="720")
    images = Data(camera)
    start(world, images)
    of_frame(images, world.tick())
    with socket.create_connection(("127.0.0.1", port + 1)) as stalled:
        stalled.sendall(struct.pack("<I", (1 << 24) + camera.id))
        settle()
        for _ in range(10):
            of_frame(images, world.tick())
