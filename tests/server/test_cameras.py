"""Cameras and rays of a server, as the official client gets them."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import psutil
import pytest

from carla_recap.scene.materials import Tag
from tests.server.client import Data, connect, of_frame, sensor, serving, start, vehicle
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytest.importorskip("embreex", reason="embreex is not installed")
pytestmark = pytest.mark.usefixtures("driver")

SIZE = {"image_size_x": "320", "image_size_y": "240"}
EYE = carla.Transform(carla.Location(x=2.5, z=1.2))
HALF = 4.79 / 2  # m: half of the length of the car
SEMANTIC = np.dtype([("place", "<(3,)f4"), ("cosine", "<f4"), ("id", "<u4"), ("tag", "<u4")])


@pytest.fixture
def ground(world: carla.World) -> None:
    """Wait until rays meet the ground."""
    lidar = Data(sensor(world, "lidar.ray_cast", None, carla.Transform(carla.Location(z=1.0)), lower_fov="-90"))
    wait_until(lambda: len(of_frame(lidar, world.tick())))
    lidar.sensor.destroy()


def pixels(image: Any) -> NDArray[np.int64]:
    """Return the red, green and blue of each pixel."""
    found = np.frombuffer(image.raw_data, np.uint8).reshape(image.height, image.width, 4)
    return found[:, :, 2::-1].astype(np.int64)


def metres(image: Any) -> NDArray[np.float64]:
    red, green, blue = np.moveaxis(pixels(image), -1, 0)
    found: NDArray[np.float64] = (red + 256 * green + 65536 * blue) / (2**24 - 1) * 1000.0
    return found


def test_a_car_ahead_is_in_all_images_where_it_is(world: carla.World) -> None:
    car, other = vehicle(world), vehicle(world, distance=14.9)
    kinds = ("rgb", "depth", "semantic_segmentation", "instance_segmentation", "normals")
    cameras = [Data(sensor(world, f"camera.{kind}", car, EYE, **SIZE)) for kind in kinds]
    start(world, *cameras)
    frame = world.tick()
    rgb, depth, semantic, instance, normals = (of_frame(data, frame) for data in cameras)
    inside = pixels(semantic)[..., 0] == Tag.CAR
    assert 300 < inside.sum() < 5000
    assert inside[130, 160]
    assert metres(depth)[inside].min() == pytest.approx(14.9 - HALF - 2.5, abs=0.05)
    tags, low, high = np.moveaxis(pixels(instance), -1, 0)
    assert (tags == pixels(semantic)[..., 0]).all()
    assert set((low + 256 * high)[inside].tolist()) == {other.id}
    assert set(np.unique(tags).tolist()) >= {Tag.ROADS, Tag.SKY, Tag.CAR}
    ground = tags == Tag.ROADS
    assert pixels(normals)[ground].mean(axis=0) == pytest.approx([128, 128, 255], abs=3)
    sky = pixels(rgb)[tags == Tag.SKY].mean(axis=0)
    assert sky[2] > sky[0]
    assert metres(depth)[tags == Tag.SKY].min() > 999.9


def test_optical_flow_of_what_stands_still_is_zero_and_the_ground_moves_down(world: carla.World) -> None:
    car = vehicle(world)
    flow = Data(sensor(world, "camera.optical_flow", car, EYE, **SIZE))
    start(world, flow)
    still = np.array([(pixel.x, pixel.y) for pixel in of_frame(flow, world.tick())])
    assert np.abs(still).max() < 1e-4
    car.apply_control(carla.VehicleControl(throttle=1.0))
    for _ in range(40):
        last = of_frame(flow, world.tick())
    moved = np.array([(pixel.x, pixel.y) for pixel in last]).reshape(240, 320, 2)
    assert np.abs(moved[:60]).max() < 0.02  # the sky
    assert np.abs(moved[-20:, 140:180, 1]).min() > 0.005


def test_an_event_camera_sees_changes_alone(world: carla.World) -> None:
    car = vehicle(world)
    dvs = Data(sensor(world, "camera.dvs", car, EYE, positive_threshold="0.1", negative_threshold="0.1", **SIZE))
    start(world, dvs)
    world.tick()
    assert len(of_frame(dvs, world.tick())) == 0
    other = vehicle(world, distance=14.9)
    events = of_frame(dvs, world.get_snapshot().frame)
    assert len(events) > 100
    found = np.frombuffer(events.raw_data, np.dtype([("x", "<u2"), ("y", "<u2"), ("t", "<i8"), ("polarity", "?")]))
    assert (np.diff(found["t"]) >= 0).all()
    assert 100 < found["x"].mean() < 220
    assert other.is_alive


def test_weather_is_seen(world: carla.World) -> None:
    rgb = Data(sensor(world, "camera.rgb", vehicle(world), EYE, **SIZE))
    start(world, rgb)
    world.set_weather(carla.WeatherParameters.ClearNoon)
    day = pixels(of_frame(rgb, world.tick())).mean()
    world.set_weather(carla.WeatherParameters(sun_altitude_angle=-90.0))
    world.tick()
    night = pixels(of_frame(rgb, world.tick())).mean()
    world.set_weather(carla.WeatherParameters.ClearNoon)
    assert night < day / 2


@pytest.mark.usefixtures("ground")
def test_a_lidar_meets_the_road_and_the_car_ahead(world: carla.World) -> None:
    car, other = vehicle(world), vehicle(world, distance=14.9)
    rays = {"range": "60", "rotation_frequency": "20", "points_per_second": "200000", "channels": "32"}
    lidar = Data(sensor(world, "lidar.ray_cast_semantic", car, carla.Transform(carla.Location(z=2.0)), **rays))
    start(world, lidar)
    found = np.frombuffer(of_frame(lidar, world.tick()).raw_data, SEMANTIC)
    road = found[found["tag"] == Tag.ROADS]
    assert len(road) > 1000
    near = road[np.linalg.norm(road["place"][:, :2], axis=1) < 15.0]
    assert (np.abs(near["place"][:, 2] + 2.0) < 0.05).mean() > 0.95
    hits = found[found["id"] == other.id]
    assert len(hits) > 20
    assert set(hits["tag"].tolist()) == {Tag.CAR}
    assert hits["place"][:, 0].min() == pytest.approx(14.9 - HALF, abs=0.15)
    assert car.id not in found["id"]


@pytest.mark.usefixtures("ground")
def test_a_level_obstacle_detector_does_not_report_the_road(world: carla.World) -> None:
    car = vehicle(world)
    down = carla.Transform(carla.Location(x=2.5, z=1.0), carla.Rotation(pitch=-45.0))
    level = Data(sensor(world, "other.obstacle", car, EYE, distance="20"))
    slanting = Data(sensor(world, "other.obstacle", car, down, distance="20", hit_radius="0.2"))
    start(world, slanting)
    event = of_frame(slanting, world.tick())
    assert event.other_actor.type_id == "static.road"
    assert event.distance == pytest.approx((1.0 - 0.2) * np.sqrt(2), abs=0.1)
    assert level.empty()


def test_the_world_is_loaded_anew_while_images_are_drawn(world: carla.World, client: carla.Client) -> None:
    for _ in range(3):
        large = Data(sensor(world, "camera.rgb", vehicle(world), EYE, image_size_x="1280", image_size_y="720"))
        start(world, large)
        for _ in range(2):
            world.tick()
        world = client.reload_world(False)
    semantic = Data(sensor(world, "camera.semantic_segmentation", vehicle(world), EYE, **SIZE))
    start(world, semantic)
    assert Tag.ROADS in pixels(of_frame(semantic, world.tick()))[..., 0]


@pytest.mark.parametrize("draws", [True, False], ids=["ends while images are drawn", "is killed while a town is loaded"])
def test_a_server_leaves_no_process(draws: bool) -> None:
    with serving(**({} if draws else {"CARLA_RECAP_CACHE": ""})) as (process, port):
        world = connect(port).get_world()
        camera = sensor(world, "camera.rgb", vehicle(world), EYE, image_size_x="1920", image_size_y="1080")
        if draws:
            Data(camera).get(timeout=PATIENCE)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGTERM if draws else signal.SIGKILL)
        assert process.wait(PATIENCE) == (0 if draws else -signal.SIGKILL)
    assert children
    assert not psutil.wait_procs(children, PATIENCE)[1]
