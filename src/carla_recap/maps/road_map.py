"""Road maps: where to find the one of a recording, and how to load it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import FormatError, MissingExtra, RecapError
from carla_recap.maps.packing import unpack

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FOLDER: Final = "CARLA_RECAP_MAPS"
"""The environment variable that names the folder of maps."""
_LARGEST: Final = 256 << 20  # bytes
_PATIENCE: Final = 60.0  # s


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
    try:
        import carla  # noqa: F401
    except ImportError:
        raise MissingExtra("a map", "carla") from None
    lines = unpack(_parse(path, _content(path)))
    if not lines["centre_lines"]:
        raise FormatError(path, None, "an OpenDRIVE map was expected, and no lane for cars is in it")
    return RoadMap(path.stem, **lines)


def find_map(map_name: str, folder: Path | str | None = None) -> Path | None:
    """The OpenDRIVE file of a map, if there is one.

    Args:
        map_name: As in a recording: `Town01`, `Carla/Maps/Town01`; of `Town01_Opt`, the file may be called `Town01.xodr`.
        folder: Where to look; else the environment variable CARLA_RECAP_MAPS says it.
    """
    folder = folder or os.environ.get(FOLDER)
    if not folder:
        return None
    files = {path.stem: path for path in Path(folder).glob("*.xodr") if path.is_file()}
    name = re.split(r"[/\\]", map_name)[-1]
    return files.get(name) or files.get(name.removesuffix("_Opt"))


def _content(path: Path) -> bytes:
    if path.exists() and not path.is_file():
        raise RecapError(f"{path}: is not a regular file")
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if len(content) > _LARGEST:
        raise RecapError(f"{path}: is larger than {_LARGEST >> 20} MB, which no map is")
    return content


def _parse(path: Path, content: bytes) -> bytes:
    """The lines of a map, packed, from another process: CARLA's parser ends or occupies its process on some files."""
    places = os.pathsep.join(place for place in sys.path if place)
    command = [sys.executable, "-P", "-m", "carla_recap.maps"]
    environment = {**os.environ, "PYTHONPATH": places, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command,
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=_PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FormatError(path, None, f"CARLA's parser has not read it within {_PATIENCE:g} s") from None
    if done.returncode:
        reason = " ".join(done.stdout.decode(errors="replace").split())[:200]
        answer = f"says: {reason}" if reason else "breaks down on it"
        raise FormatError(path, None, f"an OpenDRIVE map was expected; CARLA's parser {answer}")
    return done.stdout
