"""The server: the official client in this process, the server in another one, as users run them."""

from __future__ import annotations

import time
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from benchmarks.hour import DIRECTORY, RATE
from benchmarks.measuring import Line, Subject, cut, in_new_process, medians, timed
from carla_recap.server import running

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import carla

IDLE = 100
MANAGED = 50
LONG = 20_000_000  # bytes
ROUNDS = 8


def sync_ticks(_: Subject) -> Iterator[Line]:
    rates = []
    for _ in range(3):
        with running(recordings=DIRECTORY) as port:
            rates.append(in_new_process(idle_rate, port))
    yield rate_line(f"sync ticks, {IDLE} idle vehicles", max(rates), 2500)


def managed_ticks(_: Subject) -> Iterator[Line]:
    found = []
    for _ in range(3):
        with running(recordings=DIRECTORY) as port:
            found.append(in_new_process(managed_rate, port))
    rate, own = max(found)
    what, measured = f"sync ticks, {MANAGED} under traffic manager", f"{rate:,.0f} a second"
    yield Line(what, measured, f"{own * 1e3:.1f} ms", "≥ 350 /s", rate >= 350)


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

        yield rate_line("apply_control calls", count / min(timed(steer) for _ in range(3)), 1500)


def get_world(_: Subject) -> Iterator[Line]:
    with world() as (port, town):
        spawn(town, IDLE)
        town.tick()
        worlds: list[carla.World] = []  # the client crashes if a world is deleted at once
        (seconds,) = medians(lambda: worlds.append(connect(port).get_world()))
        yield Line("get_world", f"{seconds * 1e3:.1f} ms", "", "< 20 ms", seconds < 0.02)


def long_answer(subject: Subject) -> Iterator[Line]:
    with world() as (port, _):
        client, frames = connect(port), 20 * RATE
        while True:
            log = cut(subject.log, frames).resolve()
            size = len(client.show_recorder_file_info(str(log), True))
            if size >= LONG or frames >= subject.frames:
                break
            frames = int(frames * 1.1 * LONG / size)
        seconds = min(timed(lambda: client.show_recorder_file_info(str(log), True)) for _ in range(3))
        ratio = f"{size / 1e6:.0f} MB, {size / seconds / 1e6:.0f} MB a second"
        yield Line("file info of a long log", f"{seconds:.2f} s", ratio, "< 2 s", seconds < 2)


ROWS = (sync_ticks, managed_ticks, controls, get_world, long_answer)


@contextmanager
def world() -> Iterator[tuple[int, carla.World]]:
    """Connect to a new server with the built-in town, in synchronous mode."""
    import carla

    with running(recordings=DIRECTORY) as port:
        client = connect(port)
        town = client.get_world()
        town.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
        yield port, town
        town.apply_settings(carla.WorldSettings())


def idle_rate(port: int) -> float:
    """Return the ticks a second of a client with idle vehicles."""
    import carla

    town = connect(port).get_world()
    town.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    spawn(town, IDLE)
    for _ in range(100):
        town.tick()
    return per_second(town.tick, 500)


def managed_rate(port: int) -> tuple[float, float]:
    """Return the ticks a second of a client whose traffic manager drives, and its own processor time for one, in s."""
    import carla

    client = connect(port)
    town = client.get_world()
    town.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    manager = client.get_trafficmanager(8123)
    manager.set_synchronous_mode(True)
    vehicles = spawn(town, MANAGED)
    for vehicle in vehicles:
        vehicle.set_autopilot(True, 8123)
    for _ in range(100):
        town.tick()
    begin = time.process_time()
    rate = per_second(town.tick, 200)
    own = (time.process_time() - begin) / (200 * ROUNDS)
    for vehicle in vehicles:
        vehicle.set_autopilot(False, 8123)
    manager.set_synchronous_mode(False)
    manager.shut_down()
    town.tick()
    town.apply_settings(carla.WorldSettings())
    return rate, own


def connect(port: int) -> carla.Client:
    import carla

    client = carla.Client("127.0.0.1", port)
    client.set_timeout(60.0)
    return client


def spawn(town: carla.World, count: int) -> list[carla.Actor]:
    """Spawn vehicles all over the town."""
    models = town.get_blueprint_library().filter("vehicle.*")
    cars = [model for model in models if model.get_attribute("number_of_wheels").as_int() == 4]
    points = town.get_map().get_spawn_points()
    found = (
        town.try_spawn_actor(cars[index % len(cars)], point)
        for index, point in enumerate(points[:: max(1, len(points) // count)])
    )
    return list(islice((vehicle for vehicle in found if vehicle), count))  # lazy, so that no more are spawned


def per_second(work: Callable[[], object], count: int) -> float:
    """Return how often some work can be done in a second: the best of several rounds, since the machine may be shared."""

    def rounds() -> None:
        for _ in range(count):
            work()

    return count / min(timed(rounds) for _ in range(ROUNDS))


def rate_line(what: str, rate: float, least: float) -> Line:
    return Line(what, f"{rate:,.0f} a second", "", f"≥ {least:,.0f} /s", rate >= least)
