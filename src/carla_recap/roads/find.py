"""The OpenDRIVE files of maps, by the names that recordings have."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from carla_recap.util.log import log_info

FOLDER: Final = "CARLA_RECAP_MAPS"
"""The environment variable that names the folder of maps."""

_LAYERED: Final = "_Opt"
"""The end of the name of a map whose parts can be hidden layer by layer."""
_CARLA_TOWN: Final = re.compile(r"Town(0[1-7]|10HD)")  # the towns of CARLA 0.9.16 that have such a map
_BUILT_IN: Final = Path(__file__).parents[1] / "sim" / "towns"


def find_map(map_name: str, folder: Path | str | None = None) -> Path | None:
    """Return the OpenDRIVE file of a map, or None.

    Args:
        map_name: The name in a recording: `Town01`, `Carla/Maps/Town01`; the file of `Town01_Opt` may be `Town01.xodr`.
        folder: The folder of maps; by default, that of the environment variable CARLA_RECAP_MAPS. The town of this
            package is found in any case.
    """
    maps = find_maps(folder)
    name, by_key = plain_name(map_name), {map_key(name): path for name, path in sorted(maps.items(), reverse=True)}
    found = maps.get(name) or maps.get(name.removesuffix(_LAYERED)) or by_key.get(map_key(name))
    if found is None:
        log_info(__name__, "the map %r is not in %s", map_name, described_folder(folder))
    else:
        log_info(__name__, "the map %r is %s", map_name, found)
    return found


def plain_name(map_name: str) -> str:
    """Return the name of a map without its folder."""
    return re.split(r"[/\\]", map_name)[-1]


def map_key(map_name: str) -> str:
    """Return the name by which maps are compared: the layered variant of a map is the same map."""
    return plain_name(map_name).lower().removesuffix(_LAYERED.lower())


def described_folder(folder: Path | str | None = None) -> str:
    """Return the folder of maps for messages, with what is wrong with it; see `find_map`."""
    path = folder or os.environ.get(FOLDER)
    if not path:
        return f"the folder that {FOLDER} names, which is not set"
    named = f"the folder {path}" if folder else f"the folder that {FOLDER} names, {path}"
    return named if Path(path).is_dir() else f"{named}, which is missing"


def loadable_maps(folder: Path | str | None = None) -> dict[str, Path]:
    """Return the OpenDRIVE files of all maps by name; CARLA's towns have a second map each, such as `Town01_Opt`."""
    maps = find_maps(folder)
    layered = {f"{name}{_LAYERED}": path for name, path in maps.items() if _CARLA_TOWN.fullmatch(name)}
    return dict(sorted((layered | maps).items()))


def find_maps(folder: Path | str | None = None) -> dict[str, Path]:
    """Return the OpenDRIVE files of all maps by name; see `find_map`."""
    folder = folder or os.environ.get(FOLDER)
    folders = (_BUILT_IN, *([Path(folder)] if folder else []))
    return {path.stem: path for folder in folders for path in folder.glob("*.xodr") if path.is_file()}
