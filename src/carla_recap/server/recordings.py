"""The recordings that clients name, and what CARLA 0.9.16 answers to calls about them, as text."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

from carla_recap.errors import NotARecording
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.output.text import text
from carla_recap.queries.blocked import Blocked
from carla_recap.queries.collisions import Collisions
from carla_recap.queries.info import Info
from carla_recap.server.rpc.codec import EncodedText
from carla_recap.server.rpc.registry import CallError
from carla_recap.sim.errors import DestinationError
from carla_recap.sim.recording.recorder import is_within, recording_path, recordings_folder
from carla_recap.sim.recording.writer_process import discard_process, start_process
from carla_recap.sim.replaying.replayer import find_recording
from carla_recap.util.text import number, readable

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.sim.errors import MapMissing
    from carla_recap.sim.replaying.replayer import Replay, Replayer
    from carla_recap.sim.world import World

Query = Callable[[Reader], Blocked | Collisions | Info]

NOT_A_RECORDING: Final = "File is not a CARLA recorder\n"
NOT_RECORDED: Final = ""
"""CARLA's answer where the file of a recording cannot be opened."""
_LONGEST: Final = 100 << 20
"""The most bytes of an answer: a connection for which more is kept may be closed. The command line gives longer ones."""
_SHOWN: Final = 200  # characters of a name in a message
_LOG: Final = logging.getLogger(__name__)


class Recordings:
    """Finds recordings by the names that clients give them; if it is confined, in the folder of recordings alone."""

    def __init__(self, world: World, *, confined: bool = False) -> None:
        self._world = world
        self._confined = confined
        self._thread = ThreadPoolExecutor(1, "carla-recap-recordings")
        self._completed = self._thread.submit(lambda: None)

    def stop(self) -> None:
        """End the recording, if there is one; its file is completed in a thread, so that no tick waits for it."""
        if self._world.recorder.path is not None:
            self._completed = self._thread.submit(self._world.recorder.end())
            self._completed.add_done_callback(_log_error)

    async def completed(self) -> None:
        """Wait until the file of each recording that has ended is complete, or has failed, which is in the log."""
        await asyncio.wait([asyncio.wrap_future(self._completed)])

    def close(self) -> None:
        """Wait until the threads have ended."""
        self._thread.shutdown()

    async def start(self, name: str, additional_data: bool, *, wide: bool = False) -> str:
        """Begin a recording; a recording without frames has its name at once, since clients do not wait for the end.

        Return the absolute path, or `NOT_RECORDED` where it cannot be written to, and the reason is logged. A `RecapError`
        is raised if no recording can have the name.
        """
        _expect_name(name)
        recorder = self._world.recorder
        self._check(name, recording_path(name, self._world.recordings))
        destination = recorder.destination(name)
        self._check(name, destination)
        process = await asyncio.to_thread(start_process)
        if recorder.path is not None:
            _LOG.warning("start_recorder: the recording of %s ends, since %s begins", recorder.path, destination)
            self.stop()
        try:
            now = self._world.replayer.shows_start
            path = recorder.start(name, additional_data, visible=True, now=now, wide=wide, process=process)
            return str(path.absolute())
        except BaseException as error:
            discard_process(process)
            if not isinstance(error, DestinationError):
                raise
            _LOG.warning("start_recorder: %s", error)
            return NOT_RECORDED

    def find(self, name: str) -> Path:
        """Return the path of a recording, whose suffix may be missing, whether or not it exists.

        A `CallError` is raised if it must not be read, or cannot be; or if it has ended early, and lies elsewhere.
        """
        _expect_name(name)
        try:
            path = find_recording(name, self._world.recordings).absolute()
        except OSError as error:
            raise CallError(f"{_shown(name)}: cannot be read: {error.strerror}") from None
        except ValueError:  # as of the root, or the working directory
            raise _no_name(name) from None
        self._check(name, path)
        if not path.is_file():
            destination = path if path.suffix else path.with_name(path.name + ".mcap")
            failure = self._world.recorder.failures.get(destination)
            if failure is not None:
                raise CallError(f"the recording has ended early: {failure}")
        return path

    def find_complete(self, name: str) -> Path:
        """Return the path of a recording, see `find`; raise `CallError`, too, if it is being recorded just now."""
        path = self.find(name)
        running = self._world.recorder.path
        if running is not None and running.absolute() in (path, path.with_name(path.name + running.suffix)):
            raise CallError(f"{running} is being recorded; it can be asked about after stop_recorder()")
        return path

    def _check(self, name: str, path: Path) -> None:
        folder = recordings_folder(self._world.recordings)
        if self._confined and not is_within(path, folder):
            raise CallError(f"{_shown(name)}: is outside the folder of recordings, {folder}; this server is confined to it")


def _log_error(completed: Future[None]) -> None:
    if (error := completed.exception()) is not None:
        _LOG.error("a recording could not be completed: %s", error)


def _expect_name(name: str) -> None:
    if "\0" in name:
        raise _no_name(name)


def _no_name(name: str) -> CallError:
    return CallError(f"{_shown(name)}: expected the name of a recording")


def _shown(name: str) -> str:
    return f"{name!r:.{_SHOWN}}"


# --- CARLA's texts -----------------------------------------------------------------------------------------------------


def not_found(path: Path) -> str:
    """Return the answer about a recording that does not exist."""
    return f"File {path} not found on server\n"


async def answer(path: Path, query: Query) -> EncodedText:
    """Return the answer to a query; it runs in a thread, so that the world goes on meanwhile.

    A `RecapError` is raised if the recording is damaged, or the answer is too long.
    """
    if not path.is_file():
        return _encoded(not_found(path))
    is_over = threading.Event()
    try:
        return await asyncio.to_thread(_ask, path, query, is_over)
    finally:
        is_over.set()


def _ask(path: Path, query: Query, is_over: threading.Event) -> EncodedText:
    try:
        reader = open_reader(path)
    except NotARecording:
        return _encoded(NOT_A_RECORDING)
    found = EncodedText()
    try:
        for piece in text(query(reader)):
            found += _encoded(piece)
            if len(found) > _LONGEST:
                raise CallError(f"{path}: the answer has more than {_LONGEST} bytes; `carla-recap info` gives it, too")
            if is_over.is_set():
                break
    finally:
        reader.close()
    return found


def _encoded(text: str) -> EncodedText:
    return EncodedText(text, "utf-8", "surrogateescape")


def replaying(path: Path) -> str:
    """Return the first line of each answer about a replay."""
    return f"Replaying File: {path}\n"


def map_missing(error: MapMissing) -> str:
    """Return the answer about a recording whose map is unavailable; the second line, the reason, is not CARLA's."""
    return f"Could not load mapfile {readable(error.map_name)}\n{error.reason}\n"


def replay_begins(replay: Replay, replayer: Replayer, begin: float, duration: float) -> str:
    """Return the answer about a replay that has begun.

    CARLA reports the start that was asked for, even where it is after the end, and the end by the duration that was asked
    for, even where the recording is shorter; both in s.
    """
    total, start = number(replay.total), number(begin)
    stop = number(begin + duration) if duration > 0 else total
    lines = replaying(replay.path)
    if replay.loaded:
        lines += f"Loading map {readable(replay.map_name)}\nReplayer will start after map is loaded...\n"
    if replay.on_corridors:
        lines += f"There is no map {readable(replay.map_name)}: the corridors that the vehicles have driven are its roads\n"
    lines += f"Total time recorded: {total}\n"
    lines += f"Replaying from {start} s - {stop} s ({total} s) at {replay.time_factor:.1f}x\n"
    if replayer.ignore_hero:
        lines += "Ignoring Hero vehicle\n"
    if replayer.ignore_spectator:
        lines += "Ignoring Spectator camera\n"
    return lines
