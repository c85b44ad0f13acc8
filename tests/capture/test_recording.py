"""Captures of a server, beside the recordings that it makes itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import pytest

from carla_recap import RecapError, RecapWarning, open_recording
from carla_recap.capture.actors import ActorTracker
from carla_recap.capture.observer import Observation
from carla_recap.capture.recording import capture, frames, header_of
from tests.capture.conftest import own_sensors, settle, started, wait_for
from tests.cli.command import error
from tests.server.client import ahead, place, sensor, spawn
from tests.waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from carla_recap import Frame, Spawn
    from tests.capture.conftest import Capture

    Capturing = Callable[..., Capture]

NEAR = {"rtol": 2e-7, "atol": 5e-4}  # float32, of metres and of centimetres
STATES = ("transforms", "velocities", "vehicle_controls", "walker_controls", "vehicle_lights", "light_states")


def drive(client: carla.Client, world: carla.World, capture: Capture) -> str:
    """Record a hero that hits a parked van, actors that come and go, a walker, lights that change; return the recording."""
    hero = next(actor for actor in world.get_actors() if actor.attributes.get("role_name") == "hero")
    there = ahead(hero.get_transform(), 15.0)
    van = place(world, "vehicle.volkswagen.t2", there)
    there.location += 10.0 * there.get_right_vector()
    walker = place(world, "walker.pedestrian.0001", there)
    world.tick()
    van.apply_control(carla.VehicleControl(hand_brake=True, reverse=True))
    van.set_light_state(carla.VehicleLightState(carla.VehicleLightState.Brake | carla.VehicleLightState.Position))
    light = world.get_actors().filter("traffic.traffic_light")[0]
    light.set_state(carla.TrafficLightState.Yellow)
    settle(capture.process)  # the lights of vehicles are asked for now and then
    path = client.start_recorder("own.mcap", True)
    hero.apply_control(carla.VehicleControl(throttle=1.0, steer=0.01))
    walker.apply_control(carla.WalkerControl(carla.Vector3D(0.0, 1.0, 0.0), 1.5))
    late = None
    for tick in range(80):
        if tick == 20:
            late = place(world, "vehicle.audi.tt", world.get_map().get_spawn_points()[7])
            mount = carla.Transform(carla.Location(1.0, 0.5, 2.0), carla.Rotation(yaw=30.0))
            sensor(world, "other.imu", late, mount)
        if tick == 60 and late is not None:
            late.destroy()
        world.tick()
    client.stop_recorder()
    return path


def test_a_capture_equals_the_recording_of_the_server(
    client: carla.Client, world: carla.World, capturing: Capturing
) -> None:
    spawn(world, role_name="hero")
    capture = capturing("captured.mcap", "--additional-data")
    path = drive(client, world, capture)
    own = {actor.id for actor in own_sensors(world)}
    said = capture.end()
    assert " s, stopped by SIGINT, " in said
    assert "missed" not in said
    theirs, ours = frames_of(path), frames_of(capture.path)
    begin = next(index for index, frame in enumerate(ours) if time_of(frame) == time_of(theirs[0]))
    ours = ours[begin : begin + len(theirs)]
    assert len(theirs) == len(ours) == 80
    np.testing.assert_allclose([time_of(frame) for frame in ours], [time_of(frame) for frame in theirs])
    np.testing.assert_allclose([f.duration for f in ours[:-1]], [f.duration for f in theirs[:-1]], rtol=1e-6)
    for mine, other in zip(ours, theirs, strict=True):
        for name in STATES:
            assert_near(mine[name], other[name])
    for name in ("destroyed", "collisions"):
        assert records_named(name, ours) == records_named(name, theirs)
    assert len(records_named("collisions", ours)) > 1
    for mine, other in zip(ours[1:], theirs[1:], strict=True):  # the others began before
        assert_near(mine["bounding_boxes"], other["bounding_boxes"])
        assert [physics.id for physics in mine["physics"]] == [physics.id for physics in other["physics"]]
    for mine, other in zip(spawns(ours, own), spawns(theirs, own), strict=True):
        assert (mine.id, mine.kind, mine.type_id, mine.attributes) == (other.id, other.kind, other.type_id, other.attributes)
        np.testing.assert_allclose(pose_of(mine), pose_of(other), atol=5e-3)  # differences of places in the world
    assert len(spawns(ours, own)) == 2


def frames_of(path: Path | str) -> list[Frame]:
    with open_recording(path) as recording:
        return list(recording)


def time_of(frame: Frame) -> float:
    """Seconds of the episode."""
    return float(frame["visual_time"]["seconds"][0])


def pose_of(spawned: Spawn) -> list[float]:
    return [getattr(spawned, axis) for axis in ("x", "y", "z", "roll", "pitch", "yaw")]


def records_named(name: str, frames: list[Frame]) -> list[tuple[int, Any]]:
    """Return all records of a type, each with the index of its frame."""
    return [(index, row.item()) for index, frame in enumerate(frames) for row in frame[name]]


def spawns(frames: list[Frame], own: set[int]) -> list[Spawn]:
    """Who came later, but for the sensors that the capture brings along."""
    return [spawned for frame in frames[1:] for spawned in frame["spawned"] if spawned.id not in own]


def assert_near(ours: Any, theirs: Any) -> None:
    ours, theirs = np.sort(ours, order="id"), np.sort(theirs, order="id")
    for field in theirs.dtype.names:
        np.testing.assert_allclose(ours[field], theirs[field], err_msg=field, **NEAR)


def test_the_first_frame_contains_all_data_of_present_actors(
    client: carla.Client, world: carla.World, capturing: Capturing
) -> None:
    hero = spawn(world, role_name="hero")
    world.set_weather(carla.WeatherParameters.HardRainNoon)
    world.tick()
    capture = capturing("captured.mcap", "--additional-data")
    box, mass = hero.bounding_box, hero.get_physics_control().mass
    wait_for(world, lambda: world.get_snapshot().frame > 20)
    capture.end()
    first = frames_of(capture.path)[0]
    (spawned,) = (spawned for spawned in first["spawned"] if spawned.id == hero.id)
    assert (spawned.type_id, spawned.attribute("role_name")) == ("vehicle.tesla.model3", "hero")
    assert {attribute.key: attribute.type for attribute in spawned.attributes}["number_of_wheels"] == 1
    (row,) = first["bounding_boxes"][first["bounding_boxes"]["id"] == hero.id]
    assert row["extent_x"] == pytest.approx(100 * box.extent.x)
    assert [physics.mass for physics in first["physics"]] == [pytest.approx(mass)]
    assert first["weather"]["precipitation"][0] == pytest.approx(world.get_weather().precipitation)
    assert set(first["light_times"]["id"]) == set(first["light_states"]["id"])
    assert not any(spawned.type_id.startswith("sensor.") for spawned in first["spawned"])  # not even its own
    wait_until(lambda: world.tick() and not own_sensors(world))


def test_it_ends_after_a_duration(port: int, world: carla.World, tmp_path: Path) -> None:
    with started(tmp_path / "a.mcap", port, "--duration", "1") as capture:
        wait_for(world, lambda: capture.process.poll() is not None)
        assert capture.ended().partition("a.mcap: ")[2].startswith("21 frames, 1 s, the duration has passed, ")
    assert [frame.duration for frame in frames_of(capture.path)][-2:] == [pytest.approx(0.05), -1.0]


def test_a_missing_server_is_an_error() -> None:
    assert error("capture", "a.mcap", "--port", 1) == "127.0.0.1:1: there is no CARLA server"
    assert error("capture", "a.mcap", "--port", 1, "--host", "a..b") == "a..b:1: there is no CARLA server"


def test_the_name_of_the_map_has_no_folder() -> None:
    observer: Any = SimpleNamespace(map=SimpleNamespace(name="Carla/Maps/Town01"))
    assert header_of(observer).map_name == "Town01"


def test_an_actor_that_the_client_cannot_read_is_left_out() -> None:
    """CARLA's client raises a ValueError for attributes such as the color '256,0,0'."""

    class Listed(list[Any]):
        def __getitem__(self, index: Any) -> Any:
            return super().__getitem__(index) or int("256,0,0")

    sound = SimpleNamespace(id=501, type_id="vehicle.tesla.model3", attributes={"role_name": "hero"})
    world: Any = SimpleNamespace(get_blueprint_library=list, get_actors=lambda _: Listed([None, sound]))
    tracker = ActorTracker(world, additional_data=False)
    snapshots: Any = {500: None, 501: None}
    with pytest.warns(RecapWarning, match="cannot make out are left out: 500$"):
        assert tracker.update(snapshots) == ([sound], [])
    assert (tracker.present, tracker.heroes) == ({500, 501}, {501})


def test_frames_last_until_the_next_one() -> None:
    observations = [Observation(frame, 2.0 + time, 7.0 + 2 * time, {}) for frame, time in ((5, 0.0), (6, 0.05), (9, 0.2))]
    sampled = list(frames(observations, additional_data=True))
    assert [(frame.id, frame.elapsed, frame.duration) for frame in sampled] == [
        (1, 0.0, pytest.approx(0.05)),
        (2, pytest.approx(0.05), pytest.approx(0.15)),
        (3, pytest.approx(0.2), -1.0),
    ]
    assert [frame["platform_time"]["seconds"][0] for frame in sampled] == pytest.approx([0.0, 0.1, 0.4])
    assert [frame["visual_time"]["seconds"][0] for frame in sampled] == pytest.approx([2.0, 2.05, 2.2])


@pytest.mark.parametrize(("name", "message"), [("a.xyz", "unknown format"), ("file/a.log", "a folder was expected")])
def test_an_invalid_destination_is_refused_before_a_server_is_asked(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecapError, match=message):
        capture(tmp_path / name, port=1)
