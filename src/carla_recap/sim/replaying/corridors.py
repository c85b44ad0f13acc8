"""A town for a recording whose map is unavailable: the corridors that its vehicles have driven."""

from __future__ import annotations

import tempfile
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Final

from carla_recap.formats import open_reader
from carla_recap.recording import Recording
from carla_recap.replay.recorded_map import opendrive_of_corridors
from carla_recap.roads.find import find_map, plain_name
from carla_recap.sim.town.town import load_town

if TYPE_CHECKING:
    from carla_recap.sim.town.town import Town

    _Key = tuple[str, int, int]

_UNNAMED: Final = "Corridors"  # where the recording names no map
_latest: dict[_Key, Town] = {}
_lock: Final = Lock()


def is_unknown(map_name: str, maps: Path | None) -> bool:
    """Return whether there is no file of a map.

    Args:
        map_name: The name in a recording.
        maps: The folder of maps.
    """
    return not plain_name(map_name) or find_map(plain_name(map_name), maps) is None


def load_corridors(path: Path, map_name: str) -> Town:
    """Return a town of the corridors that the vehicles of a recording have driven; the latest one is kept in memory.

    Args:
        path: The recording.
        map_name: The name of its map, which the town gets.

    Raises:
        RecapError: The recording cannot be read.
    """
    status = path.stat()
    key = (str(path.absolute()), status.st_mtime_ns, status.st_size)
    with _lock:
        town = _latest.get(key)
    if town is None:
        with Recording(open_reader(path)) as recording, tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "corridors.xodr"
            file.write_text(opendrive_of_corridors(recording))
            town = load_town(file).renamed(plain_name(map_name) or _UNNAMED)
        with _lock:
            _latest.clear()
            _latest[key] = town
    return town
