"""A child process for CARLA's OpenDRIVE parser, which crashes or hangs on some files, and the bytes of its results."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from io import BytesIO
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import FormatError, MissingExtra, RecapError
from carla_recap.util.processes import module_command, module_environment

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Lines = dict[str, list[NDArray[Any]]]

_LARGEST: Final = 256 << 20  # bytes of a file
_PROCESSOR_TIME: Final = 60  # s, for CARLA's parser
_TIMEOUT: Final = 600.0  # s, for a busy machine
_MEMORY: Final = 4 << 30  # bytes of the child process
_PARENT_CHECK: Final = 0.5  # s
_SIZES: Final = ".sizes"


def read_content(path: Path, *, by_carla: bool = True) -> bytes:
    """Return the content of an OpenDRIVE file.

    Args:
        path: The file.
        by_carla: Whether CARLA's client library will parse it.

    Raises:
        RecapError: The file cannot be read.
        MissingExtra: CARLA's client library is needed and not installed.
    """
    if by_carla:
        try:
            import carla  # noqa: F401
        except ImportError:
            raise MissingExtra("a map", "carla") from None
    if path.exists() and not path.is_file():
        raise RecapError(f"{path}: is not a regular file")
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if len(content) > _LARGEST:
        raise RecapError(f"{path}: is larger than {_LARGEST >> 20} MB, which no map is")
    return content


def decode(content: bytes) -> str:
    """Return the text of an OpenDRIVE file."""
    return content.decode("utf-8-sig", "replace")


def parse_in_child(module: str, path: Path, content: bytes) -> bytes:
    """Parse the content of an OpenDRIVE file in a child process, and return the result.

    Args:
        module: The module to run; it calls `run_child`.
        path: The file, for errors.
        content: Its content.

    Raises:
        FormatError: The file is no OpenDRIVE map.
    """
    try:
        done = subprocess.run(
            module_command(module),
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=module_environment(OPENBLAS_NUM_THREADS="1"),
            timeout=_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FormatError(path, None, f"CARLA's parser has not read it within {_TIMEOUT:g} s") from None
    if done.returncode == -getattr(signal, "SIGXCPU", 0) < 0:
        raise FormatError(path, None, f"CARLA's parser has not read it within {_PROCESSOR_TIME} s of processor time")
    if done.returncode:
        reason = " ".join(done.stdout.decode(errors="replace").split())[:200]
        outcome = f"says: {reason}" if reason else "breaks down on it"
        raise FormatError(path, None, f"an OpenDRIVE map was expected; CARLA's parser {outcome}")
    return done.stdout


def run_child(parse: Callable[[str], bytes]) -> int:
    """Parse OpenDRIVE from the standard input, and write the result to the standard output, in the child process.

    Args:
        parse: Returns the result for a text; where it raises, the message of the error is the output.

    Returns:
        The exit code.
    """
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # the parser prints warnings
        Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
        _limit_resources()
        try:
            output.write(parse(decode(sys.stdin.buffer.read())))
        except Exception as error:
            output.write((str(error) or type(error).__name__).encode())
            return 1
    return 0


def pack(lines: Lines) -> bytes:
    """Return lists of lines by name as the bytes of an .npz; the lines of a list have one width and type."""
    arrays: dict[str, Any] = {}
    for name, group in lines.items():
        arrays[name] = np.concatenate(group) if group else np.empty((0, 3))
        arrays[name + _SIZES] = np.array([len(line) for line in group], np.int64)
    file = BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def unpack(data: bytes) -> Lines:
    """Return the lists of lines in the bytes of an .npz; see `pack`."""
    with np.load(BytesIO(data)) as arrays:
        names = [name for name in arrays.files if not name.endswith(_SIZES)]
        return {name: np.split(arrays[name], np.cumsum(arrays[name + _SIZES]))[:-1] for name in names}


def _end_with(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK)
    os._exit(1)


def _limit_resources() -> None:
    """End this process soon if it allocates or computes without limit, and write no core file."""
    with suppress(ImportError):  # not on Windows
        import resource

        _, allowed = resource.getrlimit(resource.RLIMIT_CPU)
        limit = _PROCESSOR_TIME if allowed == resource.RLIM_INFINITY else min(_PROCESSOR_TIME, allowed)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, allowed))  # ends it by SIGXCPU
        for kind, most in ((resource.RLIMIT_AS, _MEMORY), (resource.RLIMIT_CORE, 0)):
            _, allowed = resource.getrlimit(kind)
            limit = most if allowed == resource.RLIM_INFINITY else min(most, allowed)
            resource.setrlimit(kind, (limit, limit))
