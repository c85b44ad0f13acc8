"""A process of its own for CARLA's parser, which ends or occupies its process on some files."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from carla_recap.errors import FormatError, MissingExtra, RecapError
from carla_recap.util.processes import module_command, module_environment

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_LARGEST: Final = 256 << 20  # bytes
_PATIENCE: Final = 60.0  # s
_MEMORY: Final = 4 << 30  # bytes


def ask(module: str, path: Path) -> tuple[str, bytes]:
    """Let another process read an OpenDRIVE file.

    Args:
        module: What to run there; it calls `answer`.
        path: The file.

    Returns:
        What is in the file, and the answer.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map.
        MissingExtra: CARLA's client library is not installed.
    """
    content = read_content(path)
    return decode(content), ask_about(module, path, content)


def ask_about(module: str, path: Path, content: bytes) -> bytes:
    """Let another process parse the content of an OpenDRIVE file, and return its answer; see `ask`."""
    return _run(module, path, content)


def answer(make: Callable[[str], bytes]) -> int:
    """In the other process: read OpenDRIVE from the standard input, and write what is made of it to the standard output.

    Args:
        make: Makes the answer out of the text; the words of what it raises are the answer where it fails.

    Returns:
        The exit code.
    """
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # the parser prints warnings
        _limit()
        try:
            output.write(make(decode(sys.stdin.buffer.read())))
        except Exception as error:  # whatever the parser comes upon
            output.write((str(error) or type(error).__name__).encode())
            return 1
    return 0


def decode(content: bytes) -> str:
    """Return the text of an OpenDRIVE file."""
    return content.decode("utf-8-sig", "replace")


def read_content(path: Path) -> bytes:
    """Return the content of an OpenDRIVE file; see `ask`."""
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


def _run(module: str, path: Path, content: bytes) -> bytes:
    try:
        done = subprocess.run(
            module_command(module),
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=module_environment(OPENBLAS_NUM_THREADS="1"),
            timeout=_PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FormatError(path, None, f"CARLA's parser has not read it within {_PATIENCE:g} s") from None
    if done.returncode:
        reason = " ".join(done.stdout.decode(errors="replace").split())[:200]
        outcome = f"says: {reason}" if reason else "breaks down on it"
        raise FormatError(path, None, f"an OpenDRIVE map was expected; CARLA's parser {outcome}")
    return done.stdout


def _limit() -> None:
    """Let this process end soon where a file asks for all memory there is, and leave no core file behind."""
    with suppress(ImportError):  # not on Windows
        import resource

        for what, most in ((resource.RLIMIT_AS, _MEMORY), (resource.RLIMIT_CORE, 0)):
            _, allowed = resource.getrlimit(what)
            limit = most if allowed == resource.RLIM_INFINITY else min(most, allowed)
            resource.setrlimit(what, (limit, limit))
