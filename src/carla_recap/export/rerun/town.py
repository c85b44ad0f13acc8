"""The town: its surfaces in the world, and its roads from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.rerun import paths
from carla_recap.export.rerun.stream import screen_radii

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream
    from carla_recap.maps import RoadMap

_MARGIN: Final = 100.0  # m; the distance from the roads at which an actor is still in the town
_MAP_LINE: Final = (96, 102, 116)
_MAX_CHANGES: Final = 8192  # the number of changes of states that are held back


def is_elsewhere(roads: RoadMap, locations: NDArray[np.float64]) -> bool:
    """Return whether a map is of another town: all of some locations, (n, 3) in m, right-handed, are far from it."""
    lines = [line[:, :2] for name, _, _ in style.ROADS for line in getattr(roads, name) if len(line)]
    if not lines or not len(locations):
        return False
    points = np.concatenate(lines)
    low, high = np.nanmin(points, axis=0) - _MARGIN, np.nanmax(points, axis=0) + _MARGIN
    return not ((locations[:, :2] >= low) & (locations[:, :2] <= high)).all(axis=1).any()


def write_roads(stream: Stream, roads: RoadMap) -> None:
    """Write a road map, in the world and from above."""
    for name, color, width in style.ROADS:
        lines: Sequence[NDArray[np.floating]] = getattr(roads, name)
        if lines:
            stream.log_static(f"{paths.ROADS}/{name}", rr.LineStrips3D(lines, colors=[color], radii=[width / 2]))
    if roads.lane_borders:
        flat = [line[:, :2] * np.array((1, -1)) for line in roads.lane_borders]
        stream.log_static(paths.MAP_ROADS, rr.LineStrips2D(flat, colors=[_MAP_LINE], radii=screen_radii(0.6)))
