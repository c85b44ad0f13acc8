"""Servers for the tests, and CARLA's own client to talk to them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

carla = pytest.importorskip("carla")

from carla_recap.server import running  # noqa: E402


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def port(recordings: Path) -> Iterator[int]:
    """A server with the built-in town."""
    with running(recordings=recordings) as port:
        yield port


@pytest.fixture
def client(port: int) -> Iterator[carla.Client]:
    """The official client; the world is in synchronous mode, and has nobody in it at the end."""
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(10.0)
    world = client.get_world()
    before = {actor.id for actor in world.get_actors()}
    world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    yield client
    world = client.get_world()
    for actor in world.get_actors():
        if actor.id not in before and not actor.type_id.startswith(("traffic.", "spectator")):
            actor.destroy()
    world.apply_settings(carla.WorldSettings())


@pytest.fixture
def world(client: carla.Client) -> carla.World:
    return client.get_world()
