"""Traffic managers, which run in the processes of clients, and the traffic that they drive."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from carla_recap import open_recording
from carla_recap.sim.town.loading import load_town
from tests.roads.towns import mirrored
from tests.server.client import destroy
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path

    import carla

BEGIN = """
import json, math, os, sys
import carla
port, *arguments = sys.argv[1:]
client = carla.Client("127.0.0.1", int(port))
client.set_timeout(600.0)
world = client.get_world()
synchronous = carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05)
MANAGER = 10_000 + int(port) % 20_000  # which no program gets that asks for any port
def spawn(count):
    points = world.get_map().get_spawn_points()
    model = world.get_blueprint_library().filter("vehicle.lincoln.mkz*")[0]
    vehicles = [world.try_spawn_actor(model, point) for point in points[::len(points) // max(count, 1)]]
    return [vehicle for vehicle in vehicles if vehicle][:count]
def manage(count, synchronous=True):
    manager = client.get_trafficmanager(MANAGER)
    manager.set_synchronous_mode(synchronous)
    vehicles = spawn(count)
    for vehicle in vehicles:
        vehicle.set_autopilot(True, MANAGER)
    return manager, vehicles
"""
DRIVE = """
world.apply_settings(synchronous)
manager, vehicles = manage(12)
roads = world.get_map()
aside, too_fast, driven, waits, runs, before = [], [], 0.0, 0, 0, {}
for number in range(800):
    world.tick()
    for vehicle in vehicles if number % 5 == 0 else ():
        place, velocity = vehicle.get_transform(), vehicle.get_velocity()
        lane = roads.get_waypoint(place.location)
        speed = math.hypot(velocity.x, velocity.y)
        driven += speed * 0.25
        if number > 200:
            too_fast.append(speed * 3.6 - vehicle.get_speed_limit())
            if not lane.is_junction:
                aside.append(place.location.distance_2d(lane.transform.location))
        red = vehicle.is_at_traffic_light() and vehicle.get_traffic_light_state() == carla.TrafficLightState.Red
        waits += red and speed < 0.1
        runs += before.get(vehicle.id, False) and lane.is_junction and speed > 3.0
        before[vehicle.id] = red and not lane.is_junction
most = lambda values: sorted(values)[len(values) * 95 // 100]
print(json.dumps({"driven": driven, "aside": most(aside), "too_fast": most(too_fast), "waits": waits, "runs": runs}))
for vehicle in vehicles:
    vehicle.set_autopilot(False, MANAGER)
manager.set_synchronous_mode(False)
manager.shut_down()
world.apply_settings(carla.WorldSettings())
"""
RELOAD = """
ticks = []
in_step = arguments[0] == "synchronous"
for number in range(4):
    world.apply_settings(synchronous if in_step else carla.WorldSettings())
    manage(int(arguments[1]), in_step)
    world.on_tick(lambda snapshot: ticks.append(snapshot.frame))
    for _ in range(5):
        world.tick()
    world = client.load_world("Brickfield", number % 2 == 0) if number % 3 == 0 else client.reload_world(number % 2 == 0)
assert ticks == sorted(ticks)
world.apply_settings(carla.WorldSettings())
print("done")
"""
LEFT = """
mirrored, recording = open(arguments[0]).read(), arguments[1]
world.apply_settings(synchronous)
manage(1)
world = client.generate_opendrive_world(mirrored, carla.OpendriveGenerationParameters(), False)
world.apply_settings(synchronous)
roads = world.get_map()
turned = lambda one, other: abs((one.rotation.yaw - other.rotation.yaw + 180) % 360 - 180)
lane_at = lambda place: roads.get_waypoint(place.location)
spawned = max(turned(point, lane_at(point).transform) for point in roads.get_spawn_points())
client.start_recorder(recording, True)
manager, vehicles = manage(12)
hits, driven, against, left = [], 0.0, 0, 0
sensor = world.get_blueprint_library().find("sensor.other.collision")
sensors = [world.spawn_actor(sensor, carla.Transform(), vehicle) for vehicle in vehicles]
for each in sensors:
    each.listen(hits.append)
for _ in range(200):
    world.tick()
    for vehicle in vehicles:
        driven += vehicle.get_velocity().length() * 0.05
        lane = lane_at(vehicle.get_transform())
        if not lane.is_junction:
            against += turned(vehicle.get_transform(), lane.transform) > 90
            left += lane.lane_id > 0  # with the road, where traffic keeps left
client.stop_recorder()
for each in sensors:
    each.stop()
manager.set_synchronous_mode(False)
manager.shut_down()
world.apply_settings(carla.WorldSettings())
found = {"spawned": spawned, "driven": driven, "hits": len(hits), "against": against, "left": left}
print(json.dumps(found), flush=True)
os._exit(0)  # a client that had sensors ends by SIGABRT now and then
"""
LIVE = """
world.apply_settings(carla.WorldSettings())
manage(5, False)
print("driving", flush=True)
sys.stdin.readline()
world = client.get_world()
world.tick()
print(world.id)
"""
KILLED = """
world.apply_settings(synchronous)
manager, vehicles = manage(20)
library = world.get_blueprint_library()
sensors = [library.find(name) for name in ("sensor.other.collision", "sensor.lidar.ray_cast", "sensor.other.imu")]
for vehicle in vehicles:
    for sensor in sensors:
        world.spawn_actor(sensor, carla.Transform(carla.Location(z=2.0)), attach_to=vehicle).listen(lambda data: None)
for _ in range(int(arguments[0])):
    world.tick()
if len(arguments) > 1:
    client.start_recorder(arguments[1])
    world.tick()
os.kill(os.getpid(), 9)
"""


def run(script: str, port: int, *arguments: str, code: int = 0) -> str:
    command = [sys.executable, "-c", BEGIN + script, str(port), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == code, done.stderr
    return done.stdout


def test_the_traffic_manager_drives(client: carla.Client, port: int) -> None:
    result = json.loads(run(DRIVE, port))
    assert result["driven"] > 1000
    assert result["aside"] < 1.0
    assert result["too_fast"] < 1
    assert result["waits"] > 0
    assert result["runs"] == 0


@pytest.mark.parametrize("count", ["4", "0"])
@pytest.mark.parametrize("mode", ["synchronous", "asynchronous"])
def test_episodes_begin_while_it_lives(client: carla.Client, port: int, mode: str, count: str) -> None:
    assert "done" in run(RELOAD, port, mode, count)


def test_the_manager_keeps_left_on_the_map_that_its_client_loads(
    client: carla.Client, port: int, recordings: Path, tmp_path: Path
) -> None:
    town = tmp_path / "Mirrored.xodr"
    town.write_text(mirrored(load_town().opendrive))
    result = json.loads(run(LEFT, port, str(town), "left.log"))
    client.load_world("Brickfield")
    assert result["spawned"] < 0.5
    assert result["driven"] > 500
    assert (result["hits"], result["against"]) == (0, 0)
    assert result["left"] > 0
    with open_recording(recordings / "left.log") as recording:
        assert list(recording.incidents(kinds=["collision", "wrong way"], road_map=town)) == []
        town.write_text(town.read_text().replace('rule="LHT" ', ""))  # the same roads, where traffic keeps right
        assert list(recording.incidents(kinds=["wrong way"], road_map=town)) != []


def test_another_client_begins_episodes_while_it_lives(client: carla.Client, port: int) -> None:
    command = [sys.executable, "-c", BEGIN + LIVE, str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "driving\n"
        for _ in range(5):
            world = client.reload_world()
            world.wait_for_tick(PATIENCE)
        output, _ = process.communicate("go on\n", timeout=PATIENCE)
    assert process.returncode == 0
    assert int(output) == world.id


def test_clients_are_killed_while_they_drive_listen_and_record(client: carla.Client, world: carla.World, port: int) -> None:
    for arguments in (("0",), ("7", "killed.log")):  # the second client has the same port for its manager
        run(KILLED, port, *arguments, code=-9)
        frame = world.tick()
        for _ in range(20):
            frame += 1
            assert world.tick() == frame
        destroy(client, world.get_actors().filter("sensor.*"))
        destroy(client, world.get_actors().filter("vehicle.*"))
