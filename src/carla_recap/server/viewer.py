"""Rerun's viewer or a connection for Foxglove on the served world, as a client in a process of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from carla_recap.capture.live import check_target
from carla_recap.replay.follow import HERO, Follow
from carla_recap.scene.models import models_directory
from carla_recap.util.files import make_folder
from carla_recap.util.processes import module_command, module_environment, terminate

if TYPE_CHECKING:
    from types import TracebackType

_WILDCARDS: Final = {"0.0.0.0": "127.0.0.1", "::": "::1"}
_TO_END: Final = 15.0  # s, for the .rrd to be completed


class ViewerProcess:
    """A viewer of the server until the end of a `with` block; closing its window does not end the server.

    `to` is an .rrd or the address of a viewer, else a viewer is opened, see `carla_recap.capture.live.watch`; the camera
    follows an actor. To a Foxglove port, Foxglove connects instead; its address is printed.

    Raises:
        RecapError: There is no display, or the file cannot be written.
        MissingExtra: No viewer is installed.
    """

    def __init__(self, to: str | None = None, follow: Follow = HERO, foxglove_port: int | None = None) -> None:
        check_target(to, foxglove_port, force=False)
        if to is not None and "://" not in to:
            make_folder(Path(to).parent)
        models = models_directory()
        self._options = [f"--follow={follow}", *([f"--to={to}"] if to else []), *([f"--models={models}"] if models else [])]
        if foxglove_port is not None:
            self._options.append(f"--foxglove-port={foxglove_port}")
        self._prints = foxglove_port is not None  # the address to which Foxglove connects
        self._process: subprocess.Popen[bytes] | None = None

    def open(self, host: str, port: int) -> None:
        """Show the server at an address."""
        options = [f"--host={_WILDCARDS.get(host, host)}", f"--port={port}", *self._options]
        command, nothing = module_command("carla_recap", "watch", *options), subprocess.DEVNULL
        output = None if self._prints else nothing
        self._process = subprocess.Popen(command, stdin=nothing, stdout=output, env=module_environment())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._process is not None:
            terminate(self._process, _TO_END)
