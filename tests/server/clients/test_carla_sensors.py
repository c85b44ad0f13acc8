"""Sensors as CARLA's own tests ask about them, V2X among them."""

from __future__ import annotations

import carla
import pytest

from tests.server.clients.calls import ahead, spawn, straight
from tests.waiting import wait_until

TICKING = (
    "sensor.other.gnss",
    "sensor.other.imu",
    "sensor.other.radar",
    "sensor.lidar.ray_cast",
    "sensor.lidar.ray_cast_semantic",
)


@pytest.mark.parametrize("blueprint", TICKING)
def test_a_sensor_sends_at_once_and_then_every_sensor_tick(world: carla.World, blueprint: str) -> None:
    for _ in range(3):
        world.tick()
    sensor = spawn(world, blueprint, carla.Transform(carla.Location(z=3.0)), sensor_tick="1.0")
    frames: list[int] = []
    sensor.listen(lambda datum: frames.append(datum.frame))
    first = world.tick()
    for _ in range(49):
        world.tick()
    wait_until(lambda: len(frames) >= 3)
    assert frames == [first, first + 20, first + 40]


@pytest.mark.parametrize("blueprint", ["sensor.other.radar", "sensor.other.gnss"])
def test_sensors_repeat_their_noise_in_every_episode(client: carla.Client, blueprint: str) -> None:
    runs = []
    for _ in range(2):
        world = client.reload_world(False)
        start = straight(world, 60.0)
        car = spawn(world, "vehicle.tesla.model3", start)
        spawn(world, "vehicle.tesla.model3", ahead(start, 15.0, up=start.location.z))
        model = world.get_blueprint_library().find(blueprint)
        model.set_attribute("noise_seed", "54283")
        if blueprint.endswith("gnss"):
            model.set_attribute("noise_lat_stddev", "0.001")
        sensor = world.spawn_actor(model, carla.Transform(carla.Location(z=1.0)), car)
        data: list[carla.SensorData] = []
        sensor.listen(data.append)
        for _ in range(5):
            world.tick()
        wait_until(lambda data=data: len(data) >= 5)
        runs.append([bytes(datum.raw_data) if blueprint.endswith("radar") else datum.latitude for datum in data[:5]])
    assert runs[0] == runs[1]
    assert len(set(runs[0])) > 1


def test_vehicles_hear_of_each_other(world: carla.World) -> None:
    start = straight(world, 60.0)
    cars = [spawn(world, "vehicle.tesla.model3", ahead(start, distance, up=start.location.z)) for distance in (0.0, 30.0)]
    model, place = world.get_blueprint_library().find("sensor.other.v2x"), carla.Transform(carla.Location(z=1.5))
    sensors, heard = [world.spawn_actor(model, place, car) for car in cars], [[], []]
    for sensor, events in zip(sensors, heard, strict=True):
        sensor.listen(events.append)
    for _ in range(40):
        world.tick()
    wait_until(lambda: all(heard))
    for car, events in zip(cars, heard, strict=True):
        (other,) = (each for each in cars if each.id != car.id)
        message = events[0][0].get()
        assert message["Message"]["Header"]["Station ID"] == other.id
        assert -99.0 < message["Power"] < 0.0


def test_messages_of_clients_are_delivered(world: carla.World) -> None:
    start = straight(world, 60.0)
    cars = [spawn(world, "vehicle.tesla.model3", ahead(start, distance, up=start.location.z)) for distance in (0.0, 20.0)]
    model = world.get_blueprint_library().find("sensor.other.v2x_custom")
    sender, receiver = (world.spawn_actor(model, carla.Transform(carla.Location(z=1.5)), car) for car in cars)
    heard: list[carla.CustomV2XEvent] = []
    receiver.listen(heard.append)
    world.tick()
    for text in ("hello", "a" * 150):
        sender.send(text)
        for _ in range(3):
            world.tick()
    wait_until(lambda: len(heard) >= 2)
    assert [event[0].get()["Message"]["Message"] for event in heard] == ["hello", "a" * 99]
