"""Road maps: where to find the one of a recording, and how to load it."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import FormatError
from carla_recap.maps.child import ask
from carla_recap.maps.packing import unpack

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FOLDER: Final = "CARLA_RECAP_MAPS"
"""The environment variable that names the folder of maps."""

_LAYERED: Final = "_Opt"
"""The end of the name of a map whose parts can be hidden layer by layer."""
_CARLA_TOWN: Final = re.compile(r"Town(0[1-7]|10HD)")  # the towns of CARLA 0.9.16 that have such a map
_BUILT_IN: Final = Path(__file__).parents[1] / "sim" / "towns"


@dataclass(frozen=True, eq=False)
class RoadMap:
    """The roads of a town as lines: arrays (n, 3), in m, right-handed: x forward, y left, z up.

    Attributes:
        name: The name of the file, without its suffix.
        lane_borders: The borders of lanes, shoulders and pavements, each once; within junctions, the outer ones alone.
        centre_lines: The middle of the lanes for cars, in the direction in which one drives.
        junctions: The outlines of junctions, as closed lines.
        crossings: Pedestrian crossings, as closed lines.
        stop_lines: Lines across the lanes where one has to stop, at lights and stop signs.
    """

    name: str
    lane_borders: list[Floats]
    centre_lines: list[Floats]
    junctions: list[Floats]
    crossings: list[Floats]
    stop_lines: list[Floats]


def load_map(path: Path | str) -> RoadMap:
    """The roads of an OpenDRIVE file.

    Args:
        path: The file, such as `Town01.xodr`.

    Raises:
        RecapError: It cannot be read, or is no OpenDRIVE map with lanes for cars.
        MissingExtra: CARLA's client library is not installed.
    """
    path = Path(path)
    _, answer = ask("carla_recap.maps", path)
    lines = unpack(answer)
    if not lines["centre_lines"]:
        raise FormatError(path, None, "an OpenDRIVE map was expected, and no lane for cars is in it")
    return RoadMap(path.stem, **lines)


def find_map(map_name: str, folder: Path | str | None = None) -> Path | None:
    """The OpenDRIVE file of a map, if there is one.

    Args:
        map_name: As in a recording: `Town01`, `Carla/Maps/Town01`; of `Town01_Opt`, the file may be called `Town01.xodr`.
        folder: Where to look; else the environment variable CARLA_RECAP_MAPS says it. The town that comes with this
            package is found anyway.
    """
    maps = find_maps(folder)
    name = plain_name(map_name)
    return maps.get(name) or maps.get(name.removesuffix(_LAYERED))


def plain_name(map_name: str) -> str:
    """Return the name of a map without its folder."""
    return re.split(r"[/\\]", map_name)[-1]


def described_folder(folder: Path | str | None = None) -> str:
    """The folder of maps, for messages, and what is wrong with it; see `find_map`."""
    path = folder or os.environ.get(FOLDER)
    if not path:
        return f"the folder that {FOLDER} names, which is not set"
    told = f"the folder {path}" if folder else f"the folder that {FOLDER} names, {path}"
    return told if Path(path).is_dir() else f"{told}, which is missing"


def loadable_maps(folder: Path | str | None = None) -> dict[str, Path]:
    """Return the OpenDRIVE files of all maps by name; CARLA's towns have a second map each, such as `Town01_Opt`."""
    maps = find_maps(folder)
    layered = {f"{name}{_LAYERED}": path for name, path in maps.items() if _CARLA_TOWN.fullmatch(name)}
    return dict(sorted((layered | maps).items()))


def find_maps(folder: Path | str | None = None) -> dict[str, Path]:
    """The OpenDRIVE files of all maps, by their names; see `find_map`."""
    folder = folder or os.environ.get(FOLDER)
    folders = (_BUILT_IN, *([Path(folder)] if folder else []))
    return {path.stem: path for folder in folders for path in folder.glob("*.xodr") if path.is_file()}
