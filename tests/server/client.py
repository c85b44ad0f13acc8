"""What tests do with CARLA's own client: connect it to a server, spawn and drive actors, listen to sensors."""

from __future__ import annotations

import math
import queue
import socket
import subprocess
import time
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final

import carla

from tests.cli.command import COMMAND, ENVIRONMENT
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

MODEL: Final = "vehicle.lincoln.mkz" if hasattr(carla.World, "is_weather_enabled") else "vehicle.tesla.model3"
"""The usual car; the client of 0.10 has others."""
SYNCHRONOUS: Final = carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05)
FAR: Final = carla.Transform(carla.Location(500.0, 500.0, 0.5))
"""A transform without actors or lanes nearby."""
BUMPER: Final = carla.Transform(carla.Location(x=2.5, z=0.8))
"""The place of a sensor at the front of a car."""


def connect(port: int, folder: Path | None = None) -> carla.Client:
    """Return a client of a server of this machine, which keeps navigation meshes in a folder, else in the home folder."""
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(PATIENCE)
    if folder is not None:
        client.set_files_base_folder(str(folder))
    return client


@contextmanager
def running(*command: object, **environment: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Run a command that starts a server; kill it at the end of the block.

    Yields the process, with its standard output and errors as pipes, and the port for calls.
    """
    words, pipe, variables = list(map(str, command)), subprocess.PIPE, ENVIRONMENT | environment
    with subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True, env=variables) as process:
        try:
            yield process, port_of(process)
        finally:
            process.kill()


def serving(
    *options: object, through: Sequence[str] = (), **environment: str
) -> AbstractContextManager[tuple[subprocess.Popen[str], int]]:
    """Run `carla-recap serve`, if need be by another command, at a free port."""
    return running(*through, COMMAND, "serve", "--port=0", *options, **environment)


def port_of(process: subprocess.Popen[str]) -> int:
    """Return the port for calls of a server that starts, from what it prints."""
    assert process.stdout is not None
    return int(process.stdout.readline().rsplit(":", 1)[1])


def free_port() -> int:
    """Return a port at which nothing listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def refuses_connections(port: int) -> bool:
    """Return whether no server listens at a port."""
    with suppress(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port)).close()
        return False
    return True


def place(
    world: carla.World, name: str, at: carla.Transform, parent: carla.Actor | None = None, **attributes: str
) -> carla.Actor:
    """Spawn an actor, without a tick."""
    blueprint = world.get_blueprint_library().find(name)
    for key, value in attributes.items():
        blueprint.set_attribute(key, value)
    return world.spawn_actor(blueprint, at, attach_to=parent)


def spawn(world: carla.World, name: str = MODEL, at: carla.Transform | None = None, **attributes: str) -> carla.Actor:
    """Spawn an actor, by default at the first spawn point, and tick: it has its transform then."""
    actor = place(world, name, at or world.get_map().get_spawn_points()[0], **attributes)
    world.tick()
    return actor


def ticks(world: carla.World, count: int) -> None:
    """Tick some times."""
    for _ in range(count):
        world.tick()


def straight(world: carla.World, length: float) -> carla.Transform:
    """Return a spawn point with a straight lane of a length in m before it."""
    roads = world.get_map()
    for point in roads.get_spawn_points():
        waypoint, yaw = roads.get_waypoint(point.location), point.rotation.yaw
        ahead = [waypoint.next(distance) for distance in range(5, int(length) + 1, 5)]
        turns = [math.remainder(found[0].transform.rotation.yaw - yaw, 360.0) if found else 180.0 for found in ahead]
        if all(abs(turn) < 1.0 for turn in turns):
            return point
    raise AssertionError(f"no lane is straight for {length} m")


def ahead(at: carla.Transform, distance: float, up: float = 0.0) -> carla.Transform:
    """Return the transform a distance before another one, and above it, in m."""
    forward, location = at.get_forward_vector(), at.location
    there = carla.Location(location.x + distance * forward.x, location.y + distance * forward.y, location.z + up)
    return carla.Transform(there, at.rotation)


def destroy(client: carla.Client, actors: Iterable[carla.Actor]) -> None:
    """Destroy actors in a batch, as clients do at their end."""
    answers = client.apply_batch_sync([carla.command.DestroyActor(actor) for actor in actors], True)
    assert [answer.error for answer in answers] == [""] * len(answers)


# --- sensors ---------------------------------------------------------------------------------------------------------------


def vehicle(world: carla.World, number: int = 0, distance: float = 0.0) -> carla.Vehicle:
    """Spawn a car at a spawn point, or a distance in m ahead of it."""
    return spawn(world, at=ahead(world.get_map().get_spawn_points()[number], distance))


def sensor(
    world: carla.World, kind: str, parent: carla.Actor | None = None, at: carla.Transform = BUMPER, **attributes: str
) -> carla.Sensor:
    """Spawn a sensor, without a tick."""
    return place(world, f"sensor.{kind}", at, parent, **attributes)


class Data(queue.Queue[Any]):
    """The data of a sensor; it keeps the sensor, since the client stops listening when the object is garbage."""

    def __init__(self, sensor: carla.Sensor) -> None:
        super().__init__()
        self.sensor = sensor
        sensor.listen(self.put)


def settle() -> None:
    """Wait until subscriptions have begun or ended, for which the client does not wait."""
    time.sleep(0.3)


def start(world: carla.World, *sensors: Data) -> None:
    """Tick until sensors with data in each frame have sent some."""

    def have_begun() -> bool:
        world.tick()
        return not any(data.empty() for data in sensors)

    wait_until(have_begun)


def of_frame(data: Data, frame: int) -> Any:
    """Return the data of a frame, as the usual loop of synchronous scripts does."""
    while True:
        measurement = data.get(timeout=PATIENCE)
        if measurement.frame == frame:
            return measurement
