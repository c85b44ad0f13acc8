"""Calls about the session: version, episode, settings, time and the map."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

from carla_recap.server.actor_records import sensor_of
from carla_recap.server.client import Client
from carla_recap.server.navmesh import NAVIGATION, navigation_files, navigation_mesh
from carla_recap.server.structs import EpisodeInfo, EpisodeSettings, MapInfo, Token
from carla_recap.server.table import CallError, call
from carla_recap.sim.validation import expect_between
from carla_recap.sim.weather import Weather

if TYPE_CHECKING:
    from collections.abc import Callable

VERSION = "0.9.16"
"""The version of the client that is served."""
_FOLDER: Final = "Carla/Maps"
"""Where the map is, as CARLA names it: not as among those that are available."""


@call
def version(client: Client) -> str:
    """The version of CARLA that this stands in for."""
    return VERSION


@call
def get_episode_info(client: Client) -> EpisodeInfo:
    """The episode, and a stream of its snapshots for this client alone."""
    client.host.greet(client)
    return EpisodeInfo(client.host.episode, Token(client.host.streams.token(client.stream)))


@call
def get_sensor_token(client: Client, stream: int) -> Token:
    """Where a stream is; clients ask before they subscribe to it."""
    expect_between("the number of a stream", stream, 0, 0xFFFFFFFF)
    if sensor_of(stream) in client.host.world.actors:
        client.host.streams.expect(stream, client)
    return Token(client.host.streams.token(stream))


@call
def get_episode_settings(client: Client) -> EpisodeSettings:
    """How the world runs."""
    return client.host.settings


@call
def set_episode_settings(client: Client, settings: EpisodeSettings) -> Any:
    """Change how the world runs; answers the frame that the client then waits for, and signals to its traffic managers."""
    host = client.host

    def apply() -> int:
        host.apply_settings(settings)
        return _signalled(client, host.frame)

    return _after(host.managers.under_way(), apply)


@call
def tick_cue(client: Client) -> Any:
    """Let a tick pass, in synchronous mode; answers the frame that the client then waits for.

    In asynchronous mode, where time passes by itself, that is the next one. A client that ticks after it has begun to
    listen to a sensor hears of that very tick: it waits for the subscription, as it does for traffic managers (`Round`).
    """
    host = client.host
    if not host.settings.synchronous_mode:
        return host.frame + 1

    def tick() -> int:
        frame = host.tick()
        asyncio.get_running_loop().call_soon(host.look_ahead)
        return _signalled(client, frame)

    return _after(host.streams.expected(client) + host.managers.under_way(), tick)


def _after(pending: list[asyncio.Future[None]], work: Callable[[], int]) -> Any:
    """Do something after some others, at once if there are none."""

    async def later() -> int:
        await asyncio.wait(pending)
        return work()

    return later() if pending else work()


def _signalled(client: Client, frame: int) -> int:
    """A frame, of which the client is about to signal to its traffic managers."""
    client.host.managers.tick(client)
    return frame


@call
def get_map_info(client: Client) -> MapInfo:
    """The town, and where vehicles can be spawned."""
    town = client.host.world.town
    return MapInfo(f"{_FOLDER}/{town.name}", town.spawn_points)


@call
def get_map_data(client: Client) -> str:
    """The town's OpenDRIVE file."""
    return client.host.world.town.opendrive


@call
def get_required_files(client: Client, folder: str = "", download: bool = True) -> list[str]:
    """Files that the client needs besides: what walkers with AI controllers walk on; no others."""
    return list(navigation_files(client.host.world.town)) if folder == NAVIGATION else []


@call
def request_file(client: Client, name: str) -> bytes:
    """A file that the client needs."""
    files = navigation_files(client.host.world.town)
    if name not in files:
        raise CallError(f"{name}: the client needs no such file from this server")
    return files[name]


@call
def get_navigation_mesh(client: Client) -> bytes:
    """What walkers with AI controllers walk on; clients of 0.9.16 ask for it as a file."""
    return navigation_mesh(client.host.world.town)


@call
def get_weather_parameters(client: Client) -> Weather:
    """The weather."""
    return client.host.world.weather


@call
def set_weather_parameters(client: Client, weather: Weather) -> None:
    """Change the weather."""
    client.host.world.weather = weather


@call
def query_lights_state(client: Client, address: str = "") -> list[bytes]:
    """The street lights of the town: it has none."""
    return []
