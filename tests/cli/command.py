"""The command line, as a shell and a terminal see it, in this process: to start Python anew takes longer than commands."""

from __future__ import annotations

import logging
import os
import pty
import re
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, chdir, contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from typing import Any, TextIO
from unittest.mock import patch

from carla_recap import cli
from carla_recap.errors import RecapWarning
from tests.samples import SAMPLES
from tests.waiting import PATIENCE

COMMAND = Path(sys.executable).with_name("carla-recap")
CROSSING = SAMPLES / "crossing.log"

ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if not name.startswith(("COLUMNS", "FORCE_", "NO_COLOR", "TTY_"))},
    "TZ": "UTC",
    "TERM": "xterm",
    "COLUMNS": "120",
}
_USUAL = dict(ENVIRONMENT)

Done = subprocess.CompletedProcess[bytes]


def before_others(folder: Path) -> str:
    """Return the import path with a folder in front."""
    return os.pathsep.join(filter(None, (str(folder), ENVIRONMENT.get("PYTHONPATH"))))


def run(*arguments: object, cwd: Path | None = None, **options: Any) -> Done:
    """Run the command, with its output in pipes; in another process if there are options of one, or an environment."""
    words = [os.fspath(_as_path(each)) for each in arguments]
    if options or ENVIRONMENT != _USUAL:
        options = {"env": ENVIRONMENT, "timeout": PATIENCE, "cwd": cwd, **options}
        options |= {} if options.keys() & {"input", "stdin"} else {"stdin": subprocess.DEVNULL}
        return subprocess.run([COMMAND, *words], capture_output=True, check=False, **options)
    with written(*os.pipe()) as (out, printed), written(*os.pipe()) as (err, said):
        code = run_here(words, out, err, cwd)
        return Done(words, code, printed(), said())


def run_on_full_disk(size: int, *arguments: object) -> Done:
    """Run the command where no file can grow beyond a size in bytes, as on a full disk."""
    environment = {**ENVIRONMENT, "PYTHONDONTWRITEBYTECODE": "1"}  # since Python takes bytecode that is cut for whole
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
    return run(*arguments, preexec_fn=limit, env=environment)


def printed(*arguments: str) -> tuple[int, str]:
    """Run the command; return its exit code, and what it prints on stdout and stderr."""
    with written(*os.pipe()) as (end, text):
        return run_here(list(arguments), end, end), text().decode()


@contextmanager
def written(ours: int, theirs: int) -> Iterator[tuple[int, Callable[[], bytes]]]:
    """Yield the end to write to of a pipe or terminal, which its user closes, and a function that reads all."""
    with ThreadPoolExecutor(1) as threads:
        yield theirs, threads.submit(_read, ours).result


def run_here(words: list[Any], out: int, err: int, folder: Path | None = None) -> int:
    """Run the command in this process, with its output in descriptors, which it closes; return its exit code."""
    ensure_running()  # of multiprocessing, which would keep the descriptors
    logger = logging.getLogger("carla_recap")
    handlers, level = list(logger.handlers), logger.level
    with ExitStack() as stack:
        for each in {out, err}:
            stack.callback(os.close, each)
        stack.callback(lambda: (setattr(logger, "handlers", handlers), logger.setLevel(level)))
        streams = [stack.enter_context(_replaced(number, each)) for number, each in ((1, out), (2, err))]
        stack.enter_context(redirect_stdout(streams[0]))
        stack.enter_context(redirect_stderr(streams[1]))
        stack.enter_context(chdir(folder or Path.cwd()))
        stack.enter_context(patch.dict(os.environ, ENVIRONMENT, clear=True))
        stack.enter_context(patch("resource.setrlimit"))  # with which sql limits the memory of its process
        stack.enter_context(patch("carla_recap.tables.arrow.spare_pandas"))  # which holds for all of a process
        stack.callback(time.tzset)
        stack.enter_context(warnings.catch_warnings())
        time.tzset()
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", RecapWarning)
        warnings.showwarning = cli._print_warning
        try:
            return cli.run(words)
        except SystemExit as ended:
            return int(ended.code or 0)


@contextmanager
def _replaced(number: int, by: int) -> Iterator[TextIO]:
    """Yield a stream to a descriptor, which has the number of another one in a `with` block."""
    before = os.dup(number)
    os.dup2(by, number)
    try:
        with open(number, "w", 1 if number == 2 else -1, "utf-8", closefd=False) as stream:
            yield stream
    finally:
        os.dup2(before, number)
        os.close(before)


def _read(descriptor: int) -> bytes:
    pieces = []
    while piece := _piece(descriptor):
        pieces.append(piece)
    os.close(descriptor)
    return b"".join(pieces)


def _piece(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 1 << 16)
    except OSError:  # of a terminal on Linux, when the other side is closed
        return b""


def answer(*arguments: object) -> str:
    """Run a command that succeeds without messages; return what it prints."""
    done = run(*arguments)
    assert (done.returncode, done.stderr) == (0, b""), done
    return done.stdout.decode()


def error(*arguments: object, code: int = 2, **options: Any) -> str:
    """Run a command that fails; return its message."""
    done = run(*arguments, **options)
    assert done.returncode == code
    assert done.stdout == b""
    return the_line(done.stderr)


def the_line(stderr: bytes) -> str:
    """Return the only line of stderr, without the name of the command; all its characters are printable."""
    (line,) = stderr.decode().splitlines()
    assert line.isprintable()
    assert line.startswith("carla-recap: ")
    return line.removeprefix("carla-recap: ")


def wrote(stderr: bytes | str) -> list[str]:
    """Return what success lines say was written, without the sizes at their ends."""
    text = stderr.decode() if isinstance(stderr, bytes) else stderr
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text)
    lines = [line for line in plain.splitlines() if line.startswith("wrote ")]
    found = [re.fullmatch(r"wrote (.*?)[,:] \d+(?:\.\d)? (?:bytes|kB|MB)", line) for line in lines]
    assert all(found), lines
    return [match[1] for match in found if match]


def on_terminal(*arguments: object, stream: str = "stdout") -> tuple[int, str, bytes]:
    """Run the command with one stream on a terminal.

    Returns:
        The exit code, the text on the terminal, and the bytes of the other stream.
    """
    words = [os.fspath(_as_path(each)) for each in arguments]
    with written(*pty.openpty()) as (terminal, shown), written(*os.pipe()) as (pipe, other):
        code = run_here(words, *((terminal, pipe) if stream == "stdout" else (pipe, terminal)))
        return code, shown().decode().replace("\r\n", "\n"), other()


def _as_path(argument: object) -> str | bytes | os.PathLike[str]:
    return argument if isinstance(argument, (bytes, os.PathLike)) else str(argument)
