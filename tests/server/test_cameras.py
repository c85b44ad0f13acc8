"""Cameras and rays of a server, as the official client gets them."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import psutil
import pytest

from carla_recap.errors import RecapError
from carla_recap.scene.materials import Tag
from tests.server.client import SYNCHRONOUS, Data, connect, of_frame, sensor, serving, start, vehicle
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytest.importorskip("moderngl", reason="moderngl is not installed")
pytest.importorskip("embreex", reason="embreex is not installed")

SIZE = {"image_size_x": "320", "image_size_y": "240"}
EYE = carla.Transform(carla.Location(x=2.5, z=1.2))
HALF = 4.79 / 2  # m: half of the length of the car
SEMANTIC = np.dtype([("place", "<(3,)f4"), ("cosine", "<f4"), ("id", "<u4"), ("tag", "<u4")])


@pytest.fixture(scope="module", autouse=True)
def driver() -> None:
    """Skip without a driver."""
    from carla_recap.rendering.renderer import Renderer

    try:
        Renderer(models=()).close()
    except RecapError as error:
        pytest.skip(str(error))


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


def focal_length(image: Any) -> float:
    return float(image.width / 2 / np.tan(np.radians(image.fov) / 2))


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


def test_the_ground_is_as_far_as_the_camera_is_high(world: carla.World) -> None:
    high = carla.Transform(carla.Location(x=0.0, z=12.0), carla.Rotation(pitch=-90.0))
    car = vehicle(world)
    down, far = (Data(sensor(world, "camera.depth", car, high, fov=fov, **SIZE)) for fov in ("60", "20"))
    start(world, down, far)
    frame = world.tick()
    wide = metres(of_frame(down, frame))
    assert np.median(wide[:, :40]) == pytest.approx(12.0, abs=0.25)
    assert wide[120, 160] == pytest.approx(12.0 - car.bounding_box.extent.z * 2, abs=0.15)
    assert (metres(of_frame(far, frame)) < 11.5).mean() > (wide < 11.5).mean()


def test_the_colour_converters_of_carla_apply(world: carla.World) -> None:
    car = vehicle(world)
    vehicle(world, distance=14.9)
    depth, semantic = (
        Data(sensor(world, f"camera.{kind}", car, EYE, **SIZE)) for kind in ("depth", "semantic_segmentation")
    )
    start(world, depth, semantic)
    frame = world.tick()
    far, tags = of_frame(depth, frame), of_frame(semantic, frame)
    car_pixels = pixels(tags)[..., 0] == Tag.CAR
    exact = metres(far)
    far.convert(carla.ColorConverter.Depth)
    assert pixels(far)[..., 0] / 255 * 1000 == pytest.approx(exact, abs=4.0)
    tags.convert(carla.ColorConverter.CityScapesPalette)
    assert set(map(tuple, pixels(tags)[car_pixels].tolist())) == {(0, 0, 142)}


def test_fifty_ticks_have_fifty_images_of_each_camera(world: carla.World) -> None:
    car = vehicle(world)
    rgb, depth = (Data(sensor(world, f"camera.{kind}", car, EYE, **SIZE)) for kind in ("rgb", "depth"))
    start(world, rgb, depth)
    of_frame(rgb, frame := world.tick())
    of_frame(depth, frame)
    frames = [world.tick() for _ in range(50)]  # without waiting for the images
    for data in (rgb, depth):
        assert [data.get(timeout=PATIENCE).frame for _ in frames] == frames
        assert data.empty()


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
def test_lidar_points_are_where_a_depth_camera_sees_them(world: carla.World) -> None:
    """The same rays, at the same place: points in an image fall on pixels of the same depth, tag and id."""
    car = vehicle(world)
    vehicle(world, distance=14.9)
    mount = carla.Transform(carla.Location(x=1.0, z=2.2))
    rays = {"range": "80", "rotation_frequency": "20", "points_per_second": "400000", "channels": "64", "upper_fov": "5"}
    lidar = Data(sensor(world, "lidar.ray_cast_semantic", car, mount, **rays))
    size = {"image_size_x": "800", "image_size_y": "600"}
    depth, instance = (
        Data(sensor(world, f"camera.{kind}", car, mount, **size)) for kind in ("depth", "instance_segmentation")
    )
    start(world, lidar, depth, instance)
    frame = world.tick()
    points = np.frombuffer(of_frame(lidar, frame).raw_data, SEMANTIC)
    far, ids = of_frame(depth, frame), pixels(of_frame(instance, frame))
    x, y, z = points["place"].T.astype(np.float64)
    focal = focal_length(far)
    column, row = 400 + focal * y / np.where(x > 0.5, x, np.nan), 300 - focal * z / np.where(x > 0.5, x, np.nan)
    seen = np.flatnonzero((column > 1) & (column < 799) & (row > 1) & (row < 599))
    assert len(seen) > 1000
    pixel = row[seen].astype(int), column[seen].astype(int)
    difference = np.abs(metres(far)[pixel] - x[seen]) / x[seen]
    assert (difference < 0.03).mean() > 0.95
    same = (ids[pixel][:, 0] == points["tag"][seen]) & (
        ids[pixel][:, 1] + 256 * ids[pixel][:, 2] == points["id"][seen] % 65536
    )
    assert same[points["id"][seen] > 0].mean() > 0.9


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


def test_another_map_is_drawn_after_a_load(world: carla.World, client: carla.Client) -> None:
    text = world.get_map().to_opendrive()
    other = client.generate_opendrive_world(text)
    other.apply_settings(SYNCHRONOUS)
    rgb = Data(sensor(other, "camera.semantic_segmentation", vehicle(other), EYE, **SIZE))
    start(other, rgb)
    assert Tag.ROADS in pixels(of_frame(rgb, other.tick()))[..., 0]


def test_a_camera_on_a_replayed_actor_films_the_recording(world: carla.World, client: carla.Client) -> None:
    car, other = vehicle(world), vehicle(world, distance=14.9)
    client.start_recorder("film.log")
    car.apply_control(carla.VehicleControl(throttle=0.3))
    for _ in range(20):
        world.tick()
    client.stop_recorder()
    car.destroy()
    other.destroy()
    world.tick()
    client.replay_file("film.log", 0.0, 0.0, 0)
    world.tick()
    replayed = sorted(world.get_actors().filter("vehicle.*"), key=lambda actor: actor.id)
    instance = Data(sensor(world, "camera.instance_segmentation", replayed[0], EYE, **SIZE))
    start(world, instance)
    image = of_frame(instance, world.tick())
    tags, low, high = np.moveaxis(pixels(image), -1, 0)
    assert set((low + 256 * high)[tags == Tag.CAR].tolist()) == {replayed[1].id}


def test_a_camera_of_the_spectator_follows_it(world: carla.World) -> None:
    other = vehicle(world)
    spectator = world.get_spectator()
    semantic = Data(sensor(world, "camera.semantic_segmentation", spectator, carla.Transform(), **SIZE))
    start(world, semantic)
    place = other.get_transform()
    above = carla.Transform(place.location + carla.Location(z=12.0), carla.Rotation(pitch=-90.0, yaw=place.rotation.yaw))
    spectator.set_transform(above)
    world.tick()
    tags = pixels(of_frame(semantic, world.tick()))[..., 0]
    assert tags[120, 160] == Tag.CAR
    spectator.set_transform(carla.Transform(carla.Location(z=5.0), carla.Rotation(pitch=90.0)))
    world.tick()
    assert set(np.unique(pixels(of_frame(semantic, world.tick()))[..., 0]).tolist()) == {int(Tag.SKY)}


def test_in_asynchronous_mode_images_come_as_time_passes(world: carla.World) -> None:
    rgb = Data(sensor(world, "camera.rgb", vehicle(world), EYE, **SIZE))
    start(world, rgb)
    world.apply_settings(carla.WorldSettings())
    images = [rgb.get(timeout=PATIENCE) for _ in range(5)]
    assert all(later.frame > earlier.frame for earlier, later in pairwise(images))
    assert images[-1].frame <= world.wait_for_tick().frame


def test_two_clients_get_the_same_images_of_a_camera(world: carla.World, other_client: carla.Client) -> None:
    camera = sensor(world, "camera.rgb", vehicle(world), EYE, **SIZE)
    world.tick()
    mine, theirs = Data(camera), Data(other_client.get_world().get_actor(camera.id))
    start(world, mine, theirs)
    for _ in range(5):
        frame = world.tick()
        assert bytes(of_frame(mine, frame).raw_data) == bytes(of_frame(theirs, frame).raw_data)
    theirs.sensor.stop()
    for _ in range(5):
        of_frame(mine, world.tick())


def test_a_client_that_listens_again_gets_the_images_of_all_ticks(world: carla.World) -> None:
    camera = sensor(world, "camera.rgb", vehicle(world), EYE, **SIZE)
    for _ in range(3):
        rgb = Data(camera)
        start(world, rgb)
        for _ in range(3):
            of_frame(rgb, world.tick())
        camera.stop()
        world.tick()


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


def test_a_server_that_ends_while_images_are_drawn_leaves_no_process() -> None:
    with serving() as (process, port):
        client = connect(port)
        world = client.get_world()
        rgb = Data(sensor(world, "camera.rgb", vehicle(world), EYE, image_size_x="1920", image_size_y="1080"))
        rgb.get(timeout=PATIENCE)
        children = psutil.Process(process.pid).children(recursive=True)
        process.terminate()
        assert process.wait(PATIENCE) == 0
    assert children
    assert not psutil.wait_procs(children, PATIENCE)[1]


def test_a_server_that_is_killed_while_a_camera_loads_its_town_leaves_no_process() -> None:
    with serving(CARLA_RECAP_CACHE="") as (process, port):
        world = connect(port).get_world()
        sensor(world, "camera.rgb", vehicle(world), EYE)
        children = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        process.wait(PATIENCE)
    assert children
    assert not psutil.wait_procs(children, PATIENCE)[1]
