"""The road map, in the world and from above; it never changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export.rerun import tree
from carla_recap.export.rerun.stream import screen

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream
    from carla_recap.maps import RoadMap

_LINES: Final = (  # what, its colour, half its width in m
    ("junctions", (70, 76, 92), 0.05),
    ("centre_lines", (66, 70, 82), 0.04),
    ("lane_borders", (150, 156, 170), 0.06),
    ("crossings", (196, 190, 150), 0.08),
    ("stop_lines", (230, 232, 238), 0.12),
)
_MAP_LINE: Final = (96, 102, 116)


def draw(stream: Stream, roads: RoadMap) -> None:
    """Write a map."""
    for name, color, radius in _LINES:
        lines: Sequence[NDArray[np.floating]] = getattr(roads, name)
        if lines:
            stream.always(f"{tree.ROADS}/{name}", rr.LineStrips3D(lines, colors=[color], radii=[radius]))
    if roads.lane_borders:
        flat = [line[:, :2] * np.array((1, -1)) for line in roads.lane_borders]
        stream.always(tree.MAP_ROADS, rr.LineStrips2D(flat, colors=[_MAP_LINE], radii=screen(0.6)))
