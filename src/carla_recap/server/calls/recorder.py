"""Calls about recordings: recording, replaying and querying them.

What CARLA has a text for is answered with its text, even where that tells of a failure; all else that goes wrong becomes
the client's RuntimeError.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from functools import partial
from typing import Final

from carla_recap import queries
from carla_recap.errors import NotARecording
from carla_recap.server import replies
from carla_recap.server.client import Client
from carla_recap.server.rpc.registry import call
from carla_recap.sim.errors import MapMissing
from carla_recap.sim.geometry import Transform
from carla_recap.sim.replaying.replayer import CHASE, Replay

_NEWS: Final = 0.1
"""s, until a client that has just been sent a new episode knows of it, and takes its calls to be of that."""


@call
def start_recorder(client: Client, name: str, additional_data: bool = False) -> str:
    """Begin a recording; the suffix says the format, and it is MCAP without one. The answer is where it will be.

    Where CARLA gives an empty text, because the file cannot be written, the client gets an error that says why.
    """
    return str(client.host.recordings.start(name, additional_data))


@call
def stop_recorder(client: Client) -> None:
    """Complete the recording."""
    client.host.world.stop_recorder()


@call
def show_recorder_file_info(client: Client, name: str, show_all: bool) -> Awaitable[str]:
    """What is in a recording: its events, or all records."""
    return _answer(client, name, partial(queries.info, all=show_all, compat=True))


@call
def show_recorder_collisions(client: Client, name: str, type1: int, type2: int) -> Awaitable[str]:
    """Who collided with whom; the types of actors are letters, as bytes."""
    letters = [chr(type & 0xFF) for type in (type1, type2)]
    return _answer(client, name, lambda reader: queries.collisions(reader, *letters, compat=True))


@call
def show_recorder_actors_blocked(client: Client, name: str, min_time: float, min_distance: float) -> Awaitable[str]:
    """Who stood still; times in s, distances in cm."""
    query = partial(queries.blocked, min_time=min_time, min_distance=min_distance, compat=True)
    return _answer(client, name, query)


@call
async def replay_file(
    client: Client,
    name: str,
    start: float,
    duration: float,
    follow_id: int,
    replay_sensors: bool = False,
    offset: Transform = CHASE,
) -> str:
    """Re-enact a recording; times in s.

    A follow_id of 0 is nobody; else the spectator follows that actor of the recording, at an offset. A recording of
    another map begins a new episode with that map.
    """
    world = client.host.world
    world.stop_recorder()
    path = client.host.recordings.find(name)
    if not path.is_file():
        world.stop_replayer()
        return replies.replaying(path) + replies.not_found(path)
    try:
        replay = _replay(client, str(path), start, max(duration, 0.0), follow_id, replay_sensors, offset)
    except NotARecording:
        return replies.replaying(path) + replies.NOT_A_RECORDING
    except MapMissing as error:
        return replies.replaying(path) + replies.map_missing(error)
    if replay.loaded:
        await asyncio.sleep(_NEWS)
    return replies.replay_begins(replay, world.replayer, duration)


@call
def stop_replayer(client: Client, keep_actors: bool) -> None:
    """End the replay."""
    client.host.world.stop_replayer(keep_actors)


@call
def set_replayer_time_factor(client: Client, factor: float) -> None:
    """How many seconds of a recording pass in a second; at once, and in the replays to come."""
    client.host.world.set_replayer_time_factor(factor)


@call
def set_replayer_ignore_hero(client: Client, ignore: bool) -> None:
    """Whether the replays to come leave the hero out."""
    client.host.world.set_replayer_ignore_hero(ignore)


@call
def set_replayer_ignore_spectator(client: Client, ignore: bool) -> None:
    """Whether the replays to come leave the spectator alone."""
    client.host.world.set_replayer_ignore_spectator(ignore)


async def _answer(client: Client, name: str, query: replies.Query) -> str:
    return await replies.answer(client.host.recordings.find_complete(name), query)


def _replay(
    client: Client, path: str, start: float, duration: float, follow: int, sensors: bool, offset: Transform
) -> Replay:
    host = client.host
    frames = host.world.frame
    try:
        return host.world.replay_file(path, start, duration, follow, sensors, offset)
    finally:
        if host.check_episode(frames):
            host.publish()
