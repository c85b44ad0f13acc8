from __future__ import annotations

import carla
import pytest

from tests.waiting import PATIENCE, wait_until


def test_the_client_takes_the_server_for_its_own_version(client: carla.Client) -> None:
    assert client.get_server_version() == client.get_client_version() == "0.9.16"


def test_each_tick_is_a_frame_of_the_fixed_length(world: carla.World) -> None:
    frame = world.tick()
    before = world.get_snapshot()
    assert before.frame == frame
    assert world.tick() == frame + 1
    after = world.get_snapshot()
    assert after.timestamp.elapsed_seconds - before.timestamp.elapsed_seconds == pytest.approx(0.05)
    assert after.timestamp.delta_seconds == pytest.approx(0.05)


def test_asynchronous_time_passes_by_itself(world: carla.World) -> None:
    world.apply_settings(carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=0.02))
    frames = [world.wait_for_tick(PATIENCE).frame for _ in range(3)]
    assert frames == sorted(set(frames))


def test_the_map_is_the_towns(world: carla.World) -> None:
    assert world.get_map().name == "Carla/Maps/Brickfield"
    points = world.get_map().get_spawn_points()
    assert world.get_map().get_waypoint(points[0].location).transform.location.distance(points[0].location) < 1.0


def test_the_weather_is_kept(world: carla.World) -> None:
    world.set_weather(carla.WeatherParameters.HardRainNoon)
    assert world.get_weather() == carla.WeatherParameters.HardRainNoon


def test_a_late_subscriber_gets_the_latest_snapshot(world: carla.World, other_client: carla.Client) -> None:
    frame = world.tick()
    theirs = other_client.get_world()
    wait_until(lambda: theirs.get_snapshot().frame >= frame)  # in synchronous mode get_world does not wait for the first one
