"""Sensors, as the official client reads them."""

from __future__ import annotations

import carla
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
        for car in (vehicle(world, 0), vehicle(world, 10))
        for kind, expected in kinds.items()
    ]
    queues = [(Data(actor), expected) for actor, expected in sensors]
    start(world, *(data for data, _ in queues))
    for _ in range(10):
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
