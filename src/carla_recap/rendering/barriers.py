"""What stops cars off the road: fences behind sidewalks, and guard rails beside roads without one."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.building import UP
from carla_recap.rendering.surfaces import KERB_HEIGHT
from carla_recap.roads.barriers import barriers, left_handed
from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.building import MeshBuilder
    from carla_recap.roads.lanes import LaneGeometry

    Floats = NDArray[np.float64]

_BEAMS: Final = {Material.GUARD_RAIL: ((0.45, 0.75),), Material.FENCE: ((0.42, 0.47), (0.90, 0.96))}
"""The heights in m of the lower and the upper side of beams."""
_BETWEEN: Final = {Material.GUARD_RAIL: 4.0, Material.FENCE: 2.5}  # m, at least, between posts
_THICKNESS: Final = {Material.GUARD_RAIL: 0.06, Material.FENCE: 0.03}  # m, half of it
_ROOT: Final = 0.5  # m by which posts reach below the line


def add_barriers(builder: MeshBuilder, lanes: Sequence[LaneGeometry]) -> None:
    """Add the barriers that stop cars in the simulator."""
    for line, is_behind_sidewalk in barriers(lanes):
        points = left_handed(line)  # which turns it back
        material = Material.FENCE if is_behind_sidewalk else Material.GUARD_RAIL
        points[:, 2] += KERB_HEIGHT if is_behind_sidewalk else 0.0
        thickness = _THICKNESS[material]
        for low, high in _BEAMS[material]:
            _add_beams(builder, points, low, high, thickness, material)
        top = _BEAMS[material][-1][1]
        for start, stop in pairwise(points):
            along = stop - start
            length = float(np.linalg.norm(along))
            count = max(int(length / _BETWEEN[material]), 1)
            middles = start + np.arange(count + 1)[:, None] / count * along
            along *= thickness / max(length, 1e-6)
            across = np.array((-along[1], along[0], 0.0))
            for side in (along, across):
                _add_sides(builder, middles - side, middles + side, -_ROOT, top, thickness, material)


def _add_beams(builder: MeshBuilder, points: Floats, low: float, high: float, half: float, material: Material) -> None:
    """Add beams between successive points, from a height to another, without ends that are closed."""
    start, stop = points[:-1], points[1:]
    aside = half * _add_sides(builder, start, stop, low, high, half, material)
    top = np.stack((start - aside, stop - aside, stop + aside, start + aside), axis=1) + high * UP
    builder.add_quads(top, np.broadcast_to(UP, start.shape), material)


def _add_sides(
    builder: MeshBuilder, start: Floats, stop: Floats, low: float, high: float, half: float, material: Material
) -> Floats:
    """Add the left and the right side of beams, and return the directions to the left, (n, 3)."""
    along = stop - start
    left: Floats = np.stack((-along[:, 1], along[:, 0], np.zeros(len(along))), axis=1)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    below, above = low * UP, high * UP
    for first, last, normals in ((stop, start, left), (start, stop, -left)):
        corners = np.stack((first + below, last + below, last + above, first + above), axis=1)
        builder.add_quads(corners + half * normals[:, None], normals, material)
    return left
