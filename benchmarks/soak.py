"""Run a server for half an hour with clients that connect, drive, reload, record, replay and crash.

`python -m benchmarks.soak --minutes 30` prints figures every minute, and ends with exit code 1 if the server crashes, leaks
or hangs, or if anything is left over.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import carla
import psutil

from benchmarks.server import connect, managed, settings, shut_down, spawn, ticks

TIMEOUT = 90.0  # s, after which a round hangs
WARM_UP = 2  # the least number of rounds of each kind
GROWTH = 1.15  # allowed factor of memory from the first half to the second
SLACK = 24 << 20  # bytes, allowed on top of that
MANAGERS = range(20_000, 30_000)  # ports of traffic managers
MAPS = ("Town01", "Town02", "Town10HD")
"""The names of copies of the built-in town, if no folder of maps is given."""


class Figures(NamedTuple):
    """Resources of a server."""

    memory: int  # resident, in bytes
    files: int  # that are open, connections among them
    threads: int
    children: int  # processes
    actors: int  # that were spawned, and could not be destroyed

    def __str__(self) -> str:
        counts = "  ".join(f"{count:4} {name}" for name, count in self._asdict().items() if name != "memory")
        return f"{self.memory / 1e6:7.1f} MB  {counts}"


def soak(port: int, pid: int, minutes: float, seed: int) -> list[str]:
    """Run rounds of all kinds in random order for a number of minutes, and return what is wrong, a line each."""
    generator, wrong, found = random.Random(seed), [], list[Figures]()
    begin = printed = time.monotonic()
    number = 0
    while time.monotonic() < begin + 60 * minutes or number < WARM_UP * len(ROUNDS):
        for name in generator.sample(list(ROUNDS), len(ROUNDS)):
            number += 1
            failure = round_of(name, port, generator.choice(MANAGERS))
            if not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
                return [*wrong, f"round {number}, {name}: the server has crashed"]
            if failure:
                wrong.append(f"round {number}, {name}: {failure}")
                print(wrong[-1], flush=True)
        found.append(figures(port, psutil.Process(pid)))
        if time.monotonic() - printed > 60 or len(found) == 1:
            printed = time.monotonic()
            print(f"{number:6} rounds  {found[-1]}  {len(wrong):3} failures", flush=True)
    print(f"{number:6} rounds  {found[-1]}  {len(wrong):3} failures", flush=True)
    return wrong + growth(found)


def round_of(name: str, port: int, seed: int) -> str:
    """Run a client in a process of its own, and return what is wrong with its end."""
    command = [sys.executable, "-m", "benchmarks.soak", "--round", name, "--port", str(port), "--seed", str(seed)]
    try:
        done = subprocess.run(command, timeout=TIMEOUT, capture_output=True, text=True, check=False)
    except subprocess.TimeoutExpired:
        return "hangs"
    printed = " ".join(done.stderr.split())[-300:]
    expected = -9 if name.startswith("be_killed") else 0
    return "" if done.returncode == expected else f"ended with exit code {done.returncode}: {printed}"


def figures(port: int, server: psutil.Process) -> Figures:
    """Return the figures of the server, after destroying the actors that killed clients have left."""
    client = connect(port)
    world = client.get_world()
    client.stop_recorder()
    world.apply_settings(settings())
    world.tick()
    clean(world)
    world.tick()
    actors = len(spawned(world))
    world.apply_settings(settings(synchronous=False))
    del client, world
    time.sleep(0.5)
    counts = server.num_fds(), server.num_threads(), len(server.children())
    return Figures(server.memory_info().rss, *counts, actors)


def growth(found: list[Figures]) -> list[str]:
    """Return what has grown from the first half to the second, but for a third at the beginning."""
    wrong = []
    settled = found[len(found) // 3 :]
    first, last = settled[: len(settled) // 2] or settled, settled[len(settled) // 2 :]
    before, after = (max(each.memory for each in half) for half in (first, last))
    if after > before * GROWTH + SLACK:
        wrong.append(f"memory has grown from {before / 1e6:.0f} to {after / 1e6:.0f} MB")
    for name in ("files", "threads", "children"):  # what clients leave is closed a little later: the least of each half
        before, after = (min(getattr(each, name) for each in half) for half in (first, last))
        if after > before + 1:
            wrong.append(f"the number of {name} has grown from {before} to {after}")
    if any(each.actors for each in found):
        wrong.append("actors were left that could not be destroyed")
    return wrong


# --- rounds ---------------------------------------------------------------------------------------------------------------


def visit(client: carla.Client, world: carla.World, seed: int) -> None:
    """Look at the world, and leave; a client that was killed may have left it in synchronous mode."""
    world.apply_settings(settings(synchronous=False))
    world.wait_for_tick(10.0)
    world.get_map()
    client.get_available_maps()
    world.get_blueprint_library()


def drive(client: carla.Client, world: carla.World, seed: int) -> None:
    """Drive with the traffic manager and a sensor on each car, and leave a clean world."""
    world.apply_settings(settings())
    manager, vehicles = managed(client, world, seed, 15)
    sensors = listening(world, vehicles, "sensor.other.collision")
    ticks(world, 100)
    for sensor in sensors:
        sensor.stop()
    destroy = carla.command.DestroyActor
    client.apply_batch_sync([destroy(actor) for actor in (*sensors, *vehicles)], False)
    world.tick()
    shut_down(world, manager)


def drive_hybrid(client: carla.Client, world: carla.World, seed: int) -> None:
    """Drive 60 cars with hybrid physics around a hero, and reload while they drive."""
    for turn in range(2):
        world.apply_settings(settings())
        manager, _ = managed(client, world, seed, 60, hybrid=True)
        ticks(world, 60)
        world = client.reload_world(reset_settings=turn % 2 == 0)
    shut_down(world, manager)


def sleep_and_freeze(client: carla.Client, world: carla.World, seed: int) -> None:
    """Let cars fall asleep, switch off their physics, hide some below the street, and destroy all."""
    world.apply_settings(settings())
    vehicles = spawn(world, 15)
    vehicles[0].apply_control(carla.VehicleControl(throttle=0.3))
    ticks(world, 60)
    for vehicle in vehicles[1:]:
        vehicle.set_simulate_physics(False)
    for vehicle in vehicles[1::3]:
        vehicle.set_location(vehicle.get_location() - carla.Location(z=500.0))
    world.tick()
    client.apply_batch_sync([carla.command.DestroyActor(vehicle) for vehicle in vehicles], True)
    world.apply_settings(settings(synchronous=False))


def shove(client: carla.Client, world: carla.World, seed: int) -> None:
    """Push cars and walkers about in friction triggers, with other gearboxes and chains of props; leave them to a reload."""
    world.apply_settings(settings())
    library, chosen = world.get_blueprint_library(), random.Random(seed)
    trigger = library.find("static.trigger.friction")
    for key, value in {"friction": "0.1", "extent_x": "2000", "extent_y": "2000", "extent_z": "500"}.items():
        trigger.set_attribute(key, value)
    vehicles = spawn(world, 15)
    for vehicle in vehicles:
        world.spawn_actor(trigger, vehicle.get_transform())
        parent: carla.Actor = vehicle
        for _ in range(5):
            parent = world.spawn_actor(library.find("static.prop.box01"), carla.Transform(), attach_to=parent)
        control = vehicle.get_physics_control()
        control.forward_gears = list(control.forward_gears)[:1] * chosen.randrange(1, 13)
        vehicle.apply_physics_control(control)
        vehicle.apply_control(carla.VehicleControl(throttle=1.0, manual_gear_shift=True, gear=chosen.randrange(13)))
    for _ in range(40):
        world.tick()
        vehicle, push = chosen.choice(vehicles), carla.Vector3D(chosen.uniform(-1e4, 1e4), chosen.uniform(-1e4, 1e4))
        chosen.choice((vehicle.add_impulse, vehicle.add_force, vehicle.add_torque))(push)
        vehicle.set_simulate_physics(chosen.random() < 0.8)
    client.reload_world()


def be_killed(client: carla.Client, world: carla.World, seed: int) -> None:
    """End by SIGKILL with a running traffic manager, sensors and a recording, at a random time."""
    world.apply_settings(settings())
    _, vehicles = managed(client, world, seed, 15, hybrid=seed % 2 == 0)
    listening(world, vehicles, "sensor.lidar.ray_cast")
    client.start_recorder("killed.log", True)
    threading.Timer(random.Random(seed).uniform(0.0, 1.5), os.kill, (os.getpid(), 9)).start()
    ticks(world, 100_000)


def be_killed_while_loading(client: carla.Client, world: carla.World, seed: int) -> None:
    """End by SIGKILL while a map is loaded."""
    maps = client.get_available_maps()
    threading.Timer(random.Random(seed).uniform(0.0, 1.0), os.kill, (os.getpid(), 9)).start()
    for number in range(100_000):
        client.load_world(maps[(seed + number) % len(maps)])


def reload(client: carla.Client, world: carla.World, seed: int) -> None:
    """Begin episodes while a traffic manager runs."""
    for turn in range(3):
        world.apply_settings(settings())
        managed(client, world, seed, 15)
        ticks(world, 20)
        world = client.reload_world(reset_settings=turn % 2 == 0)
    world.apply_settings(settings(synchronous=False))


def load(client: carla.Client, world: carla.World, seed: int) -> None:
    """Load two of the maps in turn, one that is sent, and the built-in one."""
    maps = sorted(client.get_available_maps())
    for number in range(2):
        world = client.load_world(maps[(seed + number) % len(maps)])
        world.wait_for_tick(10.0)
    client.generate_opendrive_world(world.get_map().to_opendrive())
    client.load_world("Brickfield")


def record(client: carla.Client, world: carla.World, seed: int) -> None:
    """Record, query the recording, and replay it twice."""
    world.apply_settings(settings())
    name = client.start_recorder(f"soak{seed % 4}.{'mcap' if seed % 2 else 'log'}", True)
    vehicles = spawn(world, 15)
    for vehicle in vehicles:
        vehicle.apply_control(carla.VehicleControl(throttle=0.5))
    ticks(world, 100)
    client.stop_recorder()
    client.show_recorder_file_info(name, True)
    client.show_recorder_collisions(name, "a", "a")
    client.show_recorder_actors_blocked(name, 1.0, 10.0)
    for keep in (True, False):
        client.replay_file(name, 1.0, 0.0, vehicles[0].id, False)
        ticks(world, 30)
        client.stop_replayer(keep)
    world.apply_settings(settings(synchronous=False))


WORKS = (visit, drive, drive_hybrid, sleep_and_freeze, shove, be_killed, be_killed_while_loading, reload, load, record)
ROUNDS = {work.__name__: work for work in WORKS}


def listening(world: carla.World, parents: list[carla.Actor], sensor: str) -> list[carla.Sensor]:
    """Return a sensor on each of some actors, with a listener."""
    blueprint, place = world.get_blueprint_library().find(sensor), carla.Transform(carla.Location(z=2.0))
    sensors = [world.spawn_actor(blueprint, place, attach_to=parent) for parent in parents]
    for each in sensors:
        each.listen(lambda _: None)
    return sensors


def spawned(world: carla.World) -> list[carla.Actor]:
    """Return the actors that clients have spawned."""
    return [actor for actor in world.get_actors() if not actor.type_id.startswith(("traffic.", "spectator"))]


def clean(world: carla.World) -> None:
    """Destroy the actors of killed clients."""
    for actor in spawned(world):
        actor.destroy()


def copied_maps(folder: Path) -> Path:
    """Fill a folder with copies of the built-in town under the names of other maps."""
    from carla_recap.roads.find import find_map

    built_in = find_map("Brickfield")
    assert built_in is not None
    folder.mkdir()
    for name in MAPS:
        shutil.copy(built_in, folder / f"{name}.xodr")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="duration (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the order of rounds (default: %(default)s)")
    parser.add_argument("--maps", type=Path, help="folder of maps; else copies of the built-in one")
    parser.add_argument("--round", choices=ROUNDS, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.round:
        client = connect(options.port)
        world = client.get_world()
        world.apply_settings(settings())
        world.tick()
        clean(world)
        ROUNDS[options.round](client, world, options.seed)
        return
    with tempfile.TemporaryDirectory() as folder:
        maps = options.maps or copied_maps(Path(folder) / "maps")
        command = [sys.executable, "-X", "faulthandler", "-m", "carla_recap", "serve", "--port=0"]
        command += [f"--recordings={folder}/recordings", f"--maps={maps}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            try:
                port = int(server.stdout.readline().rsplit(":", 1)[1])
                wrong = soak(port, server.pid, options.minutes, options.seed)
            finally:
                server.terminate()
            if server.wait(TIMEOUT):
                wrong.append(f"the server has ended with exit code {server.returncode}")
    print("\n".join(wrong) or "no crash, no leak, no hang")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
