"""The server: the official client in this process, the server in another one, as users run them."""

from __future__ import annotations

import time
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from benchmarks.hour import DIRECTORY, RATE
from benchmarks.measuring import Line, Subject, at_least, at_most, cut, fastest, in_new_process, line, medians
from carla_recap.server import running

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import carla

IDLE = 100
MANAGED = 50
LONG = 20_000_000  # bytes
ROUNDS = 8
DELTA = 0.05  # s


def sync_ticks(_: Subject) -> Iterator[Line]:
    rate = max(_on_new_server(idle_rate) for _ in range(3))
    yield line(f"sync ticks, {IDLE} idle vehicles", at_least(rate, "{:,.0f} a second", 2500))


def managed_ticks(_: Subject) -> Iterator[Line]:
    rate, own = max(_on_new_server(managed_rate) for _ in range(3))
    what = f"sync ticks, {MANAGED} under traffic manager"
    yield line(what, at_least(rate, "{:,.0f} a second", 350), f"{own * 1e3:.1f} ms")


def controls(_: Subject) -> Iterator[Line]:
    import carla

    with world() as (_, town):
        (vehicle,) = spawn(town, 1)
        town.tick()
        count = 6000

        def steer() -> None:
            for number in range(count):  # the client sends a control only if it differs from the last one
                vehicle.apply_control(carla.VehicleControl(steer=number / count))
            town.tick()

        yield line("apply_control calls", at_least(count / fastest(steer), "{:,.0f} a second", 1500))


def get_world(_: Subject) -> Iterator[Line]:
    with world() as (port, town):
        spawn(town, IDLE)
        town.tick()
        worlds: list[carla.World] = []  # the client crashes if a world is deleted at once
        (seconds,) = medians(lambda: worlds.append(connect(port).get_world()))
        yield line("get_world", at_most(seconds * 1e3, "{:.1f} ms", 20))


def long_answer(subject: Subject) -> Iterator[Line]:
    with world() as (port, _):
        client, frames = connect(port), 20 * RATE
        while True:
            log = cut(subject.log, frames).resolve()
            size = len(client.show_recorder_file_info(str(log), True))
            if size >= LONG or frames >= subject.frames:
                break
            frames = int(frames * 1.1 * LONG / size)
        seconds = fastest(lambda: client.show_recorder_file_info(str(log), True))
        ratio = f"{size / 1e6:.0f} MB, {size / seconds / 1e6:.0f} MB a second"
        yield line("file info of a long log", at_most(seconds, "{:.2f} s", 2), ratio)


ROWS = (sync_ticks, managed_ticks, controls, get_world, long_answer)


@contextmanager
def world() -> Iterator[tuple[int, carla.World]]:
    """Connect to a new server with the built-in town, in synchronous mode."""
    with running(recordings=DIRECTORY) as port:
        town = connect(port).get_world()
        town.apply_settings(settings())
        yield port, town
        town.apply_settings(settings(synchronous=False))


def _on_new_server(work: Callable[[int], object]) -> object:
    with running(recordings=DIRECTORY) as port:
        return in_new_process(work, port)


def idle_rate(port: int) -> float:
    """Return the ticks a second of a client with idle vehicles."""
    town = connect(port).get_world()
    town.apply_settings(settings())
    spawn(town, IDLE)
    ticks(town, 100)
    return 500 / fastest(lambda: ticks(town, 500), ROUNDS)


def managed_rate(port: int) -> tuple[float, float]:
    """Return the ticks a second of a client whose traffic manager drives, and its own processor time for one, in s."""
    client = connect(port)
    town = client.get_world()
    town.apply_settings(settings())
    manager, vehicles = managed(client, town, 8123, MANAGED)
    ticks(town, 100)
    begin = time.process_time()
    rate = 200 / fastest(lambda: ticks(town, 200), ROUNDS)
    own = (time.process_time() - begin) / (200 * ROUNDS)
    for vehicle in vehicles:
        vehicle.set_autopilot(False, 8123)
    shut_down(town, manager)
    return rate, own


# --- clients --------------------------------------------------------------------------------------------------------------


def connect(port: int) -> carla.Client:
    import carla

    client = carla.Client("127.0.0.1", port)
    client.set_timeout(60.0)
    return client


def settings(*, synchronous: bool = True) -> carla.WorldSettings:
    """Return the settings of a world."""
    import carla

    return carla.WorldSettings(synchronous_mode=synchronous, fixed_delta_seconds=DELTA if synchronous else 0.0)


def spawn(town: carla.World, count: int, role_name: str = "autopilot") -> list[carla.Actor]:
    """Spawn vehicles all over the town; the role name is that of the first one."""
    models = town.get_blueprint_library().filter("vehicle.*")
    cars = [model for model in models if model.get_attribute("number_of_wheels").as_int() == 4]
    cars[0].set_attribute("role_name", role_name)
    points = town.get_map().get_spawn_points()
    found = (
        town.try_spawn_actor(cars[index % len(cars)], point)
        for index, point in enumerate(points[:: max(1, len(points) // count)])
    )
    return list(islice((vehicle for vehicle in found if vehicle), count))  # lazy, so that no more are spawned


def managed(
    client: carla.Client, town: carla.World, port: int, count: int, *, hybrid: bool = False
) -> tuple[carla.TrafficManager, list[carla.Actor]]:
    """Return a traffic manager in synchronous mode, and its vehicles; with hybrid physics, the first one is the hero."""
    manager = client.get_trafficmanager(port)
    manager.set_synchronous_mode(True)
    manager.set_hybrid_physics_mode(hybrid)
    manager.set_hybrid_physics_radius(50.0)
    vehicles = spawn(town, count, "hero" if hybrid else "autopilot")
    for vehicle in vehicles:
        vehicle.set_autopilot(True, port)
    return manager, vehicles


def shut_down(town: carla.World, manager: carla.TrafficManager) -> None:
    """Shut a traffic manager down, and leave the world in asynchronous mode."""
    manager.set_synchronous_mode(False)
    manager.shut_down()
    town.apply_settings(settings(synchronous=False))


def ticks(town: carla.World, count: int) -> None:
    """Tick a number of times."""
    for _ in range(count):
        town.tick()
