"""The processes that write recordings, as those see them that have something written; what they do is in `scribe`."""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from pathlib import Path

_COMMAND: Final = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from carla_recap.sim.scribe import main
main()
"""


class ScribeProcess:
    """A process that writes recordings, one after the other; see `scribe`. It ends when this one does, however that ends."""

    _resting: ClassVar[list[ScribeProcess]] = []

    def __init__(self) -> None:
        self._owner = os.getpid()
        pipe = subprocess.PIPE
        command = [sys.executable, "-P", "-c", _COMMAND]  # whatever modules lie in the working directory
        try:  # in a session of its own, Ctrl-C does not reach it
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        except OSError as error:
            raise RecapError(f"the process that writes recordings cannot be started: {error}") from None
        with suppress(OSError):  # what is wrong with it is told when it is first asked for something
            self._send(sys.path)

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


atexit.register(ScribeProcess.end_all)
