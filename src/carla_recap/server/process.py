"""The server as a process of its own, for tests and notebooks.

It cannot run in the client's process: calls of the official client hold Python's global interpreter lock.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import contextmanager
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.util.processes import module_command, module_environment, terminate

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.rendering.camera import Quality

_TO_END: Final = 30.0  # s, for the recording to be completed


@contextmanager
def running(
    town: str = "",
    *,
    port: int = 0,
    maps: Path | str | None = None,
    recordings: Path | str | None = None,
    seed: int = 0,
    confine: bool = False,
    stand_in: bool = False,
    quality: Quality = "epic",
    carla: str = "auto",
) -> Iterator[int]:
    """Run a server until the end of a `with` block or of this process, however that ends; a recording is completed.

    Processes that have been forked from this one keep the server running, too.

    Args:
        town: The name of a map or an .xodr file; by default the built-in town.
        port: The port for calls, 0 for a free one; the next one is for streams.
        maps: The folder of maps.
        recordings: The folder of recordings.
        seed: The seed of everything random.
        confine: Refuse recordings outside the folder of recordings.
        stand_in: Serve the built-in town under the name of a map that is missing.
        quality: The quality of the images of cameras: "low" or "epic".
        carla: The release of clients, such as "0.9.15"; others are refused. "auto": each client's own.

    Yields:
        The port, for `carla.Client("localhost", port)`.

    Raises:
        RecapError: The server does not start; the message is the server's.
    """
    options = {
        "town": town,
        "port": port,
        "maps": maps,
        "recordings": recordings,
        "seed": seed,
        "quality": quality,
        "carla": carla,
    }
    arguments = [f"--{name}={value}" for name, value in options.items() if value not in (None, "")]
    arguments += [flag for flag, is_set in (("--confine", confine), ("--stand-in", stand_in)) if is_set]
    command = module_command("carla_recap", "serve", "--attached", *arguments)
    pipe = subprocess.PIPE
    with (
        TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=errors, text=True, env=module_environment()) as process,
    ):
        try:
            yield _port(process, errors)
        finally:
            terminate(process, _TO_END)
            errors.seek(0)
            print(errors.read(), end="", file=sys.stderr)


def _port(process: subprocess.Popen[str], errors: IO[str]) -> int:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        process.wait()
        errors.seek(0)
        reason = errors.read().strip()
        errors.truncate(0)  # it is printed only once
        raise RecapError(reason or f"the server has ended with exit code {process.returncode}")
    return int(line.rsplit(":", 1)[-1])
