"""Captures with sensors, as the official client sees the server beside them."""

from __future__ import annotations

import json
import math
import re
import signal
from collections import Counter
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.editing.recover import recover
from carla_recap.errors import RecapError
from carla_recap.server import running as server
from carla_recap.util.files import partials
from tests.capture.conftest import own_sensors, settle, started, wait_for
from tests.cli.command import error
from tests.samples import names_in, warnings_ignored
from tests.server.client import SYNCHRONOUS, ahead, connect, sensor, spawn
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.capture.conftest import Capture

    Starting = Callable[..., Capture]

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra `foxglove` is not installed")

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from carla_recap.sensors.messages import TRANSFORMS
from carla_recap.v1.sensors_pb2 import ImuReading, SpeedReading

KEPT = 6.0  # s of sensors' data that may be lost
EYE = {"x": 2.5, "y": 0.0, "z": 1.2}
RAYS = {"channels": 32, "range": 40, "points_per_second": 200_000, "upper_fov": 5, "lower_fov": -10}
EXACT = {"dropoff_general_rate": 0.0, "dropoff_intensity_limit": 0.0, "dropoff_zero_intensity": 0.0}
LIDAR = {"type": "sensor.lidar.ray_cast_semantic", "id": "labels", **EYE, **RAYS, "rotation_frequency": 20}
TOP = {**LIDAR, "type": "sensor.lidar.ray_cast", "id": "top", **EXACT}
SIZE = {"width": 320, "height": 240, "fov": 90}
CAMERAS = (("depth", "far"), ("instance_segmentation", "which"))
HALF = 4.79 / 2  # m: half of the length of the car
RIG = [
    {**TOP, "yaw": 30.0, "y": 0.5},
    {"type": "sensor.other.gnss", "id": "gnss", "z": 1.0},
    {"type": "sensor.other.imu", "id": "imu", "sensor_tick": 0.2},
    {"type": "sensor.speedometer", "id": "speed"},
]
POINT = np.dtype([("place", "<(3,)f4"), ("intensity", "<f4")])
LABELLED = np.dtype([("place", "<(3,)f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])


@pytest.fixture
def hero(world: carla.World) -> carla.Vehicle:
    return spawn(world, role_name="hero")


@pytest.fixture
def starting(capturing: Callable[..., Capture], world: carla.World, hero: carla.Vehicle, tmp_path: Path) -> Starting:
    """Start a capture of a world with a hero, and wait until it listens to all sensors of a rig."""

    def begin(rig: list[dict[str, Any]]) -> Capture:
        (tmp_path / "rig.json").write_text(json.dumps(rig))
        capture = capturing("a.mcap", "--rig", str(tmp_path / "rig.json"))
        actors = sum(sensor["type"] != "sensor.speedometer" for sensor in rig)
        wait_for(world, lambda: len(own_sensors(world)) == actors + 1)
        settle(capture.process)
        return capture

    return begin


def messages(path: Path, id: str, topic: str, kind: Any) -> dict[float, Any]:
    """Return the messages of a sensor by their times."""
    with open_recording(path) as recording:
        found = [each for each in recording.sensor_messages(id) if each.topic == f"/sensors/{id}/{topic}"]
    assert len({each.elapsed for each in found}) == len(found)
    return {each.elapsed: kind.FromString(each.data) for each in found}


def poses(path: Path, id: str) -> dict[float, tuple[Any, Any]]:
    """Return the places and the forward axes of a sensor by their times."""
    with open_recording(path) as recording:
        found = {}
        for each in recording.reader.further_messages([TRANSFORMS]):
            for transform in FrameTransforms.FromString(each.data).transforms:
                if transform.child_frame_id == id:
                    place, q = transform.translation, transform.rotation
                    ahead = 1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.z * q.w), 2 * (q.x * q.z - q.y * q.w)
                    found[each.elapsed] = np.array((place.x, place.y, place.z)), np.array(ahead)
    return found


def test_each_tick_has_a_sample_of_each_sensor(world: carla.World, hero: carla.Vehicle, starting: Starting) -> None:
    capture = starting(RIG)
    hero.apply_control(carla.VehicleControl(throttle=1.0, steer=0.3))
    first, places = world.get_snapshot().timestamp.elapsed_seconds, {}
    fixes, speeds = [], []
    for _ in range(20):
        world.tick()
        transform = hero.get_transform()
        places[world.get_snapshot().timestamp.elapsed_seconds] = transform
        fixes.append(world.get_map().transform_to_geolocation(hero.get_transform().transform(carla.Location(z=1.0))))
        speeds.append(hero.get_velocity().dot(transform.get_forward_vector()))
    said = capture.end(signal.SIGHUP)
    assert " samples, stopped by SIGHUP, " in said
    layout = capture.path.with_suffix(".foxglove.json")
    assert names_in(layout.parent) == ["a.foxglove.json", "a.lichtblick.json", "a.mcap", "rig.json"]
    assert f"the layout for Foxglove: {layout}\n" in said
    assert '"/sensors/top/points"' in layout.read_text()
    with open_recording(capture.path) as recording:
        times = {frame.elapsed: float(frame["visual_time"]["seconds"][0]) for frame in recording}
        counts = {sensor.id: (sensor.type, sensor.spec["y"]) for sensor in recording.sensors}
    assert counts["top"] == ("sensor.lidar.ray_cast", 0.5)
    ticked = [elapsed for elapsed, seconds in times.items() if seconds > first + 1e-6]
    assert len(ticked) == 20
    clouds = messages(capture.path, "top", "points", PointCloud)
    for id, found in (
        ("top", clouds),
        ("gnss", messages(capture.path, "gnss", "fix", LocationFix)),
        ("speed", messages(capture.path, "speed", "speed", SpeedReading)),
    ):
        assert [time for time in found if time >= ticked[0] - 1e-6] == pytest.approx(ticked, abs=2e-9), id
    readings = messages(capture.path, "imu", "imu", ImuReading)
    assert np.diff(list(readings)) == pytest.approx(0.2)
    assert [reading.acceleration_z for reading in readings.values()] == pytest.approx([9.81] * len(readings), abs=0.01)
    *_, turning = readings.values()  # to the right
    assert turning.acceleration_y < -0.01
    assert turning.angular_velocity_z < -0.01
    seen = poses(capture.path, "top")
    for elapsed, transform in zip(ticked, places.values(), strict=True):
        place, ahead = next(pose for time, pose in seen.items() if abs(time - elapsed) < 1e-6)
        expected = transform.transform(carla.Location(2.5, 0.5, 1.2))
        np.testing.assert_allclose(place, (expected.x, -expected.y, expected.z), atol=1e-3)
        turn = math.radians(-transform.rotation.yaw - 30.0)
        np.testing.assert_allclose(ahead[:2], (math.cos(turn), math.sin(turn)), atol=1e-3)
    fix = list(messages(capture.path, "gnss", "fix", LocationFix).values())[-1]
    assert (fix.latitude, fix.longitude) == pytest.approx((fixes[-1].latitude, fixes[-1].longitude), abs=1e-8)
    measured = [reading.speed for reading in messages(capture.path, "speed", "speed", SpeedReading).values()][-20:]
    assert measured == pytest.approx(speeds, abs=1e-3)
    assert speeds[-1] > 1.0
    wait_until(lambda: world.tick() and not own_sensors(world))


def test_cars_are_where_they_are(world: carla.World, hero: carla.Vehicle, starting: Starting) -> None:
    """One is 15 m ahead of the sensors, one beside it on the left."""
    pytest.importorskip("embreex", reason="embreex is not installed")
    there, cars = ahead(hero.get_transform(), 15.0 + EYE["x"] + HALF), []
    for _ in range(2):
        cars.append(spawn(world, at=there).id)
        there.location -= 6.0 * there.get_right_vector()
    cameras = [{"type": f"sensor.camera.{kind}", "id": id, **EYE, **SIZE} for kind, id in CAMERAS] if has_driver() else []
    capture = starting([LIDAR, TOP, *cameras])
    for _ in range(3):
        world.tick()
    capture.end()
    labels = np.frombuffer(last(capture.path, "labels", "points", PointCloud).data, LABELLED)
    middle, left = (labels["place"][labels["actor"] == id] for id in cars)
    assert middle[:, 0].min() == pytest.approx(15.0, abs=0.05)
    assert np.abs(middle[:, 1]).max() < 1.1
    assert -7.1 < -left[:, 1].max() < -left[:, 1].min() < -4.9
    cloud = np.frombuffer(last(capture.path, "top", "points", PointCloud).data, POINT)["place"]
    nearest = cloud[np.argmin(np.linalg.norm(cloud - middle[np.argmin(middle[:, 0])], axis=1))]
    assert nearest[0] == pytest.approx(15.0, abs=0.05)
    if cameras:
        depth = np.frombuffer(last(capture.path, "far", "depth", RawImage).data, "<u2").reshape(240, 320) / 1000.0
        ids = np.frombuffer(last(capture.path, "which", "instance", RawImage).data, "<u4").reshape(240, 320) & 0xFFFFFF
        assert depth[ids == cars[0]].min() == pytest.approx(15.0, abs=0.05)
        assert np.nonzero(ids == cars[0])[1].mean() == pytest.approx(159.5, abs=2.0)
        assert np.nonzero(ids == cars[1])[1].max() < 120


def last(path: Path, id: str, topic: str, kind: Any) -> Any:
    """Return the last message of a sensor."""
    return list(messages(path, id, topic, kind).values())[-1]


def has_driver() -> bool:
    """Return whether images can be drawn here."""
    try:
        from carla_recap.rendering.renderer import Renderer

        Renderer(models=()).close()
    except (RecapError, ImportError):
        return False
    return True


def test_every_image_of_every_tick_is_recorded(world: carla.World, starting: Starting) -> None:
    if not has_driver():
        pytest.skip("there is no driver to draw with")
    names = ["rgb", "depth", "semantic_segmentation", "instance_segmentation", "normals", "optical_flow"]
    size = {"x": -6.0, "y": 0.0, "z": 3.0, "width": 64, "height": 48}
    capture = starting([{"type": f"sensor.camera.{name}", "id": name, **size} for name in names])
    begin = world.get_snapshot().timestamp.elapsed_seconds
    for _ in range(10):
        world.tick()
    capture.end()
    with open_recording(capture.path) as recording:
        ticked = [frame.elapsed for frame in recording if float(frame["visual_time"]["seconds"][0]) > begin + 1e-6]
        for sensor in recording.sensors:
            (topic,) = (topic for topic in sensor.topics if not topic.endswith("/calibration"))
            times = [each.elapsed for each in recording.sensor_messages(sensor.id) if each.topic == topic]
            assert times[-10:] == pytest.approx(ticked, abs=2e-9), sensor.id
    semantic = list(messages(capture.path, "semantic_segmentation", "semantic", RawImage).values())[-1]
    instance = list(messages(capture.path, "instance_segmentation", "instance", RawImage).values())[-1]
    tags = np.frombuffer(semantic.data, np.uint8)
    ids = np.frombuffer(instance.data, "<u4") & 0xFFFFFF
    (car,) = (actor for actor in world.get_actors().filter("vehicle.*"))
    assert Counter(ids[tags == 14].tolist()).keys() == {car.id}


def test_existing_sensors_are_recorded_and_stay(port: int, world: carla.World, hero: carla.Vehicle, tmp_path: Path) -> None:
    mount = carla.Transform(carla.Location(0.5, 0.25, 2.0), carla.Rotation(yaw=10.0))
    lidar = sensor(world, "lidar.ray_cast", hero, mount, role_name="roof", range="25", channels="16")
    invader = sensor(world, "other.lane_invasion", hero)
    world.tick()
    with started(tmp_path / "a.mcap", port, "--sensors", "existing") as capture:
        wait_for(world, lambda: partials(capture.path))
        settle(capture.process)
        for _ in range(5):
            world.tick()
        capture.end()
    with open_recording(capture.path) as recording:
        (found,) = recording.sensors
    assert (found.id, found.type) == ("roof", "sensor.lidar.ray_cast")
    assert [found.spec[key] for key in ("x", "y", "z", "yaw")] == pytest.approx([0.5, 0.25, 2.0, 10.0], abs=1e-3)
    assert (found.spec["range"], found.spec["channels"]) == (25.0, 16)
    assert len(messages(capture.path, "roof", "points", PointCloud)) >= 5
    assert {lidar.id, invader.id} <= {actor.id for actor in world.get_actors().filter("sensor.*")}


@pytest.mark.parametrize(("lost", "said"), [("sensor", "sensor 'gnss' is gone"), ("hero", "the hero is gone")])
def test_the_end_of_a_sensor_or_of_the_hero_completes_it(
    world: carla.World, hero: carla.Vehicle, starting: Starting, lost: str, said: str
) -> None:
    capture = starting(RIG)
    for _ in range(5):
        world.tick()
    if lost == "hero":
        hero.destroy()
    else:
        next(actor for actor in own_sensors(world) if actor.type_id == "sensor.other.gnss").destroy()
    wait_for(world, lambda: capture.process.poll() is not None)
    assert f", {said}, " in capture.ended(1)
    assert len(messages(capture.path, "gnss", "fix", LocationFix)) >= 5
    wait_until(lambda: world.tick() and not own_sensors(world))


def test_the_end_of_all_existing_sensors_completes_it(
    port: int, world: carla.World, hero: carla.Vehicle, tmp_path: Path
) -> None:
    sensors = [sensor(world, f"other.{kind}", hero, role_name=kind) for kind in ("gnss", "imu")]
    world.tick()
    with started(tmp_path / "a.mcap", port, "--sensors", "existing") as capture:
        wait_for(world, lambda: partials(capture.path))
        settle(capture.process)
        world.tick()
        sensors[0].destroy()
        for _ in range(10):
            world.tick()
        settle(capture.process)
        assert capture.process.poll() is None
        sensors[1].destroy()
        wait_for(world, lambda: capture.process.poll() is not None)
        said = capture.ended(1)
    assert "warning: sensor 'gnss' is gone" in said
    assert ", all sensors are gone, " in said
    assert len(messages(capture.path, "imu", "imu", ImuReading)) > len(messages(capture.path, "gnss", "fix", LocationFix))


def test_the_end_of_the_server_completes_it(tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text(json.dumps(RIG))
    with ExitStack() as stack:
        port = stack.enter_context(server())
        world = connect(port).get_world()
        world.apply_settings(SYNCHRONOUS)
        spawn(world, role_name="hero")
        with started(tmp_path / "a.mcap", port, "--rig", str(tmp_path / "rig.json")) as capture:
            wait_for(world, lambda: len(own_sensors(world)) == 4)
            settle(capture.process)
            for _ in range(10):
                world.tick()
            settle(capture.process)
            stack.close()
            said = capture.ended()
    assert ", the server is gone, " in said
    assert "ERROR" not in said  # of CARLA's client, if it asked a server that is gone to destroy an actor
    assert len(messages(tmp_path / "a.mcap", "top", "points", PointCloud)) >= 10


def test_samples_that_come_while_memory_is_full_are_dropped_and_counted(
    port: int, world: carla.World, hero: carla.Vehicle, tmp_path: Path
) -> None:
    """In asynchronous mode, if making a message takes longer than the time between samples, there is no room for others."""
    (tmp_path / "rig.json").write_text(json.dumps([TOP]))
    world.apply_settings(carla.WorldSettings(fixed_delta_seconds=0.05))
    slow = "import time; from carla_recap.capture import sample_recorder as it; it.WAITING_LIMIT = 1; "
    slow += "make = it.SampleRecorder._make; it.SampleRecorder._make = lambda *given: (time.sleep(0.3), make(*given))[1]"
    with started(tmp_path / "a.mcap", port, "--rig", str(tmp_path / "rig.json"), "--duration", "2", before=slow) as capture:
        said = capture.ended()
    found = re.search(
        r": (\d+) frames, .* (\d+) samples?, (\d+) of top dropped, since writing was slower, the duration", said
    )
    assert found is not None, said
    frames, samples, dropped = map(int, found.groups())
    assert frames > 35  # none of them is dropped
    assert 3 <= samples < frames // 2 < dropped
    clouds = messages(capture.path, "top", "points", PointCloud)
    assert len(clouds) == samples
    with open_recording(capture.path) as recording:
        times = np.array([frame.elapsed for frame in recording])
    assert max(np.abs(times - time).min() for time in clouds) < 1e-6


def test_what_sensors_sent_survives_the_process(world: carla.World, starting: Starting, tmp_path: Path) -> None:
    capture = starting(RIG)
    for _ in range(180):
        world.tick()
    (left,) = partials(capture.path)
    recovered = tmp_path / "b.mcap"

    def saved_seconds() -> float:
        with suppress(RecapError), warnings_ignored():  # at first, nothing can be saved
            recover(left, recovered, force=True)
            return max(messages(recovered, "top", "points", PointCloud), default=0.0)
        return 0.0

    wait_until(lambda: saved_seconds() > 9.0 - KEPT, pause=0.2)
    capture.process.kill()
    capture.process.wait(PATIENCE)
    for each in own_sensors(world):
        each.destroy()
    assert recover(left, recovered, force=True).duration > 9.0 - KEPT
    clouds = messages(recovered, "top", "points", PointCloud)
    assert max(clouds) > 9.0 - KEPT
    assert len(clouds) > 40


def test_a_full_disk_is_an_error_of_one_line(port: int, world: carla.World, hero: carla.Vehicle, tmp_path: Path) -> None:
    """As on a full disk, the file cannot grow."""
    (tmp_path / "rig.json").write_text(json.dumps(RIG))
    limit = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))"
    with started(tmp_path / "a.mcap", port, "--rig", str(tmp_path / "rig.json"), before=limit) as capture:
        wait_until(lambda: world.tick() and capture.process.poll() is not None, pause=0.001)
        said = capture.ended(2)
    assert said.startswith(f"carla-recap: {tmp_path / 'a.mcap'}: cannot be written: File too large; "), said
    assert said.count("\n") == 1
    wait_until(lambda: world.tick() and not own_sensors(world))


@pytest.mark.parametrize(
    ("rig", "actor", "message"),
    [
        ([{**TOP, "range": -1}], "hero", "{rig}: sensor 'top': range: -1"),
        (RIG, "hero", "127.0.0.1:{port}: there is no hero to carry the rig; there are no vehicles"),
        (RIG, "4711", "127.0.0.1:{port}: there is no actor 4711 to carry the rig; there are no vehicles"),
    ],
)
def test_rigs_that_cannot_be_are_errors(
    port: int, world: carla.World, tmp_path: Path, rig: Any, actor: str, message: str
) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(rig))
    world.apply_settings(carla.WorldSettings())
    said = error("capture", tmp_path / "a.mcap", "--port", port, "--rig", path, "--actor", actor)
    assert said.startswith(message.format(rig=path, port=port))
    assert not (tmp_path / "a.mcap").exists()


def test_a_log_has_no_place_for_sensors(tmp_path: Path) -> None:
    assert error("capture", tmp_path / "a.log", "--sensors", "existing").endswith("an .mcap was expected")
