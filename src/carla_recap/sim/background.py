"""Has the frames of a running recording written in a process of its own, so that no tick waits for a disk."""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import TYPE_CHECKING, Any, ClassVar, Final

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from carla_recap.frame import Header
    from carla_recap.sim.snapshots import Strip

QUEUE: Final = 16
"""So many strips may wait; only a disk that is that far behind makes the simulation wait."""
_COMMAND: Final = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from carla_recap.sim.scribe import main
main()
"""


class BackgroundWriter:
    """Takes strips of snapshots in without delay, and has the frames of each written when it is complete.

    What goes wrong with that ends the recording, and nothing else. Should this process be killed, the recording is completed
    all the same, but for what has not been handed over: the last strip, and those that wait for a slow disk.

    Args:
        path: The destination; the suffix says the format.
        header: The header.
        force: Take the place of what is at the destination by the end; else it stays, as does what was recorded, beside it.

    Attributes:
        path: The destination.
        error: What went wrong, and where the frames are that came before; None as long as nothing did.
        pid: The process that writes.

    Raises:
        RecapError: The suffix is of no format, or the place cannot be written to.
    """

    def __init__(self, path: Path, header: Header, *, force: bool = True) -> None:
        self.path = path
        self.error: RecapError | None = None
        folder = _folder(path)
        self._scribe = _Scribe.found()
        self.pid = self._scribe.pid
        try:
            self._scribe.ask(path, "begin", folder, path, header, force)
        except RecapError:
            self._scribe.rest()
            raise
        self._strip: Strip | None = None
        self._strips: Queue[Strip | None] = Queue(QUEUE)
        self._thread = Thread(target=self._run, name="carla-recap-recorder", daemon=True)
        self._thread.start()

    def write(self, strip: Strip) -> None:
        """Add a strip, which is complete when another one comes; what goes wrong is told by `error`, sooner or later."""
        if strip is not self._strip:
            self._hand_over()
            self._strip = strip

    def close(self) -> None:
        """Wait until the file is complete, or has failed; twice is harmless."""
        if self._thread.is_alive():
            self._hand_over()
            self._strips.put(None)
            self._thread.join()

    def _hand_over(self) -> None:
        if self._strip is not None and self.error is None:
            self._strips.put(self._strip)

    def _run(self) -> None:
        strip: Strip | None = None
        try:
            while (strip := self._strips.get()) is not None:
                self._scribe.ask(self.path, "write", strip)
            self._scribe.ask(self.path, "close")
        except RecapError as error:
            self.error = error
            while strip is not None:  # whoever waits for a place in the queue must not wait for ever
                strip = self._strips.get()
        self._scribe.rest()


class _Scribe:
    """A process that writes recordings, one after the other; see `scribe`. It ends when this one does, however that ends."""

    _resting: ClassVar[list[_Scribe]] = []

    def __init__(self) -> None:
        self._owner = os.getpid()
        pipe = subprocess.PIPE
        command = [sys.executable, "-P", "-c", _COMMAND]  # whatever modules lie in the working directory
        try:  # in a session of its own, Ctrl-C does not reach it
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        except OSError as error:
            raise RecapError(f"the process that writes recordings cannot be started: {error}") from None
        self._send(sys.path)

    @classmethod
    def found(cls) -> _Scribe:
        """One that rests, or a new one."""
        while cls._resting:
            scribe = cls._resting.pop()
            if scribe.is_there:
                return scribe
            scribe.end()
        return cls()

    @property
    def is_there(self) -> bool:
        """Whether it has not ended, and is not that of a process that this one was forked from."""
        return self._owner == os.getpid() and self._process.poll() is None

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    def ask(self, path: Path, deed: str, *arguments: Any) -> None:
        """Have something done for the recording at a path, and wait until it is.

        Raises:
            RecapError: It has failed, as the message says.
        """
        try:
            self._send((deed, arguments))
            assert self._process.stdout is not None
            trouble = pickle.load(self._process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            code = self._process.wait()
            end = f"the process that writes it has ended with exit code {code}"
            raise RecapError(
                f"{path}: {end}; what was recorded until then lies beside it, for carla-recap recover"
            ) from None
        if trouble is not None:
            raise RecapError(trouble)

    def rest(self) -> None:
        """Be there for the next recording, or end if another one is."""
        if self._resting or not self.is_there:
            self.end()
        else:
            self._resting.append(self)

    def end(self) -> None:
        """End, and wait until that is done."""
        with suppress(OSError), self._process:
            pass

    @classmethod
    def end_all(cls) -> None:
        """End those that rest."""
        while cls._resting:
            cls._resting.pop().end()

    def _send(self, message: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))  # in one piece: each wakes up the other
        self._process.stdin.flush()


def _folder(path: Path) -> Path:
    """What a path is relative to."""
    try:
        return Path(path.anchor) if path.is_absolute() else Path.cwd()
    except OSError as error:
        raise RecapError(f"{path}: the working directory cannot be told: {error.strerror}") from None


atexit.register(_Scribe.end_all)
