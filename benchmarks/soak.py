"""Wears a server: for half an hour clients connect, drive, reload, replay and crash; nothing may leak, hang or be left over.

`python -m benchmarks.soak --minutes 30` prints figures every minute, and ends with exit code 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import carla

PATIENCE = 90.0  # s: a round that takes longer hangs
WARM = 2  # rounds of each kind, before it is measured from where things start
GROWTH = 1.15  # of memory from the first half to the second, and a little more for what is small
SLACK = 24 << 20  # bytes
DELTA = 0.05  # s
MANAGERS = range(20_000, 30_000)
FILES = Path("/proc")


@dataclass(frozen=True, slots=True)
class Figures:
    """What a server has.

    Attributes:
        memory: In bytes.
        files: Open files, connections among them.
        threads: Threads.
        actors: Actors that do not belong to the town.
    """

    memory: int
    files: int
    threads: int
    actors: int


@dataclass
class Soak:
    """A server that is worn.

    Attributes:
        port: Its port.
        process: Its process.
        failures: What has gone wrong.
        seen: The figures, after each round.
    """

    port: int
    process: int
    failures: list[str] = field(default_factory=list)
    seen: list[Figures] = field(default_factory=list)

    def run(self, minutes: float, seed: int) -> None:
        """Have rounds of all kinds, in an order of chance, for so long."""
        chance = random.Random(seed)
        end = time.monotonic() + 60 * minutes
        told = time.monotonic()
        number = 0
        while time.monotonic() < end or number < WARM * len(ROUNDS):
            names = list(ROUNDS)
            chance.shuffle(names)
            for name in names:
                number += 1
                self.round(number, name, chance.choice(MANAGERS))
            self.seen.append(self.look())
            if time.monotonic() - told > 60 or len(self.seen) == 1:
                told = time.monotonic()
                self.tell(number)
        self.tell(number)

    def round(self, number: int, name: str, seed: int) -> None:
        """Have a client of its own process do something, and see whether it ends as it should."""
        command = [sys.executable, "-m", "benchmarks.soak", "--round", name, "--port", str(self.port), "--chance", str(seed)]
        try:
            done = subprocess.run(command, timeout=PATIENCE, capture_output=True, text=True, check=False)
        except subprocess.TimeoutExpired:
            return self.fail(f"round {number}, {name}: hangs")
        if done.returncode != CRASHED.get(name, 0):
            said = " ".join(done.stderr.split())[-300:]
            self.fail(f"round {number}, {name}: ended with exit code {done.returncode}: {said}")
        return None

    def fail(self, what: str) -> None:
        """Take note of what has gone wrong."""
        print(what, flush=True)
        self.failures.append(what)

    def look(self) -> Figures:
        """What the server has, once everybody is gone and the actors of those who crashed have been destroyed."""
        client, world = connect(self.port)
        world.apply_settings(settings())
        for actor in world.get_actors():
            if not belongs_to_town(actor):
                actor.destroy()
        world.tick()
        actors = sum(not belongs_to_town(actor) for actor in world.get_actors())
        world.apply_settings(settings(synchronous=False))
        del client, world
        time.sleep(0.5)
        process = FILES / str(self.process)
        status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
        memory = int(status["VmRSS"].split()[0]) << 10
        return Figures(memory, sum(1 for _ in (process / "fd").iterdir()), int(status["Threads"]), actors)

    def tell(self, number: int) -> None:
        latest = self.seen[-1]
        print(
            f"{number:6} rounds  {latest.memory / 1e6:7.1f} MB  {latest.files:4} files  {latest.threads:3} threads  "
            f"{latest.actors:3} actors left  {len(self.failures):3} failures",
            flush=True,
        )

    def judge(self) -> list[str]:
        """What is wrong."""
        settled = self.seen[len(self.seen) // 3 :] or self.seen
        first, last = settled[: len(settled) // 2] or settled, settled[len(settled) // 2 :]
        before, after = max(figures.memory for figures in first), max(figures.memory for figures in last)
        wrong = list(self.failures)
        if after > before * GROWTH + SLACK:
            wrong.append(f"memory has grown from {before / 1e6:.0f} to {after / 1e6:.0f} MB")
        if last[-1].files > min(figures.files for figures in self.seen) + 2:
            wrong.append(f"{last[-1].files} files are open, {min(figures.files for figures in self.seen)} were")
        if any(figures.actors for figures in self.seen):
            wrong.append("there were actors that could not be destroyed")
        return wrong


# --- what clients do ------------------------------------------------------------------------------------------------------


def visit(client: carla.Client, world: carla.World, seed: int) -> None:
    """Look at the world, and go."""
    world.wait_for_tick(10.0)
    world.get_map()
    client.get_available_maps()
    world.get_blueprint_library()


def drive(client: carla.Client, world: carla.World, seed: int) -> None:
    """Have the traffic manager drive, with a sensor on each car, and leave a clean world."""
    world.apply_settings(settings())
    manager, vehicles = managed(client, world, seed)
    blueprint = world.get_blueprint_library().find("sensor.other.collision")
    sensors = [world.spawn_actor(blueprint, carla.Transform(), attach_to=vehicle) for vehicle in vehicles]
    for sensor in sensors:
        sensor.listen(lambda _: None)
    for _ in range(100):
        world.tick()
    for sensor in sensors:
        sensor.stop()
    destroy = carla.command.DestroyActor
    client.apply_batch_sync([destroy(actor) for actor in (*sensors, *vehicles)], False)
    world.tick()
    manager.set_synchronous_mode(False)
    manager.shut_down()
    world.apply_settings(settings(synchronous=False))


def die(client: carla.Client, world: carla.World, seed: int) -> None:
    """Crash with a live traffic manager."""
    world.apply_settings(settings())
    managed(client, world, seed)
    for _ in range(40):
        world.tick()
    world.apply_settings(settings(synchronous=False))
    os.kill(os.getpid(), 9)


def reload(client: carla.Client, world: carla.World, seed: int) -> None:
    """Begin episodes while a traffic manager lives."""
    for turn in range(3):
        world.apply_settings(settings())
        managed(client, world, seed)
        for _ in range(20):
            world.tick()
        world = client.reload_world(reset_settings=turn % 2 == 0)
    world.apply_settings(settings(synchronous=False))


def load(client: carla.Client, world: carla.World, seed: int) -> None:
    """Go to another map and back, and to one that is sent."""
    maps = client.get_available_maps()
    world = client.load_world(maps[seed % len(maps)])
    client.generate_opendrive_world(world.get_map().to_opendrive())
    client.load_world("Brickfield")


def record(client: carla.Client, world: carla.World, seed: int) -> None:
    """Record, ask about the recording, and replay it twice."""
    world.apply_settings(settings())
    name = client.start_recorder(f"soak{seed % 4}.mcap", True)
    vehicles = spawn(world, 15)
    for vehicle in vehicles:
        vehicle.apply_control(carla.VehicleControl(throttle=0.5))
    for _ in range(100):
        world.tick()
    client.stop_recorder()
    client.show_recorder_file_info(name, True)
    client.show_recorder_collisions(name, "a", "a")
    client.show_recorder_actors_blocked(name, 1.0, 10.0)
    for keep in (True, False):
        client.replay_file(name, 1.0, 0.0, vehicles[0].id, False)
        for _ in range(30):
            world.tick()
        client.stop_replayer(keep)
    world.apply_settings(settings(synchronous=False))


ROUNDS = {work.__name__: work for work in (visit, drive, die, reload, load, record)}
CRASHED = {"die": -9}


def managed(client: carla.Client, world: carla.World, seed: int) -> tuple[carla.TrafficManager, list[carla.Actor]]:
    """Vehicles under a traffic manager in synchronous mode."""
    manager = client.get_trafficmanager(seed)
    manager.set_synchronous_mode(True)
    vehicles = spawn(world, 15)
    for vehicle in vehicles:
        vehicle.set_autopilot(True, seed)
    return manager, vehicles


def spawn(world: carla.World, count: int) -> list[carla.Actor]:
    """Vehicles wherever there is room."""
    blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
    points = world.get_map().get_spawn_points()[:: max(1, len(world.get_map().get_spawn_points()) // count)]
    return [vehicle for vehicle in (world.try_spawn_actor(blueprint, point) for point in points) if vehicle]


def belongs_to_town(actor: carla.Actor) -> bool:
    """Whether an actor is there without anybody's having spawned it."""
    return actor.type_id.startswith(("traffic.", "spectator"))


def settings(*, synchronous: bool = True) -> carla.WorldSettings:
    """The settings of a world."""
    return carla.WorldSettings(synchronous_mode=synchronous, fixed_delta_seconds=DELTA if synchronous else 0.0)


def connect(port: int) -> tuple[carla.Client, carla.World]:
    """A client, and its world."""
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(30.0)
    return client, client.get_world()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=0, help="of the order of things (default: %(default)s)")
    parser.add_argument("--maps", type=Path, help="a folder of maps, besides the built-in one")
    parser.add_argument("--round", choices=ROUNDS, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--chance", type=int, default=MANAGERS[0], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.round:
        ROUNDS[options.round](*connect(options.port), options.chance)
        return
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "carla_recap", "serve", "--port=0", f"--recordings={folder}"]
        if options.maps:
            command.append(f"--maps={options.maps}")
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            soak = Soak(int(server.stdout.readline().rsplit(":", 1)[1]), server.pid)
            try:
                soak.run(options.minutes, options.seed)
            finally:
                server.terminate()
            if server.wait(PATIENCE):
                soak.failures.append(f"the server has ended with exit code {server.returncode}")
    wrong = soak.judge()
    print("\n".join(wrong) or "nothing leaks, hangs or is left over")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
