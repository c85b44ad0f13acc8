"""The sample scripts, each run as a user runs it."""

from __future__ import annotations

import importlib
import re
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.server import running
from carla_recap.sim import World, load_town
from carla_recap.sim.scenarios import Crash
from tests.samples import SAMPLES
from tests.server.client import free_port
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
BEHIND = (10.0**2 + 5.0**2) ** 0.5
"""m: how far the camera is from whom it follows."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a hero that runs over a walker and into a van, after it has stood for 5 s."""
    folder = tmp_path_factory.mktemp("recordings")
    world = World(load_town(), seed=1, date=0)
    Crash(world)
    world.start_recorder(folder / "staged.log")
    world.run(20.0)
    world.close()
    return folder


@pytest.fixture(scope="module")
def port(recordings: Path) -> Iterator[int]:
    """A server that has the recording."""
    with running(recordings=recordings) as port:
        yield port


@pytest.fixture(scope="module")
def traffic() -> int:
    """A port for a traffic manager."""
    return free_port()


def command(port: int, script: str, *arguments: object) -> list[str]:
    return [sys.executable, str(SAMPLES / f"{script}.py"), f"--port={port}", *map(str, arguments)]


def output_of(port: int, script: str, *arguments: object) -> str:
    done = subprocess.run(command(port, script, *arguments), capture_output=True, text=True, timeout=PATIENCE)
    assert not done.returncode, done.stdout + done.stderr
    return done.stdout


def test_queries(client: carla.Client, port: int) -> None:
    recording, van = ("-f", "staged.log"), "vehicle.mercedes.sprinter"
    assert output_of(port, "show_recorder_file_info", *recording) == client.show_recorder_file_info("staged", False) + "\n"
    everything = output_of(port, "show_recorder_file_info", *recording, "-a")
    assert everything == client.show_recorder_file_info("staged.log", True) + "\n"
    assert " Positions: " in everything
    assert van in output_of(port, "show_recorder_collisions", *recording)
    walkers = output_of(port, "show_recorder_collisions", *recording, "-t", "hw")
    assert "walker.pedestrian.0004" in walkers
    assert van not in walkers
    with pytest.raises(AssertionError, match="-t hvw: expected two letters"):
        output_of(port, "show_recorder_collisions", "-t", "hvw")
    assert van not in output_of(port, "show_recorder_actors_blocked", *recording)
    assert van in output_of(port, "show_recorder_actors_blocked", "-f", "staged", "-t", 10, "-d", 50)


def test_replaying(client: carla.Client, world: carla.World, port: int) -> None:
    (id,) = re.findall(r"Create (\d+): vehicle\.tesla", client.show_recorder_file_info("staged", False))
    answer = output_of(port, "start_replaying", "-f", "staged.log", "-s", 8, "-d", 5, "-c", id, "-x", 0.5)
    assert "Replaying from 8 s - 13 s (19.95 s) at 0.5x\nIgnoring Spectator camera\n" in answer
    for _ in range(10):
        world.tick()
    (hero,) = world.get_actors().filter("vehicle.tesla.*")
    assert hero.get_location().distance(world.get_spectator().get_location()) == pytest.approx(BEHIND, abs=0.1)
    answer = output_of(port, "start_replaying", "-f", "staged.log", "--ignore-hero", "--move-spectator", "--spawn-sensors")
    assert "at 1.0x\nIgnoring Hero vehicle\n" in answer
    assert "Ignoring Spectator" not in answer
    world.tick()
    assert not world.get_actors().filter("vehicle.tesla.*")
    client.set_replayer_ignore_hero(False)


def test_synchronous_mode(client: carla.Client, port: int) -> None:
    lines = output_of(port, "synchronous_mode", "-t", 8).splitlines()
    frames = [int(frame) for frame in re.findall(r"frame (\d+): -?\d+\.\d{6}, -?\d+\.\d{6}", "\n".join(lines))]
    assert frames == list(range(frames[0], frames[0] + 8 * 20, 20))
    assert any(line.endswith("collision with vehicle.audi.tt") for line in lines)


def test_the_hero_is_driven_anew(client: carla.Client, world: carla.World, port: int, traffic: int) -> None:
    output = output_of(port, "drive_hero_anew", "-f", "staged.log", "-s", 5, "-t", 8, "--tm-port", traffic)
    assert "Ignoring Hero vehicle\n" in output
    seconds = re.findall(r"^ +(\d+)\.0 s: \(-?[\d.]+, -?[\d.]+\) at (\d+) km/h$", output, re.MULTILINE)
    assert [int(second) for second, _ in seconds] == list(range(5, 13))
    assert max(int(speed) for _, speed in seconds) > 15
    world.tick()
    assert not world.get_actors().filter("vehicle.*")


def test_a_hero_that_finds_no_room_for_its_obstacle_is_gone(
    world: carla.World, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(SAMPLES)
    straight_roads = importlib.import_module("common").straight_roads
    _, end = next(straight_roads(world, 40.0))
    assert world.try_spawn_actor(world.get_blueprint_library().find("vehicle.audi.tt"), end) is not None
    with subprocess.Popen(command(port, "crash_hero", "--length", 40), stdout=subprocess.PIPE, text=True) as script:
        wait_until(lambda: world.tick() and script.poll() is not None, pause=0.001)
        said, _ = script.communicate(timeout=PATIENCE)
    assert "has run into vehicle.audi.tt" in said
    world.tick()
    assert len(world.get_actors().filter("vehicle.*")) == 1


def test_a_crash_in_traffic_is_recorded_found_and_replayed(client: carla.Client, port: int, traffic: int) -> None:
    """As a user would: 30 cars, a hero that crashes, queries, and a replay from 2 s before the crash, behind the hero."""
    world = client.get_world()
    world.apply_settings(carla.WorldSettings(synchronous_mode=False))
    record = command(port, "start_recording", "-f", "crash", "-n", 30, "--safe", "--tm-port", traffic)
    with subprocess.Popen(record, stdout=subprocess.PIPE, text=True) as recording:
        assert recording.stdout is not None
        assert "crash.mcap" in recording.stdout.readline()
        assert recording.stdout.readline() == "spawned 30 vehicles, press Ctrl+C to exit.\n"
        hero = int(output_of(port, "crash_hero", "--length", 40).split()[1])
        recording.send_signal(signal.SIGINT)
        assert recording.stdout.read() == "Stopped recording, destroyed 30 vehicles.\n"
    assert not recording.returncode

    created = re.findall(r"Create (\d+): vehicle\.", output_of(port, "show_recorder_file_info", "-f", "crash"))
    assert len(created) >= 32  # a hero may have found no room for its obstacle, and tried elsewhere
    row = re.search(
        rf"^ +(\d+)   v v +{hero} vehicle", output_of(port, "show_recorder_collisions", "-f", "crash", "-t", "hv"), re.M
    )
    assert row is not None
    crash = int(row[1])

    answer = output_of(port, "start_replaying", "-f", "crash", "-s", crash - 2, "-d", 3, "-c", hero)
    assert f"Replaying from {crash - 2} s - {crash + 1} s" in answer
    begin = world.wait_for_tick()
    (car,) = (car for car in world.get_actors().filter("vehicle.*") if car.attributes["role_name"] == "hero")
    spectator, speeds, moment = world.get_spectator(), [], begin
    while moment.timestamp.elapsed_seconds < begin.timestamp.elapsed_seconds + 2.0:
        moment = world.wait_for_tick()
        hero_now, camera = moment.find(car.id), moment.find(spectator.id)
        assert hero_now.get_transform().location.distance(camera.get_transform().location) == pytest.approx(BEHIND, abs=0.01)
        speeds.append(hero_now.get_velocity().length())
    assert max(speeds) > 5.0
    assert len(world.get_actors().filter("vehicle.*")) == 32


# --- cameras -------------------------------------------------------------------------------------------


def pictures_of(port: int, script: str, folder: Path, count: int) -> str:
    """Return what a script with cameras prints; it saves some pictures, of the size of its cameras."""
    pytest.importorskip("embreex", reason="embreex is not installed")
    image_of = pytest.importorskip("PIL.Image", reason="PIL is not installed").open
    text = output_of(port, script, "-o", folder, "-t", count / 2)
    saved = sorted(folder.glob("*.png"))
    assert len(saved) == count
    for path in saved:
        with image_of(path) as image:
            assert image.size == (800, 600)
    return text


@pytest.mark.usefixtures("driver", "client")
def test_a_pair_of_cameras_takes_pictures_of_the_same_frame(port: int, tmp_path: Path) -> None:
    text = pictures_of(port, "camera_pair", tmp_path, 2)
    rows = re.findall(r"frames (\d+) and (\d+): ([\d.]+)% road, ([\d.]+)% cars", text)
    assert len(rows) == 2
    for color, semantic, road, cars in rows:
        assert color == semantic
        assert float(road) > 15
        assert 0.2 < float(cars) < 20


@pytest.mark.usefixtures("driver", "client")
def test_points_of_a_lidar_fall_on_pixels_of_their_class(port: int, tmp_path: Path) -> None:
    text = pictures_of(port, "lidar_on_camera", tmp_path, 1)
    ((points, same),) = re.findall(r"(\d+) points in the image, ([\d.]+)% on their own class", text)
    assert int(points) > 2000
    assert float(same) > 97  # of the others, the edges go through their pixel


@pytest.mark.usefixtures("driver", "client")
def test_boxes_fit_the_vehicles_in_the_image(port: int, tmp_path: Path) -> None:
    text = pictures_of(port, "boxes_on_camera", tmp_path, 1)
    rows = re.findall(r"(vehicle\S+) \d+ at \S+ m: box (.*), pixels (.*)", text)
    assert {name for name, _, _ in rows} >= {"vehicle.audi.tt", "vehicle.mercedes.sprinter"}
    for name, box, own in rows:
        left, top, right, bottom = map(float, box.split())
        x0, y0, x1, y1 = map(float, own.split())
        assert min(x0 - left, y0 - top, right - x1, bottom - y1) > -1.5, name  # pixels beyond the box
        if name == "vehicle.audi.tt":  # seen straight from behind: it fills its box
            assert max(x0 - left, y0 - top, right - x1, bottom - y1) < 3
