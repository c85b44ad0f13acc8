"""Calls about recordings: recording, replaying and querying them.

Failures for which CARLA has a text are answered with it; all others become the client's RuntimeError.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Final

from carla_recap.errors import NotARecording
from carla_recap.queries.blocked import blocked
from carla_recap.queries.collisions import collisions
from carla_recap.queries.info import info
from carla_recap.server import recordings
from carla_recap.server.host import Client
from carla_recap.server.rpc.codec import DecodeError, EncodedText, decoder
from carla_recap.server.rpc.registry import call
from carla_recap.sim.errors import MapMissing
from carla_recap.sim.geometry import Transform
from carla_recap.sim.replaying.replayer import CHASE, is_of

_NEWS: Final = 0.1
"""Seconds until a client that has just been sent a new episode assigns its calls to that one."""
_LOG: Final = logging.getLogger(__name__)


@call
async def start_recorder(client: Client, name: str, additional_data: bool = False, stop_replayer: bool = True) -> str:
    """Begin a recording and return its absolute path; an empty text where it cannot be written to.

    The suffix .mcap, or none, is for MCAP; any other one is for CARLA's format, as the release of the client writes it. A
    running replay ends, as in CARLA, unless
    a newer client asks to record it.
    """
    world = client.host.world
    if stop_replayer and world.replayer.is_playing:
        _LOG.warning("start_recorder: the replay of %s ends, and its actors are destroyed", world.replayer.path)
        world.stop_replayer()
    return await client.host.recordings.start(name, additional_data, wide=client.release.wide)


@call
def stop_recorder(client: Client) -> None:
    """End the recording; calls of the client that follow are answered when it is complete, as are those about recordings."""
    client.host.recordings.stop()
    client.connection.read_after(client.host.recordings.completed())


@call
def show_recorder_file_info(client: Client, name: str, show_all: bool) -> Awaitable[EncodedText]:
    """Return the events of a recording, or all of its records."""
    return _answer(client, name, partial(info, all=show_all, compat=True))


@call
def show_recorder_collisions(client: Client, name: str, type1: int, type2: int) -> Awaitable[EncodedText]:
    """Return the collisions between two types of actors, which are letters, as bytes."""
    letters = [chr(type & 0xFF) for type in (type1, type2)]
    return _answer(client, name, lambda reader: collisions(reader, *letters, compat=True))


@call
def show_recorder_actors_blocked(client: Client, name: str, min_time: float, min_distance: float) -> Awaitable[EncodedText]:
    """Return the actors that stood still; times in s, distances in cm."""
    query = partial(blocked, min_time=min_time, min_distance=min_distance, compat=True)
    return _answer(client, name, query)


@call
async def replay_file(
    client: Client,
    name: str,
    start: float,
    duration: float,
    follow_id: int,
    option1: Any = None,
    option2: Any = None,
    option3: Any = None,
    option4: Any = None,
) -> str:
    """Replay a recording; times in s.

    With a follow_id other than 0, the spectator follows that actor of the recording, at an offset. A recording of another
    map begins a new episode with that map. Clients differ in the order of the options, but not in their types: the booleans
    replay_sensors and, since 2026, replay_weather; the offset, a transform; and, since 2025, the name of a map to replay on.
    """
    sensors, weather, offset, map_name = _replay_options(client, option1, option2, option3, option4)
    world, replayer = client.host.world, client.host.world.replayer
    client.host.recordings.stop()
    world.stop_replayer()
    await client.host.recordings.completed()
    path = client.host.recordings.find(name)
    if not path.is_file():
        return recordings.replaying(path) + recordings.not_found(path)
    try:
        opened = await asyncio.to_thread(replayer.open, path, start, max(duration, 0.0), follow_id, lenient=True)
    except NotARecording:
        return recordings.replaying(path) + recordings.NOT_A_RECORDING
    with ExitStack() as failing:
        failing.callback(opened.player.reader.close)
        maps, recorded = client.host.maps, map_name or opened.player.reader.header.map_name
        is_only_here = maps.is_only_here(recorded, stand_in=bool(map_name))  # corridors stand in for a recording's map
        town = await maps.load(recorded) if is_only_here and not is_of(world.town, recorded) else None
        if town is None:
            await maps.preload(recorded, None if map_name else path)
        await client.host.between_batches()
        client.host.recordings.stop()
        frames, is_new = world.frame, False
        try:
            if town is not None:
                world.reload(town)
            steps = replayer.begin(opened, world.reload, sensors, offset, replay_weather=weather, map_name=map_name)
            begun = client.host.take(steps)
            failing.pop_all()
            is_new = client.host.check_episode(frames)
            replay = await asyncio.shield(begun) if isinstance(begun, asyncio.Future) else begun
        except MapMissing as error:
            return recordings.replaying(path) + recordings.map_missing(error)
        finally:
            if client.host.check_episode(frames) or is_new:
                client.host.publish()
    client.host.takeover.begin_replay()
    replay = replace(replay, loaded=replay.loaded or town is not None)
    if replay.loaded:
        await asyncio.sleep(_NEWS)
    return recordings.replay_begins(replay, replayer, max(start, replay.start), duration)


@call
def stop_replayer(client: Client, keep_actors: bool) -> None:
    """End the replay."""
    client.host.world.stop_replayer(keep_actors)


@call
def set_replayer_time_factor(client: Client, factor: float) -> None:
    """Set the number of seconds of a recording that pass in a second, of this replay and of later ones."""
    client.host.world.replayer.time_factor = factor


@call
def set_replayer_ignore_hero(client: Client, ignore: bool) -> None:
    """Set whether later replays leave the hero out."""
    client.host.world.replayer.ignore_hero = ignore


@call
def set_replayer_ignore_spectator(client: Client, ignore: bool) -> None:
    """Set whether later replays leave the spectator alone."""
    client.host.world.replayer.ignore_spectator = ignore


async def _answer(client: Client, name: str, query: recordings.Query) -> EncodedText:
    async with client.queries:
        await client.host.recordings.completed()
        return await recordings.answer(client.host.recordings.find_complete(name), query)


def _replay_options(client: Client, *options: Any) -> tuple[bool, bool, Transform, str]:
    """Return replay_sensors, replay_weather, the offset and the name of a map, with CARLA's defaults."""
    flags = [option for option in options if option.__class__ is bool]
    names = [option for option in options if option.__class__ is str]
    offsets = [decoder(Transform, client.release)(option) for option in options if option.__class__ is list]
    given = [option for option in options if option is not None]
    if len(given) > len(flags) + len(names) + len(offsets) or len(flags) > 2 or len(names) > 1 or len(offsets) > 1:
        raise DecodeError(f"replay_file: expected two booleans, a transform and the name of a map, found {given!r:.200}")
    sensors, weather = [*flags, *(False, True)[len(flags) :]]
    return sensors, weather, (offsets or [CHASE])[0], (names or [""])[0]
