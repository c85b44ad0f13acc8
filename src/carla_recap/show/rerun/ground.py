"""The ground without a town mesh: a plane with lines, which show the speed of the actor that it moves along with.

A town mesh has its own ground; see `corridors` for when there is none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import packed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.show.rerun.stream import Stream

    Floats = NDArray[np.float64]

_CELL: Final = 10.0  # m; the size of a square of the ground
_REACH: Final = 200.0  # m; the distance to which the ground extends
_GROUND_LINE: Final = (118, 113, 98)
_HORIZON: Final = 2900.0  # m; the radius of the ground, which ends within the sky
_CORNERS: Final = 64
_UNDER: Final = 0.1  # m of the ground below the followed actor
_BELOW_LINES: Final = 0.05  # m of the ground below its lines
_LINE: Final = 0.03  # m; the radius of the lines of the ground


def write_ground(stream: Stream) -> None:
    """Write the ground, around the origin of its axes."""
    stream.log_static(paths.GROUND, _grid(), _plane())


def ground_below(points: Floats) -> Floats:
    """Return where the ground is for an actor at points, (n, 3) in m: in steps, so that its lines stand still."""
    found = points.copy()
    found[:, :2] = np.rint(found[:, :2] / _CELL) * _CELL
    found[:, 2] -= _UNDER
    return found


def _grid() -> rr.LineStrips3D:
    """Return squares on the ground."""
    along = np.arange(-_REACH, _REACH + _CELL, _CELL)
    lines = [[(x, -_REACH, 0), (x, _REACH, 0)] for x in along] + [[(-_REACH, y, 0), (_REACH, y, 0)] for y in along]
    return rr.LineStrips3D(lines, colors=[_GROUND_LINE], radii=[_LINE])


def _plane() -> rr.Mesh3D:
    """Return the ground up to the horizon."""
    turns = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    rim = np.stack((np.cos(turns), np.sin(turns), np.zeros(_CORNERS)), axis=1) * _HORIZON
    rim[:, 2] = -_BELOW_LINES
    corner = np.arange(1, _CORNERS - 1)
    triangles = np.stack((np.zeros_like(corner), corner, corner + 1), axis=1)
    colors = np.broadcast_to(np.array(MATERIALS[Material.GROUND].color, np.uint8), rim.shape)
    return rr.Mesh3D(vertex_positions=rim.astype(np.float32), triangle_indices=triangles, vertex_colors=packed(colors))
