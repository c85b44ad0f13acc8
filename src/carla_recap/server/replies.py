"""What CARLA 0.9.16 answers to calls about recordings, as text."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from carla_recap.errors import NotARecording
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.queries import Blocked, Collisions, Info
from carla_recap.queries.lines import number
from carla_recap.queries.report import text
from carla_recap.server.rpc.registry import CallError
from carla_recap.texts import readable

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.sim.errors import MapMissing
    from carla_recap.sim.replaying.replayer import Replay, Replayer

Query = Callable[[Reader], Blocked | Collisions | Info]

NOT_A_RECORDING: Final = "File is not a CARLA recorder\n"
_LONGEST: Final = 1 << 29
"""Characters of an answer; who wants more than these 500 MB, asks the command line."""


def not_found(path: Path) -> str:
    """Of a recording that is not there."""
    return f"File {path} not found on server\n"


async def answer(path: Path, query: Query) -> str:
    """Of a query; it is asked in a thread, so that the world goes on meanwhile.

    Args:
        path: The recording.
        query: What is asked of it, as by CARLA.

    Raises:
        RecapError: The recording is damaged, or the answer is too long.
    """
    if not path.is_file():
        return not_found(path)
    is_over = threading.Event()
    try:
        return await asyncio.to_thread(_ask, path, query, is_over)
    finally:
        is_over.set()


def _ask(path: Path, query: Query, is_over: threading.Event) -> str:
    try:
        reader = open_reader(path)
    except NotARecording:
        return NOT_A_RECORDING
    pieces, length = [], 0
    try:
        for piece in text(query(reader)):
            pieces.append(piece)
            length += len(piece)
            if length > _LONGEST:
                raise CallError(f"{path}: the answer has more than {_LONGEST} characters; `carla-recap info` gives it, too")
            if is_over.is_set():
                break
    finally:
        reader.close()
    return "".join(pieces)


def replaying(path: Path) -> str:
    """The first line of each answer about a replay."""
    return f"Replaying File: {path}\n"


def map_missing(error: MapMissing) -> str:
    """Of a recording whose map is not to be had; the second line, why, is not CARLA's."""
    return f"Could not load mapfile {readable(error.map_name)}\n{error.reason}\n"


def replay_begins(replay: Replay, replayer: Replayer, duration: float) -> str:
    """Of a replay that has begun.

    Args:
        replay: What is replayed.
        replayer: Who replays it.
        duration: How long it was told to last, in s; CARLA tells its end even where the recording is shorter.
    """
    total, start = number(replay.total), number(replay.start)
    stop = number(replay.start + duration) if duration > 0 else total
    told = replaying(replay.path)
    if replay.loaded:
        told += f"Loading map {readable(replay.map_name)}\nReplayer will start after map is loaded...\n"
    told += f"Total time recorded: {total}\n"
    told += f"Replaying from {start} s - {stop} s ({total} s) at {replay.time_factor:.1f}x\n"
    if replayer.ignore_hero:
        told += "Ignoring Hero vehicle\n"
    if replayer.ignore_spectator:
        told += "Ignoring Spectator camera\n"
    return told
