"""Calls about the session: version, episodes and their maps, settings, ticks, and traffic managers."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from carla_recap.server.actor_records import sensor_of
from carla_recap.server.host import Client, Host
from carla_recap.server.navmesh import NAVIGATION, navigation_files, navigation_mesh
from carla_recap.server.quirks import settled
from carla_recap.server.rpc.registry import CallError, call
from carla_recap.server.rpc.structs import EpisodeInfo, EpisodeSettings, MapInfo, Token
from carla_recap.server.traffic_manager import TrafficManagerPause
from carla_recap.sim.settings import Weather
from carla_recap.sim.validation import expect_between

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")

_FOLDER: Final = "Carla/Maps"
"""The folder in the name of the current map; `get_available_maps` uses another one, as in CARLA."""
_MAPS: Final = "/Game/Carla/Maps"
"""The folder of maps in CARLA's names."""


@call
def version(client: Client) -> str:
    """Return the version of CARLA, which is the client's own; to one that is refused, why it is."""
    return client.refusal or client.release.name


@call
def get_episode_info(client: Client) -> EpisodeInfo:
    """Return the episode, and a stream of snapshots for this client alone; see `Client.known_episode`."""
    client.host.prepare_snapshot(client)
    return EpisodeInfo(client.known_episode, Token(client.host.streams.token(client.stream)))


@call
def get_sensor_token(client: Client, stream: int) -> Token:
    """Return the address of a stream; clients ask for it before they subscribe."""
    expect_between("the number of a stream", stream, 0, 0xFFFFFFFF)
    if sensor_of(stream) in client.host.world.actors:
        client.host.streams.pending.expect(stream, client)
    return Token(client.host.streams.token(stream))


@call
def get_episode_settings(client: Client) -> EpisodeSettings:
    """Return the settings."""
    return client.host.settings


@call
def set_episode_settings(client: Client, settings: EpisodeSettings) -> int | Awaitable[int]:
    """Apply settings, except `max_substeps` and `max_substep_delta_time`; return the frame that the client waits for.

    A tick has as many steps as its length and the speeds of vehicles demand. The client signals the frame to its traffic
    managers.
    """
    host = client.host

    def apply() -> int:
        host.apply_settings(settings)
        return _signalled(client, host.frame)

    return when_done(host, host.traffic_managers.unsettled(), apply)


@call
def tick_cue(client: Client) -> int | Awaitable[int]:
    """Tick in synchronous mode; return the frame that the client waits for, in asynchronous mode the next one.

    The tick waits for the client's subscriptions, for traffic managers and for images of earlier ticks; see
    `PendingSubscriptions`, `TrafficManagerCycle` and `Sensors.pending`.
    """
    host = client.host
    if not host.settings.synchronous_mode:
        return host.frame + 1

    def tick() -> int:
        return _signalled(client, host.tick())

    subscriptions, managers = host.streams.pending.of(client), host.traffic_managers.unsettled()
    return when_done(host, subscriptions + managers + host.sensors.pending(), tick)


def when_done(host: Host, pending: list[asyncio.Future[Any]], work: Callable[[], T]) -> T | Awaitable[T]:
    """Do something when pending futures and batches of commands are done; at once if there are none."""

    async def later() -> T:
        if pending:
            await asyncio.wait(pending)
        await host.between_batches()
        return work()

    return later() if pending or host.batches else work()


def _signalled(client: Client, frame: int) -> int:
    """Return a frame that the client is about to signal to its traffic managers."""
    client.host.traffic_managers.expect_cycles(client.cycle)
    return frame


@call
def get_map_info(client: Client) -> MapInfo:
    """Return the name of the map and its spawn points."""
    town = client.host.world.town
    return MapInfo(f"{_FOLDER}/{town.name}", town.spawn_points)


@call
def get_map_data(client: Client) -> str:
    """Return the map as OpenDRIVE."""
    return client.host.world.town.opendrive


@call
def get_required_files(client: Client, folder: str = "", download: bool = True) -> list[str]:
    """Return the names of the files that the client needs: the navigation mesh for walkers with AI controllers."""
    return list(navigation_files(client.host.world.town)) if folder == NAVIGATION else []


@call
def request_file(client: Client, name: str) -> bytes:
    """Return a file that the client needs."""
    files = navigation_files(client.host.world.town)
    if name not in files:
        raise CallError(f"{name}: the client needs no such file from this server")
    return files[name]


@call
def get_navigation_mesh(client: Client) -> bytes:
    """Return the navigation mesh; clients of 0.9.16 ask for it as a file."""
    return navigation_mesh(client.host.world.town)


@call
def get_weather_parameters(client: Client) -> Weather:
    """Return the weather."""
    return client.host.world.weather


@call
def set_weather_parameters(client: Client, weather: Weather) -> None:
    """Set the weather."""
    client.host.world.weather = weather


@call
def is_weather_enabled(client: Client) -> bool:
    """Return whether there is weather: there always is."""
    return True


@call
def query_lights_state(client: Client, address: str = "") -> list[bytes]:
    """Return the street lights: there are none."""
    return []


@call
def is_traffic_manager_running(client: Client, port: int) -> bool:
    """Return whether a client runs a traffic manager at a port; a client asks so before it runs one there itself."""
    client.cycle.wanted_port = port
    return client.host.traffic_managers.host(port) is not None


@call
def get_traffic_manager_running(client: Client, port: int) -> tuple[str, int]:
    """Return the address of the traffic manager of a port."""
    host = client.host.traffic_managers.host(port)
    return ("", 0) if host is None else (host, port)


@call
def add_traffic_manager_running(client: Client, address: tuple[str, int]) -> bool:
    """Register a traffic manager that the client runs; without an address, at the port that it has asked about."""
    host, port = address if address[1] else (client.cycle.address, client.cycle.wanted_port)
    return client.host.traffic_managers.add(host, port, client.cycle)


@call
def destroy_traffic_manager(client: Client, port: int) -> None:
    """Unregister a traffic manager."""
    client.host.traffic_managers.remove(port)


@call
def get_available_maps(client: Client) -> list[str]:
    """Return the maps that can be loaded."""
    return [f"{_MAPS}/{name}" for name in client.host.maps.names]


@call
async def copy_opendrive_to_file(client: Client, text: str, parameters: Any = None) -> None:
    """Parse a map for later episodes; the parameters for CARLA's meshes have no effect."""
    async with client.host.maps.loading:
        await client.host.maps.receive(text)


@call
async def load_new_episode(client: Client, name: str, reset_settings: bool = True, layers: int = 0) -> None:
    """Begin a new episode, which destroys all actors and completes a recording.

    The map is named with or without its folder; without a name, it is the current one. If the settings are reset, the world
    is in asynchronous mode. Layers of the map have no effect.

    Other clients go on in the old episode while a map is loaded.
    """
    host = client.host
    async with host.maps.loading:
        town = await host.maps.load(name) if name else host.world.town
        host.recordings.stop()
        await host.recordings.completed()
        await settled()
        if managers := host.traffic_managers.count(client.cycle):
            client.pause = TrafficManagerPause(managers)
            await client.pause.begin(partial(host.publish_again, client))
            client.connection.in_background(_end_pause(client.pause, client))
        await host.between_batches()
        if reset_settings:
            host.apply_settings(EpisodeSettings())
        host.begin_episode(town, client)


async def _end_pause(pause: TrafficManagerPause, client: Client) -> None:
    await pause.end(lambda: client.stream in client.host.streams.subscribed)  # the new one
    if client.pause is pause:
        client.pause = None
