"""Calls that begin a new episode: with another map, the same one, or one that a client sends."""

from __future__ import annotations

import asyncio
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Final

from carla_recap.errors import RecapError
from carla_recap.maps.road_map import find_map, find_maps
from carla_recap.server.client import Client
from carla_recap.server.rpc.registry import CallError, call
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.traffic_manager.pause import TrafficManagerPause
from carla_recap.sim.town.town import Town, load_town

_SENT: Final = "OpenDriveMap"
"""The name of the map that a client has sent, as with CARLA."""
_FOLDER: Final = "/Game/Carla/Maps"
"""The folder of maps in CARLA's names."""


@call
def get_available_maps(client: Client) -> list[str]:
    """Return the maps that can be loaded."""
    return [f"{_FOLDER}/{name}" for name in sorted(find_maps(client.host.world.maps))]


@call
async def copy_opendrive_to_file(client: Client, text: str, parameters: Any = None) -> None:
    """Parse a map for later episodes; the parameters for CARLA's meshes have no effect."""
    async with client.host.loading:
        client.host.sent_town = await asyncio.to_thread(_parse, text)


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
    async with host.loading:
        town = await _load(client, name)
        if host.traffic_managers.has_one(client):
            client.pause = TrafficManagerPause()
            await client.pause.begin(partial(host.publish_again, client))
            client.in_background(_end_pause(client.pause, client))
        if reset_settings:
            host.apply_settings(EpisodeSettings())
        host.begin_episode(town, client)


async def _load(client: Client, name: str) -> Town:
    host = client.host
    if not name:
        return host.world.town
    if name.rpartition("/")[2] == _SENT:
        if host.sent_town is None:
            raise CallError(f"{name}: no map has been sent to this server")
        return host.sent_town
    path = find_map(name, host.world.maps) or _find_in_any_case(name, host.world.maps)
    if path is None:
        raise CallError(f"{name!r}: there is no such map; there are {', '.join(sorted(find_maps(host.world.maps)))}")
    return await asyncio.to_thread(load_town, path)


def _find_in_any_case(name: str, folder: Path | str | None) -> Path | None:
    wanted = name.rpartition("/")[2].casefold()
    return next((path for known, path in find_maps(folder).items() if known.casefold() == wanted), None)


def _parse(text: str) -> Town:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{_SENT}.xodr"
        path.write_bytes(text.encode(errors="surrogateescape"))
        try:
            return load_town(path)
        except RecapError as error:
            raise CallError(str(error).replace(str(path), _SENT)) from None


async def _end_pause(pause: TrafficManagerPause, client: Client) -> None:
    await pause.end(lambda: client.stream in client.host.streams.subscribed)  # the new one
    if client.pause is pause:
        client.pause = None
