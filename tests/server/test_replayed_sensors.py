"""Sensors in a replay, as CARLA's own client attaches them, or has recorded them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.server import running
from tests.roads.towns import town
from tests.samples import SAMPLES, carla_log
from tests.server.client import SYNCHRONOUS, Data, ahead, connect, of_frame, sensor, spawn, start, straight
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CRASH, HERO = SAMPLES / "crash.mcap", 41
DELTA = 0.05
EYE = (1.5, 0.0, 1.2)
"""The place of a sensor on a vehicle, in m."""
ON_CAR = carla.Transform(carla.Location(*EYE))


def way_of(path: Path, id: int) -> Any:
    """Return the trajectory of a recorded actor, in m and CARLA's axes."""
    with open_recording(path) as recording:
        return recording.trajectory(id, axes="carla")


def place_at(way: Any, time: float) -> carla.Location:
    return carla.Location(*(float(np.interp(time, way.time, along)) for along in (way.x, way.y, way.z)))


def eye_of(actor: carla.Actor) -> carla.Location:
    """Return the place of a sensor on an actor; the client's `transform` changes its argument."""
    return actor.get_transform().transform(carla.Location(*EYE))


def replayed(client: carla.Client, path: Path, id: int, begin: float) -> carla.Vehicle:
    """Begin a replay, and return the actor that is where the recorded one is; other ids may be taken."""
    client.replay_file(str(path), begin, 0.0, 0, False)
    world = client.get_world()
    world.tick()
    there = place_at(way_of(path, id), begin + DELTA)
    return min(world.get_actors().filter("vehicle.*"), key=lambda actor: actor.get_location().distance(there))


def test_each_tick_has_its_data_of_its_moment(client: carla.Client, world: carla.World) -> None:
    hero, way, begin = replayed(client, CRASH, HERO, 5.0), way_of(CRASH, HERO), 5.0 + DELTA
    first = world.get_snapshot().timestamp.elapsed_seconds
    small = {"image_size_x": "64", "image_size_y": "48"}
    kinds = ["camera.rgb", "camera.depth", "lidar.ray_cast", "other.radar", "other.gnss", "other.imu"]
    data = {kind: Data(sensor(world, kind, hero, ON_CAR, **(small if "camera" in kind else {}))) for kind in kinds}
    start(world, *data.values())
    for _ in range(40):
        frame = world.tick()
        elapsed = world.get_snapshot().timestamp.elapsed_seconds
        moment = begin + elapsed - first
        assert hero.get_location().distance(place_at(way, moment)) < 1e-3
        for kind, queue in data.items():
            measured = of_frame(queue, frame)
            assert measured.timestamp == pytest.approx(elapsed), kind
            assert measured.transform.location.distance(eye_of(hero)) < 1e-3, kind
            if kind == "other.imu":
                v = [place_at(way, moment - late * DELTA) for late in (0, 1, 2)]
                change = (v[0] - v[1] - (v[1] - v[2])).dot(hero.get_transform().get_forward_vector()) / DELTA**2
                assert measured.accelerometer.x == pytest.approx(change, abs=0.05)
            elif kind == "other.gnss":
                there = world.get_map().transform_to_geolocation(measured.transform.location)
                assert (measured.latitude, measured.longitude) == pytest.approx((there.latitude, there.longitude), abs=1e-9)
                assert measured.altitude == pytest.approx(there.altitude, abs=1e-4)
    assert hero.get_velocity().length() > 5.0
    assert all(queue.empty() for queue in data.values())


def record_collision(client: carla.Client, world: carla.World, path: Path) -> float:
    """Record a hero with sensors that hits a van; return the time of impact in s."""
    place = straight(world, 60.0)
    hero = spawn(world, "vehicle.tesla.model3", place, role_name="hero")
    van = spawn(world, "vehicle.mercedes.sprinter", ahead(place, 25.0))
    world.tick()
    client.start_recorder(str(path), True)
    world.tick()
    begin = world.get_snapshot().timestamp.elapsed_seconds
    camera = sensor(world, "camera.depth", hero, ON_CAR, image_size_x="64", image_size_y="48", fov="60")
    sensors = [camera, *(sensor(world, f"other.{kind}", hero) for kind in ("collision", "lane_invasion", "imu"))]
    data = Data(sensors[1])
    hero.apply_control(carla.VehicleControl(throttle=1.0))
    for _ in range(90):
        world.tick()
    client.stop_recorder()
    impact = data.get(timeout=PATIENCE).timestamp - begin
    for actor in (*sensors, hero, van):
        actor.destroy()
    world.tick()
    return impact


def test_recorded_sensors_can_be_listened_to(client: carla.Client, world: carla.World, tmp_path: Path) -> None:
    path = tmp_path / "collision.log"
    impact = record_collision(client, world, path)
    client.replay_file(str(path), 0.5, 0.0, 0, True)
    world.tick()
    first = world.get_snapshot().timestamp.elapsed_seconds
    actors = world.get_actors()
    (hero,) = (actor for actor in actors.filter("vehicle.*") if actor.attributes["role_name"] == "hero")
    (van,) = actors.filter("vehicle.mercedes.sprinter")
    sensors = {actor.type_id: actor for actor in actors.filter("sensor.*")}
    assert set(sensors) == {
        f"sensor.{name}" for name in ("camera.depth", "other.collision", "other.lane_invasion", "other.imu")
    }
    assert {actor.parent.id for actor in sensors.values()} == {hero.id}
    assert sensors["sensor.camera.depth"].attributes["fov"] == "60"
    imu, events = (Data(sensors[f"sensor.other.{kind}"]) for kind in ("imu", "collision"))
    start(world, imu)
    while world.get_snapshot().timestamp.elapsed_seconds - first + 0.5 + DELTA < impact - 2 * DELTA:
        assert of_frame(imu, world.tick()).transform.location.distance(hero.get_location()) < 3.0
    for _ in range(20):
        world.tick()
    event = events.get(timeout=PATIENCE)
    assert event.timestamp - first + 0.5 + DELTA == pytest.approx(impact, abs=DELTA)
    assert (event.actor.id, event.other_actor.id) == (hero.id, van.id)
    assert event.normal_impulse.dot(hero.get_transform().get_forward_vector()) < -1000.0
    client.stop_replayer(False)
    world.tick()
    assert not world.get_actors().filter("sensor.*")


# --- recordings of CARLA -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def in_town(tmp_path_factory: pytest.TempPathFactory) -> Iterator[carla.Client]:
    """A client of a server that has CARLA's Town01."""
    folder = tmp_path_factory.mktemp("town")
    with running(maps=town("Town01").parent, recordings=folder) as port:
        yield connect(port, folder)


def test_sensors_of_a_recording_of_carla_send_again(in_town: carla.Client) -> None:
    path, hero = carla_log("carla-0.9.13-lane-center.log"), 234
    way = way_of(path, hero)
    in_town.replay_file(str(path), 8.0, 0.0, 0, True)
    world = in_town.get_world()
    world.apply_settings(SYNCHRONOUS)
    actors = world.get_actors()
    (car,) = (actor for actor in actors.filter("vehicle.*") if actor.attributes["role_name"] == "hero")
    kinds = {"sensor.other.gnss", "sensor.other.imu", "sensor.camera.rgb"}
    data = [Data(actor) for actor in actors if actor.type_id in kinds and actor.parent and actor.parent.id == car.id]
    assert {each.sensor.type_id for each in data} == kinds
    start(world, *data)
    for _ in range(10):
        frame = world.tick()
        measured = [of_frame(each, frame) for each in data]
        assert max(each.transform.location.distance(car.get_location()) for each in measured) < 8.0
    along = [carla.Location(*map(float, place)) for place in zip(way.x, way.y, way.z, strict=True)]
    assert min(place.distance(car.get_location()) for place in along) < 0.6
    assert car.get_velocity().length() > 1.0
