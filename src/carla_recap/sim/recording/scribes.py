"""The processes that write recordings, as those see them that have something written; what they do is in `scribe`."""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Final
from weakref import WeakSet

from carla_recap.errors import RecapError

HELLO: Final = b"carla-recap: ready to write recordings\n"
"""What such a process says first; what comes before is what others print when an interpreter starts."""
_COMMAND: Final = """
import signal, pickle, sys
for name in ("SIGINT", "SIGTERM", "SIGHUP"):
    if hasattr(signal, name):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
try:
    sys.path[:] = pickle.load(sys.stdin.buffer)
except EOFError:
    sys.exit()
from carla_recap.sim.recording.scribe import main
main()
"""
"""Signals that are sent to a group of processes are not for this one: it ends when whoever uses it does."""
_HOME: Final = str(Path(__file__).absolute().parents[3])
"""Where this package is, wherever the process goes."""
_PATIENCE: Final = 5.0  # s


class ScribeEnded(RecapError):
    """A process that writes recordings is not there any more."""


class ScribeProcess:
    """A process that writes recordings, one after the other; see `scribe`. It ends when this one does, however that ends.

    Raises:
        RecapError: It cannot be started.
    """

    _all: ClassVar[WeakSet[ScribeProcess]] = WeakSet()
    _resting: ClassVar[list[ScribeProcess]] = []

    def __init__(self) -> None:
        self._owner = os.getpid()
        pipe = subprocess.PIPE
        command = [sys.executable or "python3", "-P", "-c", _COMMAND]  # whatever modules lie in the working directory
        try:  # in a session of its own, the signals of a terminal do not reach it
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        except OSError as error:
            raise RecapError(f"the process that writes recordings cannot be started: {error}") from None
        self._all.add(self)
        try:
            self._meet()
        except BaseException:
            self.end()
            raise

    @classmethod
    def found(cls) -> ScribeProcess:
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
            ScribeEnded: Nobody is there to do it.
        """
        request = pickle.dumps((deed, arguments), pickle.HIGHEST_PROTOCOL)
        try:
            self._send(request)
            assert self._process.stdout is not None
            trouble = pickle.load(self._process.stdout)
        except Exception:
            self.end()
            code = self._process.returncode
            raise ScribeEnded(f"{path}: the process that writes it has ended with exit code {code}") from None
        if trouble is not None:
            raise RecapError(trouble)

    def rest(self) -> None:
        """Be there for the next recording, or end if another one is."""
        if self._resting or not self.is_there:
            self.end()
        else:
            self._resting.append(self)

    def end(self) -> None:
        """End, and wait until that is done; what is being recorded is completed before."""
        with suppress(OSError, ValueError):
            if self.is_there:
                self._send(pickle.dumps(None))  # others may hold the pipe, too, so that it has no end
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @classmethod
    def end_all(cls) -> None:
        """End those that rest."""
        while cls._resting:
            cls._resting.pop().end()

    @classmethod
    def leave_all(cls) -> None:
        """Let go of all, in a process that was just forked: they are its parent's, and are to notice when that ends."""
        nothing = os.open(os.devnull, os.O_RDWR)
        for scribe in tuple(cls._all):
            for pipe in (scribe._process.stdin, scribe._process.stdout):
                if pipe is not None and not pipe.closed:
                    os.dup2(nothing, pipe.fileno(), inheritable=False)
        os.close(nothing)

    def _meet(self) -> None:
        """Tell it where modules are, and wait until it is ready."""
        assert self._process.stdout is not None
        with suppress(OSError):
            self._send(pickle.dumps([*sys.path, _HOME]))
        while (line := self._process.stdout.readline()) != HELLO:
            if not line:
                code = self._process.wait()
                raise RecapError(f"the process that writes recordings cannot be started: it has ended with exit code {code}")

    def _send(self, request: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(request)  # in one piece: each wakes up the other
        self._process.stdin.flush()


atexit.register(ScribeProcess.end_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=ScribeProcess.leave_all)
