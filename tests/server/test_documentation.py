"""What CARLA's documentation shows runs here as it stands there: on its recorder, world and client, and on synchrony."""

from __future__ import annotations

import queue
import re
import shutil
from typing import TYPE_CHECKING, Any

import carla
import pytest

from carla_recap.sim import World, load_town
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def vehicle(world: carla.World) -> carla.Vehicle:
    blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
    vehicle = world.spawn_actor(blueprint, world.get_map().get_spawn_points()[0])
    world.tick()
    return vehicle


@pytest.fixture(scope="module")
def camera(recordings: Path) -> int:
    """The id of a vehicle that is in recording01.log, col2.log and col3.log, of 5 s each."""
    names = ("recording01.log", "col2.log", "col3.log")
    with World(load_town()) as world:
        vehicle = world.spawn("vehicle.tesla.model3", world.town.spawn_points[0])
        path = world.start_recorder(recordings / names[0])
        world.run(5.05)
    for name in names[1:]:
        shutil.copy(path, recordings / name)
    return vehicle.id


# --- the recorder --------------------------------------------------------------------------------------------------------


def test_simulation_playback(client: carla.Client, world: carla.World, camera: int) -> None:
    for start, duration, told in ((1.0, 2.0, "from 1 s - 3 s"), (-2.0, 0.0, "from 3 s - 5 s"), (0.0, 0.0, "from 0 s - 5 s")):
        answer = client.replay_file("recording01.log", start, duration, camera)
        assert f"Replaying {told} (5 s) at 1.0x\n" in answer
        world.tick()
        (car,) = world.get_actors().filter("vehicle.*")
        assert car.get_location().distance(world.get_spectator().get_location()) == pytest.approx(125**0.5, abs=0.1)
    client.replay_file("recording01.log", 0, 0, 0)
    client.stop_replayer(False)


def test_setting_a_time_factor(client: carla.Client, world: carla.World, camera: int) -> None:
    client.set_replayer_time_factor(2.0)
    assert "at 2.0x\n" in client.replay_file("recording01.log", 0, 0, 0)
    client.set_replayer_time_factor(20.0)
    for _ in range(6):
        world.tick()
    client.set_replayer_time_factor(1.0)
    (car,) = world.get_actors().filter("vehicle.*")
    assert car.get_velocity().length() == 0.0
    for _ in range(40):
        world.tick()
    assert car.get_velocity().length() > 1.0  # the replay is over, and the autopilot drives


def test_recorded_file(client: carla.Client, camera: int) -> None:
    for answer in (
        client.show_recorder_file_info("recording01.log", show_all=False),  # which the client wants to be told
        client.show_recorder_file_info("recording01.log", show_all=True),
    ):
        assert re.match(
            r"Version: 1\nMap: Brickfield\nDate: \d\d/\d\d/\d\d \d\d:\d\d:\d\d\n\nFrame 1 at 0 seconds\n Create ", answer
        )
        assert f" Create {camera}: vehicle.tesla.model3 (1) at (" in answer
        assert "\n  number_of_wheels = 4\n" in answer
        assert answer.endswith("\n\nFrames: 101\nDuration: 5 seconds\n")


# --- world and client ----------------------------------------------------------------------------------------------------


def test_world_connection(client: carla.Client) -> None:
    first = client.get_world()
    assert any(name.endswith("Brickfield") for name in client.get_available_maps())
    second = client.load_world("Brickfield")
    third = client.reload_world()
    assert len({world.id for world in (first, second, third)}) == 3
    assert client.get_world().id == third.id


def test_street_lights(world: carla.World) -> None:
    lmanager = world.get_lightmanager()
    my_lights = lmanager.get_all_lights(carla.LightGroup.Building)
    assert list(lmanager.get_all_lights()) == list(my_lights) == []
    lmanager.turn_on(my_lights)
    lmanager.set_color(my_lights, carla.Color(255, 0, 0))
    lmanager.set_intensities(my_lights, [])
    world.tick()


def test_debugging(world: carla.World, vehicle: carla.Vehicle) -> None:
    frame = world.get_snapshot().frame
    actor_snapshot = world.get_snapshot().find(vehicle.id)
    debug = world.debug
    place = actor_snapshot.get_transform()
    box = carla.BoundingBox(place.location, carla.Vector3D(0.5, 0.5, 2))
    debug.draw_box(box, place.rotation, 0.05, carla.Color(255, 0, 0, 0), 0)
    assert world.tick() == frame + 1


def test_world_snapshots(world: carla.World, vehicle: carla.Vehicle) -> None:
    world_snapshot = world.get_snapshot()
    timestamp = world_snapshot.timestamp
    assert timestamp.frame == world_snapshot.frame
    seen = set()
    for actor_snapshot in world_snapshot:
        actual_actor = world.get_actor(actor_snapshot.id)
        seen.add(actual_actor.id)
        assert actor_snapshot.get_transform() == actual_actor.get_transform()
        assert actor_snapshot.get_velocity() == actual_actor.get_velocity()
        assert actor_snapshot.get_angular_velocity() == actual_actor.get_angular_velocity()
        assert actor_snapshot.get_acceleration() == actual_actor.get_acceleration()
        assert world_snapshot.find(actual_actor.id).id == actual_actor.id
    assert vehicle.id in seen


# --- synchrony and time step ---------------------------------------------------------------------------------------------


def test_fixed_time_step(world: carla.World) -> None:
    settings = world.get_settings()
    settings.synchronous_mode = False
    settings.fixed_delta_seconds = 0.05
    world.apply_settings(settings)
    deltas = [world.wait_for_tick().timestamp.delta_seconds for _ in range(5)]
    assert deltas == pytest.approx([0.05] * 5)


def test_synchronous_mode(world: carla.World, vehicle: carla.Vehicle) -> None:
    settings = world.get_settings()
    settings.synchronous_mode = True
    world.apply_settings(settings)
    blueprint = world.get_blueprint_library().find("sensor.other.gnss")
    for _ in range(10):
        sensor = world.spawn_actor(blueprint, carla.Transform(), attach_to=vehicle)
        data_queue: queue.Queue[Any] = queue.Queue()
        sensor.listen(data_queue.put)
        for _ in range(3):
            frame = world.tick()
            assert data_queue.get(timeout=PATIENCE).frame == frame
        sensor.destroy()
