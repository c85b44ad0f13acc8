"""Parsing maps ahead: a process of low priority fills the cache, so that loading a map does not wait for CARLA's parser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError
from carla_recap.roads.find import find_maps
from carla_recap.sim.town.town import fill_cache
from carla_recap.util.cache import cache_folder
from carla_recap.util.processes import module_command, module_environment, terminate

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST: Final = 32
"""The number of maps that are parsed; those of CARLA are 26."""
_NICE: Final = 19  # the lowest priority
_PATIENCE: Final = 5.0  # s, for the end of the process


@contextmanager
def parsing_ahead(folder: Path | str | None = None) -> Iterator[None]:
    """Parse the maps of a folder that are not in the cache, one after the other, until the end of a `with` block.

    Maps that cannot be parsed are left to the calls that load them.

    Args:
        folder: The folder of maps; else the environment variable CARLA_RECAP_MAPS says it.
    """
    paths = [str(path) for path in sorted(find_maps(folder).values())[:_MOST]]
    if len(paths) < 2 or cache_folder() is None:  # the built-in town has been loaded
        yield
        return
    none = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            module_command(__name__, *paths), stdin=none, stdout=none, stderr=none, env=module_environment()
        )
    except OSError:
        yield
        return
    Thread(target=process.wait, name="carla-recap-ahead", daemon=True).start()  # else it is a zombie when it has ended
    try:
        yield
    finally:
        terminate(process, _PATIENCE)


def main() -> None:
    """Run the process, with the paths of the maps as arguments."""
    parent = os.getppid()
    signal.signal(signal.SIGTERM, _end)
    if hasattr(os, "nice"):
        os.nice(_NICE)
    for path in sys.argv[1:]:
        if os.getppid() != parent:
            return
        with suppress(RecapError):
            fill_cache(Path(path))


def _end(*_: Any) -> None:
    sys.exit()


if __name__ == "__main__":
    main()
