"""Child processes: how the modules of this package are run in one, and how one is ended."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from select import select
from typing import TYPE_CHECKING, Any, Final

from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import IO, BinaryIO

_SOURCES: Final = str(Path(__file__).absolute().parents[2])
"""The folder that contains this package."""
_PARENT_CHECK: Final = 1.0  # s between checks whether the parent has ended


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module with this interpreter; modules in the working directory are not imported."""
    log_info(__name__, "runs %s in a process of its own", module)
    return [sys.executable or "python3", "-P", "-m", module, *arguments]


def module_environment(**variables: str) -> dict[str, str]:
    """Return this process's environment, with the import path of this process and with some more variables."""
    path = [str(Path(entry).absolute()) for entry in sys.path if entry]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys([*path, _SOURCES])), **variables}


def environment_of_user() -> dict[str, str]:
    """Return this process's environment without what the command line has set in it for itself."""
    found = dict(os.environ)
    if found.pop("CARLA_RECAP_ONE_THREAD", None) is not None:
        found.pop("OPENBLAS_NUM_THREADS", None)
    return found


def wait_or_kill(process: subprocess.Popen[Any], patience: float) -> int:
    """Wait until a process has ended, and return its exit code; kill it after `patience` seconds."""
    try:
        return process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def terminate(process: subprocess.Popen[Any], patience: float) -> int:
    """Send SIGTERM to a process, and return its exit code; kill it after `patience` seconds."""
    process.terminate()
    return wait_or_kill(process, patience)


def close_pipes(process: subprocess.Popen[Any]) -> None:
    """Close this end of the pipes of a process, whether or not the process still reads them."""
    for pipe in (process.stdin, process.stdout, process.stderr):
        with suppress(OSError):
            if pipe is not None:
                pipe.close()


def is_readable(pipe: IO[bytes], patience: float) -> bool:
    """Return whether there is something to read from a pipe, in its buffer or within `patience` seconds, or its end."""
    os.set_blocking(pipe.fileno(), False)
    try:
        has_read = bool(pipe.peek(1))  # type: ignore[attr-defined]
    finally:
        os.set_blocking(pipe.fileno(), True)
    return has_read or bool(select([pipe], [], [], patience)[0])


def read_commands(commands: BinaryIO) -> Iterator[Any]:
    """Yield the commands to a child process, in it: pickles, of which None is the last one.

    They end with the pipe, too, and with the parent, since other processes that it has forked may hold the pipe open.
    """
    parent = os.getppid()
    while True:
        if commands is sys.stdin.buffer and os.name == "posix":
            while not is_readable(commands, _PARENT_CHECK):
                if os.getppid() != parent:
                    return
        try:
            command = pickle.load(commands)
        except (EOFError, OSError, pickle.UnpicklingError):
            return
        if command is None:
            return
        yield command
