"""The ground without a map: what vehicles have driven along, as roads.

`maps.corridors` makes better roads, but has to read a recording beforehand. Here, roads are gathered on the way: for a
running simulation, for recordings of more than half an hour, and for calls of `export_rerun` without a map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.scene import style
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.scene.mesh import Mesh
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import unlit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.show.rerun.poses import PoseBlock
    from carla_recap.show.rerun.stream import Stream

    Floats = NDArray[np.float64]

_STEP: Final = 0.3  # s between points of a path
_SHORTEST: Final = 0.5  # m between points that are apart
_LONGEST: Final = 20.0  # m between points; a longer step is a jump
_CELL: Final = 2.0  # m of a square in which one piece is enough
_MOST: Final = 20_000  # pieces
_WIDTH: Final = 3.8  # m
_OVERLAP: Final = 1.0  # m of a piece beyond its ends, so that bends have no gaps
_BELOW: Final = 0.03  # m below the vehicles' origins


class CorridorWriter:
    """Gathers what vehicles drive along, and writes it at the end.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._pieces: list[Floats] = []  # (pieces, 2, 3): their ends in m, right-handed
        self._known = np.zeros(0, np.int64)

    def add(self, block: PoseBlock, vehicles: NDArray[np.bool_]) -> None:
        """Add a block of poses.

        Args:
            block: The block.
            vehicles: Which of its actors are vehicles.
        """
        if not vehicles.any() or len(self._known) >= _MOST:
            return
        seconds = block.times.seconds
        rows = np.flatnonzero(np.diff(np.floor(seconds / _STEP + 1e-6), prepend=-1.0))
        if len(rows) < 2:
            return
        at = np.ix_(rows, np.flatnonzero(vehicles))
        locations = right_handed(block.poses[at])[..., LOCATION]
        ends = np.stack((locations[:-1], locations[1:]), axis=2)
        lengths = np.linalg.norm(ends[:, :, 1, :2] - ends[:, :, 0, :2], axis=2)
        present = block.present[at]
        ends = ends[present[1:] & present[:-1] & (lengths > _SHORTEST) & (lengths < _LONGEST)]
        ends = ends[np.abs(ends).max(axis=(1, 2)) < 1e6]
        cells = np.floor(ends[..., :2].mean(axis=1) / _CELL).astype(np.int64)
        keys, firsts = np.unique(cells[:, 0] << 32 ^ cells[:, 1] & 0xFFFF_FFFF, return_index=True)
        fresh = ~np.isin(keys, self._known)
        self._known = np.concatenate((self._known, keys[fresh]))
        self._pieces.append(ends[firsts[fresh]])

    def close(self) -> None:
        """Write the roads, in the world and on the map."""
        pieces = np.concatenate([np.zeros((0, 2, 3)), *self._pieces])[:_MOST]
        if not len(pieces):
            return
        way = pieces[:, 1] - pieces[:, 0]
        way /= np.linalg.norm(way[:, :2], axis=1, keepdims=True)
        across = np.stack((-way[:, 1], way[:, 0], np.zeros(len(way))), axis=1) * _WIDTH / 2
        start, end = pieces[:, 0] - _OVERLAP * way, pieces[:, 1] + _OVERLAP * way
        corners = np.stack((start - across, end - across, end + across, start + across), axis=1).reshape(-1, 3)
        corners[:, 2] -= _BELOW
        triangles = (np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(len(pieces))[:, None, None]).reshape(-1, 3)
        up = np.broadcast_to(np.array((0, 0, 1), np.float32), corners.shape)
        materials = np.full(len(corners), Material.ROAD, np.uint8)
        mesh = Mesh(corners.astype(np.float32), up, materials, triangles.astype(np.uint32))
        colors = np.broadcast_to(np.array(MATERIALS[Material.ROAD].color, np.uint8), corners.shape)
        self._stream.log_static(f"{paths.ROADS}/corridors", unlit(mesh, colors))
        flat = (np.stack((start, end), axis=1)[..., :2] * (1, -1)).astype(np.float32)
        lines = rr.LineStrips2D(flat, colors=[style.MAP_ROAD], radii=[_WIDTH / 2], draw_order=0.0)
        self._stream.log_static(paths.MAP_ROADS, lines)
