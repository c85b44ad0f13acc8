"""The command line, as a shell and a terminal see it, in processes that are forked off one that has imported it."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import tempfile
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


def run(*arguments: object, cwd: Path | None = None) -> Done:
    """Run the command, without a terminal."""
    words = [os.fspath(_as_path(each)) for each in arguments]
    if _server().environment != ENVIRONMENT:
        command = [COMMAND, *words]
        return subprocess.run(
            command, capture_output=True, env=ENVIRONMENT, stdin=subprocess.DEVNULL, timeout=PATIENCE, check=False, cwd=cwd
        )
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        code = _server().start(words, out.fileno(), err.fileno(), os.fspath(cwd or Path.cwd())).wait(PATIENCE)
        printed = []
        for file in (out, err):
            file.seek(0)
            printed.append(file.read())
    return Done(words, code, *printed)


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
    ours, theirs = pty.openpty()
    with tempfile.TemporaryFile() as file:
        streams = (theirs, file.fileno()) if stream == "stdout" else (file.fileno(), theirs)
        command = _server().start(words, *streams, os.fspath(Path.cwd()))
        os.close(theirs)
        shown = read_terminal(ours)
        code = command.wait(PATIENCE)
        file.seek(0)
        other = file.read()
    os.close(ours)
    return code, shown, other


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


def _as_path(argument: object) -> str | os.PathLike[str]:
    return argument if isinstance(argument, os.PathLike) else str(argument)
