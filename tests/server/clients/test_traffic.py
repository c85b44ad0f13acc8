"""Traffic as the traffic manager and its users make it: hybrid physics, cars that sleep, clients that die."""

from __future__ import annotations

import json
import subprocess
import sys

import carla

from tests.server.clients.calls import destroy
from tests.waiting import PATIENCE

BEGIN = """
import json, math, os, sys
import carla
port, arguments = int(sys.argv[1]), sys.argv[2:]
client = carla.Client("127.0.0.1", port)
client.set_timeout(600.0)
world = client.get_world()
synchronous = carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05)
world.apply_settings(synchronous)
library, MANAGER = world.get_blueprint_library(), 10_000 + port % 20_000
points = world.get_map().get_spawn_points()
def spawn(count):
    model = library.find("vehicle.tesla.model3")
    SpawnActor, SetAutopilot, Future = carla.command.SpawnActor, carla.command.SetAutopilot, carla.command.FutureActor
    step = max(1, len(points) // (count + 1))
    batch = [SpawnActor(model, point).then(SetAutopilot(Future, True, MANAGER)) for point in points[step::step][:count]]
    return [answer.actor_id for answer in client.apply_batch_sync(batch, True) if not answer.error]
"""
HYBRID = """
manager = client.get_trafficmanager(MANAGER)
manager.set_synchronous_mode(True)
manager.set_hybrid_physics_mode(True)
manager.set_hybrid_physics_radius(50.0)
counts = []
for _ in range(3):
    hero_model = library.find("vehicle.audi.tt")
    hero_model.set_attribute("role_name", "hero")
    hero = world.spawn_actor(hero_model, points[0])
    hero.set_autopilot(True, MANAGER)
    ids = spawn(100)
    world.tick()
    places = {actor.id: actor.get_location() for actor in world.get_actors(ids)}
    for _ in range(60):
        world.tick()
    ways = [actor.get_location().distance(places[actor.id]) for actor in world.get_actors(ids)]
    counts.append((len(ids), sum(way > 1.0 for way in ways), all(math.isfinite(way) for way in ways)))
    world = client.reload_world(False)
    library, points = world.get_blueprint_library(), world.get_map().get_spawn_points()
manager.set_synchronous_mode(False)
manager.shut_down()
world.apply_settings(carla.WorldSettings())
print(json.dumps(counts))
"""
KILLED = """
manager = client.get_trafficmanager(MANAGER)
manager.set_synchronous_mode(True)
ids = spawn(20)
sensors = [library.find(name) for name in ("sensor.other.collision", "sensor.lidar.ray_cast", "sensor.other.imu")]
for actor in world.get_actors(ids):
    for sensor in sensors:
        world.spawn_actor(sensor, carla.Transform(carla.Location(z=2.0)), attach_to=actor).listen(lambda data: None)
for _ in range(int(arguments[0])):
    world.tick()
if len(arguments) > 1:
    client.start_recorder(arguments[1])
    world.tick()
os.kill(os.getpid(), 9)
"""


def run(script: str, port: int, *arguments: str, code: int = 0) -> str:
    command = [sys.executable, "-X", "faulthandler", "-c", BEGIN + script, str(port), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == code, done.stderr
    return done.stdout


def test_hybrid_physics_with_a_hundred_cars_and_reloads(client: carla.Client, port: int) -> None:
    for spawned, driven, finite in json.loads(run(HYBRID, port)):
        assert spawned == 100
        assert driven > 20
        assert finite


def test_cars_that_sleep_lose_their_physics_and_are_destroyed(client: carla.Client, world: carla.World) -> None:
    model = world.get_blueprint_library().find("vehicle.tesla.model3")
    for _ in range(3):
        cars = [world.spawn_actor(model, point) for point in world.get_map().get_spawn_points()[:60:5]]
        cars[0].apply_control(carla.VehicleControl(throttle=0.3))
        for _ in range(100):
            world.tick()
        for car in cars[1:]:
            car.set_simulate_physics(False)
        world.tick()
        destroy(client, cars)
    assert not world.get_actors().filter("vehicle.*")


def test_the_server_goes_on_after_clients_that_are_killed(client: carla.Client, world: carla.World, port: int) -> None:
    for ticks in ("0", "7", "20"):
        run(KILLED, port, ticks, "killed.log", code=-9)
        frame = world.tick()
        assert world.tick() == frame + 1
        destroy(client, world.get_actors().filter("sensor.*"))
        destroy(client, world.get_actors().filter("vehicle.*"))
    client.stop_recorder()
