"""The server as a process of its own, for tests and notebooks.

It has to be one: calls of the official client hold Python's global lock, so that a server in the client's own process
could never answer.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import contextmanager
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Final

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_PATIENCE: Final = 30.0  # s, for the recording that is completed at the end


@contextmanager
def running(
    town: str = "",
    *,
    port: int = 0,
    maps: Path | str | None = None,
    recordings: Path | str | None = None,
    seed: int = 0,
    confine: bool = False,
) -> Iterator[int]:
    """Have a server run; it ends, and completes its recording, when the block does, or the process, however that ends.

    Processes that this one has forked, and that go on, keep the server, too.

    Args:
        town: The name of a map or an .xodr file; the built-in town unless told otherwise.
        port: Where it listens; 0 for a port that is free. Streams are at the next one.
        maps: The folder of maps.
        recordings: The folder of recordings.
        seed: Of everything random.
        confine: Refuse recordings outside the folder of recordings.

    Yields:
        The port, for `carla.Client("localhost", port)`.

    Raises:
        RecapError: It does not start; the message is the server's.
    """
    options = {"town": town, "port": port, "maps": maps, "recordings": recordings, "seed": seed}
    arguments = [f"--{name}={value}" for name, value in options.items() if value not in (None, "")]
    if confine:
        arguments.append("--confine")
    command = [sys.executable, "-m", "carla_recap", "serve", "--attached", *arguments]
    pipe = subprocess.PIPE
    with (
        TemporaryFile("w+") as said,
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=said, text=True) as process,
    ):
        try:
            yield _port(process, said)
        finally:
            process.terminate()
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
            said.seek(0)
            print(said.read(), end="", file=sys.stderr)


def _port(process: subprocess.Popen[str], said: IO[str]) -> int:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        process.wait()
        said.seek(0)
        reason = said.read().strip()
        said.truncate(0)  # it is told once
        raise RecapError(reason or f"the server has ended with exit code {process.returncode}")
    return int(line.rsplit(":", 1)[-1])
