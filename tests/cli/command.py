"""The command line, as a shell and a terminal see it, in processes that are forked off one that has imported it."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

from tests.cli.fork_server import ForkServer
from tests.samples import SAMPLES
from tests.waiting import PATIENCE, time_limit

COMMAND = Path(sys.executable).with_name("carla-recap")
CROSSING = SAMPLES / "crossing.log"

ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if not name.startswith(("COLUMNS", "FORCE_", "NO_COLOR", "TTY_"))},
    "TZ": "UTC",
    "TERM": "xterm",
    "COLUMNS": "120",
}

Done = subprocess.CompletedProcess[bytes]


def before_others(folder: Path) -> str:
    """Return the import path with a folder in front."""
    return os.pathsep.join(filter(None, (str(folder), ENVIRONMENT.get("PYTHONPATH"))))


@cache
def _server() -> ForkServer:
    return ForkServer(ENVIRONMENT)


def run(*arguments: object, cwd: Path | None = None, **options: Any) -> Done:
    """Run the command, with its output in pipes."""
    words = [os.fspath(_as_path(each)) for each in arguments]
    if options or _server().environment != ENVIRONMENT:
        options = {"env": ENVIRONMENT, "timeout": PATIENCE, "cwd": cwd, **options}
        options |= {} if options.keys() & {"input", "stdin"} else {"stdin": subprocess.DEVNULL}
        return subprocess.run([COMMAND, *words], capture_output=True, check=False, **options)
    (out, out_end), (err, err_end) = os.pipe(), os.pipe()
    command = _server().start(words, out_end, err_end, cwd)
    with ThreadPoolExecutor(2) as threads:
        printed = threads.map(_read, (out, err))
        return Done(words, command.wait(PATIENCE), *printed)


def printed(*arguments: str) -> tuple[int, str]:
    """Run the command; return its exit code, and what it prints on stdout and stderr."""
    pipe, end = os.pipe()
    command = _server().start(list(arguments), end, end)
    with ThreadPoolExecutor(1) as threads:
        text = threads.submit(_read, pipe)
        return command.wait(PATIENCE), text.result().decode()


def _read(descriptor: int) -> bytes:
    with open(descriptor, "rb") as file:
        return file.read()


def answer(*arguments: object) -> str:
    """Run a command that succeeds without messages; return what it prints."""
    done = run(*arguments)
    assert (done.returncode, done.stderr) == (0, b"")
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
    (ours, theirs), (pipe, pipe_end) = pty.openpty(), os.pipe()
    streams = (theirs, pipe_end) if stream == "stdout" else (pipe_end, theirs)
    command = _server().start(words, *streams)
    with ThreadPoolExecutor(1) as threads:
        other = threads.submit(_read, pipe)
        shown = read_terminal(ours)
        code = command.wait(PATIENCE)
    os.close(ours)
    return code, shown, other.result()


def read_terminal(terminal: int) -> str:
    pieces = []
    with time_limit():
        while True:
            try:
                piece = os.read(terminal, 1 << 16)
            except OSError:  # Linux, when the other side is closed
                piece = b""
            if not piece:
                return b"".join(pieces).decode().replace("\r\n", "\n")
            pieces.append(piece)


def _as_path(argument: object) -> str | bytes | os.PathLike[str]:
    return argument if isinstance(argument, (bytes, os.PathLike)) else str(argument)
