"""Servers for the tests, and CARLA's own client to talk to them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.server import running
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

QUIET = 0.01
"""The time in s in which the thread of a client leaves its callbacks; released within them, it aborts the process."""


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
    client = carla.Client("127.0.0.1", port)
    client.set_files_base_folder(str(recordings))  # where it keeps navigation meshes; else in the home folder
    client.set_timeout(PATIENCE)
    world = client.get_world()
    before, episode = {actor.id for actor in world.get_actors()}, world.id
    world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
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
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(PATIENCE)
    yield client
    time.sleep(QUIET)


@pytest.fixture
def world(client: carla.Client) -> carla.World:
    return client.get_world()
