"""The road map, in the world and from above; it never changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.rerun import tree
from carla_recap.export.rerun.stream import screen

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream
    from carla_recap.maps import RoadMap

_NEAR: Final = 100.0  # m
_MAP_LINE: Final = (96, 102, 116)


def lies_elsewhere(roads: RoadMap, places: NDArray[np.float64]) -> bool:
    """Whether a map is of another town: there are places, (n, 3) in m, right-handed, but all of them are far from it."""
    lines = [line[:, :2] for name, _, _ in style.ROADS for line in getattr(roads, name) if len(line)]
    if not lines or not len(places):
        return False
    points = np.concatenate(lines)
    low, high = np.nanmin(points, axis=0) - _NEAR, np.nanmax(points, axis=0) + _NEAR
    return not ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1).any()


def draw(stream: Stream, roads: RoadMap) -> None:
    """Write a map."""
    for name, color, width in style.ROADS:
        lines: Sequence[NDArray[np.floating]] = getattr(roads, name)
        if lines:
            stream.always(f"{tree.ROADS}/{name}", rr.LineStrips3D(lines, colors=[color], radii=[width / 2]))
    if roads.lane_borders:
        flat = [line[:, :2] * np.array((1, -1)) for line in roads.lane_borders]
        stream.always(tree.MAP_ROADS, rr.LineStrips2D(flat, colors=[_MAP_LINE], radii=screen(0.6)))
