"""Calls that begin a new episode: with another map, the same one, or one that a client sends."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from carla_recap.server.client import Client
from carla_recap.server.quirks import settled
from carla_recap.server.rpc.registry import call
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.traffic_manager.pause import TrafficManagerPause

_FOLDER: Final = "/Game/Carla/Maps"
"""The folder of maps in CARLA's names."""


@call
def get_available_maps(client: Client) -> list[str]:
    """Return the maps that can be loaded."""
    return [f"{_FOLDER}/{name}" for name in client.host.maps.names]


@call
async def copy_opendrive_to_file(client: Client, text: str, parameters: Any = None) -> None:
    """Parse a map for later episodes; the parameters for CARLA's meshes have no effect."""
    async with client.host.maps.loading:
        await client.host.maps.receive(text)


@call
async def load_new_episode(client: Client, name: str, reset_settings: bool = True, layers: int = 0) -> None:
    """Begin a new episode, which destroys all actors and completes a recording.

    Other clients go on in the old episode while a map is loaded.

    Args:
        client: The client.
        name: The name of a map, with or without its folder; empty for the current map.
        reset_settings: Whether to reset all settings, so that the world is in asynchronous mode.
        layers: The layers of the map, which have no effect.
    """
    host = client.host
    async with host.maps.loading:
        town = await host.maps.load(name) if name else host.world.town
        await settled()
        if host.traffic_managers.has_one(client):
            client.pause = TrafficManagerPause()
            await client.pause.begin(partial(host.publish_again, client))
            client.in_background(_end_pause(client.pause, client))
        if reset_settings:
            host.apply_settings(EpisodeSettings())
        host.begin_episode(town, client)


async def _end_pause(pause: TrafficManagerPause, client: Client) -> None:
    await pause.end(lambda: client.stream in client.host.streams.subscribed)  # the new one
    if client.pause is pause:
        client.pause = None
