"""Servers for the tests, and CARLA's own client to talk to them."""

from __future__ import annotations

import asyncio
import time
from inspect import iscoroutinefunction, signature
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.server import running
from carla_recap.sim.actors.moving import Vehicle
from tests.server.client import SYNCHRONOUS, connect
from tests.server.inside import Inside
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

QUIET = 0.01
"""The time in s in which the thread of a client leaves its callbacks; released within them, it aborts the process."""


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine in an event loop of its own."""
    if not iscoroutinefunction(pyfuncitem.obj):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in signature(pyfuncitem.obj).parameters}
    asyncio.run(asyncio.wait_for(pyfuncitem.obj(**arguments), PATIENCE))
    return True


@pytest.fixture(scope="package")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="package")
def port(recordings: Path) -> Iterator[int]:
    """A server with the built-in town, for all modules of a folder."""
    with running(recordings=recordings) as port:
        yield port


@pytest.fixture
def client(port: int, recordings: Path) -> Iterator[carla.Client]:
    """The official client; the world is in synchronous mode, without actors at the end."""
    client = connect(port, recordings)
    world = client.get_world()
    before, episode = {actor.id for actor in world.get_actors()}, world.id
    world.apply_settings(SYNCHRONOUS)
    yield client
    client.stop_recorder()
    client.stop_replayer(False)
    world = client.get_world()
    world.tick()  # the client knows no actors that were spawned since the latest tick
    for actor in world.get_actors():
        if actor.id not in before and not actor.type_id.startswith(("traffic.", "spectator")):
            actor.destroy()
    if world.id != episode:  # perhaps of another map
        world = client.load_world("Brickfield")
    world.apply_settings(carla.WorldSettings())
    time.sleep(QUIET)


@pytest.fixture
def other_client(port: int) -> Iterator[carla.Client]:
    """A second client in the same process."""
    client = connect(port)
    yield client
    time.sleep(QUIET)


@pytest.fixture
def world(client: carla.Client) -> carla.World:
    return client.get_world()


@pytest.fixture(scope="module")
def inside() -> Inside:
    return Inside()


@pytest.fixture
def parked(inside: Inside) -> Iterator[Vehicle]:
    """A car of the world of `inside`."""
    car = inside.world.place("vehicle.tesla.model3", inside.world.town.spawn_points[5])
    assert isinstance(car, Vehicle)
    yield car
    car.destroy()
