"""The maps of a server: CARLA's names, maps that are missing, and what goes on while one is loaded."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager, suppress
from threading import Event
from typing import TYPE_CHECKING, Any, Final

import carla
import msgpack
import pytest

from carla_recap.roads.find import loadable_maps
from carla_recap.server import actor_records, navmesh, running
from carla_recap.server import maps as server_maps
from carla_recap.server.host import Host
from carla_recap.server.maps import Maps
from carla_recap.server.rpc.registry import CALLS, CallError
from carla_recap.server.serving import serve
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World
from tests.server.client import connect
from tests.server.inside import client_inside
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator
    from pathlib import Path

    from carla_recap.sim.town.loading import Town

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]
LAYERED: Final = "/Game/Carla/Maps/Town10HD_Opt"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of maps with a Town10HD of our own."""
    folder = tmp_path_factory.mktemp("maps")
    (folder / "Town10HD.xodr").write_text(load_town().opendrive)
    return folder


@pytest.fixture(scope="module")
def port(folder: Path) -> Iterator[int]:
    with running(maps=folder, town="Town10HD_Opt") as port:
        yield port


@pytest.fixture
def client(port: int) -> carla.Client:
    return connect(port)


def test_a_layered_map_is_a_map_of_its_own(client: carla.Client) -> None:
    assert client.get_world().get_map().name == "Carla/Maps/Town10HD_Opt"
    names = client.get_available_maps()
    assert LAYERED in names
    assert LAYERED.removesuffix("_Opt") in names
    assert client.load_world("Town10HD").get_map().name == "Carla/Maps/Town10HD"
    for name in ("Town10HD_Opt", LAYERED, "town10hd_opt"):
        world = client.load_world(name, map_layers=carla.MapLayer.NONE)
        assert world.get_map().name == "Carla/Maps/Town10HD_Opt"
    world.load_map_layer(carla.MapLayer.Buildings)
    world.unload_map_layer(carla.MapLayer.All)
    assert client.reload_world().get_map().name == "Carla/Maps/Town10HD_Opt"


def test_a_recording_on_a_layered_map_is_named_after_it(client: carla.Client, tmp_path: Path) -> None:
    client.load_world("Town10HD_Opt")
    client.start_recorder(str(tmp_path / "layered.log"))
    client.get_world().wait_for_tick()
    client.stop_recorder()
    assert "\nMap: Town10HD_Opt\n" in client.show_recorder_file_info(str(tmp_path / "layered.log"), False)
    client.load_world("Brickfield")
    client.replay_file(str(tmp_path / "layered.log"), 0, 0, 0)
    assert client.get_world().get_map().name == "Carla/Maps/Town10HD_Opt"
    client.stop_replayer(False)


def test_only_towns_of_carla_have_layered_maps(folder: Path) -> None:
    assert sorted(loadable_maps(folder)) == ["Brickfield", "Town10HD", "Town10HD_Opt"]


def test_the_first_town_can_be_loaded_again_by_its_name() -> None:
    elsewhere = load_town().renamed("Elsewhere")
    assert asyncio.run(Maps(elsewhere).load("Carla/Maps/elsewhere")) is elsewhere


def test_the_error_of_a_missing_map_lists_all_and_says_how_to_add_one(folder: Path) -> None:
    maps = Maps(load_town(), folder)
    with pytest.raises(CallError, match=f"'Carla/Maps/Town03'.* Brickfield, Town10HD, Town10HD_Opt; .*{folder}.*--stand-in"):
        asyncio.run(maps.load("Carla/Maps/Town03"))


def test_our_town_stands_in_for_a_missing_map(caplog: pytest.LogCaptureFixture) -> None:
    maps = Maps(load_town(), stand_in=True)
    loaded = asyncio.run(maps.load("/Game/Carla/Maps/Town03"))
    assert (loaded.name, loaded.opendrive) == ("Town03", load_town().opendrive)
    (record,) = caplog.records
    assert record.getMessage().startswith("Town03: ")
    assert asyncio.run(maps.load("Town03")) is loaded, "what it has been prepared with is computed anew"


def test_a_replay_of_a_missing_map_is_stood_in_for(tmp_path: Path) -> None:
    host = Host(World(load_town(called="Town05"), recordings=tmp_path), stand_in=True)
    host.world.start_recorder("stood_in.log")
    host.world.tick()
    host.world.reload("Brickfield")
    answer = asyncio.run(CALLS["replay_file"](client_inside(host), ["stood_in.log", 0.0, 0.0, 0]))
    assert "Loading map" in answer
    assert host.world.town.name == "Town05"


async def reply(streams: Streams, name: str, *arguments: object) -> list[Any]:
    """Make a call over a bare connection, and return the reply."""
    reader, writer = streams
    writer.write(msgpack.packb([0, 1, name, [[False], *arguments]]))
    unpacker = msgpack.Unpacker()
    while True:
        unpacker.feed(await reader.read(1 << 20))
        for value in unpacker:
            return list(value)


@asynccontextmanager
async def connections(host: Host, count: int) -> AsyncIterator[list[Streams]]:
    """Serve a world until the end of the block; yield bare connections to it."""
    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    server = asyncio.create_task(serve(host, "127.0.0.1", 0, port.set_result))
    opened = [await asyncio.open_connection("127.0.0.1", await port) for _ in range(count)]
    yield opened
    for _, writer in opened:
        writer.close()
    server.cancel()
    with suppress(asyncio.CancelledError):
        await server


async def test_the_server_answers_and_ticks_while_it_loads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    may_load = Event()

    def slow(name: str, folder: Path | None) -> Town:
        assert may_load.wait(PATIENCE)
        return load_town(name, folder)

    monkeypatch.setattr(server_maps, "load_town", slow)
    host = Host(World(load_town(), maps=folder))
    async with connections(host, 2) as (one, other):
        loading = asyncio.create_task(reply(one, "load_new_episode", "Town10HD", True, 0))
        for name in ("version", "get_episode_info", "get_episode_settings", "get_map_info"):
            assert (await reply(other, name))[2] is None
        frame = host.frame
        while host.frame < frame + 3:
            await asyncio.sleep(0.01)
        assert not loading.done()
        may_load.set()
        assert await loading == [1, 1, None, [[False]]]
        assert (await reply(other, "get_map_info"))[3][0][1][0] == "Carla/Maps/Town10HD"


def test_a_town_without_a_navigation_mesh_is_served(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def failing(*_: object) -> bytes:
        raise ZeroDivisionError("odd")

    monkeypatch.setattr(navmesh, "walkable_surface", failing)
    host = Host(World(load_town().renamed("Odd")))
    host.prepare()
    assert caplog.messages == ["Odd: no navigation mesh can be made: ZeroDivisionError('odd')"]


async def test_first_calls_find_everything_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client's first `get_world` used to wait for the navigation mesh, and the event loop with it."""

    def computed(*_: object) -> bytes:
        raise AssertionError("nothing is computed in a call")

    host = Host(World(load_town().renamed("Fresh")))
    actor_records.encoded_definitions.cache_clear()
    async with connections(host, 1) as (streams,):
        monkeypatch.setattr(navmesh, "walkable_surface", computed)
        monkeypatch.setattr(actor_records, "definition", computed)
        for name, *arguments in (("get_required_files", "Nav"), ("get_actor_definitions",), ("get_required_files", "Nav")):
            status, value = (await reply(streams, name, *arguments))[3][0]
            assert status == 1
            assert value
