"""Walkable surfaces as convex polygons that share sides: strips along the edges of a walkway graph, and their junctions."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, pi, sin, tau
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.server.navmesh.walkways import Point, WalkwayEditor

    Floats = NDArray[np.float64]

CORNERS: Final = 6
"""The most corners that a polygon may have."""
_HALF_WIDTH: Final = 1.0  # m: of a strip; the sidewalks of CARLA's towns are 4 m and 6 m wide
_SHARE: Final = 0.45  # of an edge that each of the junctions at its ends may take: below a half, so that they are apart
_LEAST: Final = 0.05  # m: half the width of a passage where an edge is short or a bend is sharp


@dataclass(frozen=True, eq=False)
class WalkableSurface:
    """Convex polygons.

    Attributes:
        corners: Points in CARLA's axes, in m, (n, 3).
        polygons: The indices of their corners, anticlockwise seen from above: from y towards x.
        neighbours: For each side of a polygon, from its corner to the next one, the index of the polygon beyond it, or None.
        areas: The areas of the polygons; see `walkways`.
    """

    corners: Floats
    polygons: list[tuple[int, ...]]
    neighbours: list[tuple[int | None, ...]]
    areas: list[int]


class _Junction:
    """A junction of paths at a node: a polygon around it that has a side across each path.

    Its corners are on a circle, in the middle between the directions of two neighbouring paths; so it is convex. Two paths
    have only two corners: the side that their strips share. A dead end is closed as if the path went straight on.

    Attributes:
        others: The nodes at the other ends of the paths, in the order of their directions.
        directions: The directions of the corners: each is between the path to a node and the path to the next one.
        facing: The cosine of the angle between each path and the normal of the side across it.
    """

    def __init__(self, walkways: WalkwayEditor, node: int) -> None:
        x, y, _ = walkways.points[node]
        ends = {other: walkways.points[other] for other in sorted(walkways.areas[node])}
        directions = {other: atan2(end[1] - y, end[0] - x) for other, end in ends.items()}
        self.others = sorted(directions, key=directions.__getitem__)
        angles = [directions[other] for other in self.others]
        if len(angles) == 1:
            angles.append(angles[0] + pi)
        halves = [(after - before) / 2 for before, after in zip(angles, [*angles[1:], angles[0] + tau], strict=True)]
        self.directions = [angle + half for angle, half in zip(angles, halves, strict=True)]
        self.facing = {other: cos((halves[index] - halves[index - 1]) / 2) for index, other in enumerate(self.others)}

    def corners(self, point: Point, radius: float) -> list[Point]:
        """Return the corners on a circle around the node."""
        x, y, z = point
        return [[x + radius * cos(direction), y + radius * sin(direction), z] for direction in self.directions]


def walkable_surface(walkways: WalkwayEditor) -> WalkableSurface:
    """Return strips along the paths and their junctions: polygons that are connected just as the paths are."""
    junctions = {node: _Junction(walkways, node) for node in sorted(walkways.areas) if walkways.areas[node]}
    corners: list[Point] = []
    polygons: list[tuple[int, ...]] = []
    areas: list[int] = []
    sides: dict[tuple[int, int], tuple[int, int]] = {}
    for node, junction in junctions.items():
        ring = range(len(corners), len(corners) + len(junction.directions))
        corners += junction.corners(walkways.points[node], _radius(walkways, junctions, node))
        sides |= {(node, other): (ring[index - 1], ring[index]) for index, other in enumerate(junction.others)}
        pieces = _pieces(ring[::-1])
        polygons += pieces
        areas += [min(walkways.areas[node].values())] * len(pieces)
    for (node, other), (before, after) in sides.items():
        if node < other:
            polygons.append((after, *sides[other, node], before))
            areas.append(walkways.areas[node][other])
    return WalkableSurface(np.array(corners).reshape(-1, 3), polygons, _neighbours(polygons), areas)


def _radius(walkways: WalkwayEditor, junctions: dict[int, _Junction], node: int) -> float:
    """Return the radius of the circle around a node, so small that the strips to all its neighbours are convex."""
    room = _HALF_WIDTH
    for other, facing in junctions[node].facing.items():
        room = min(room, _SHARE * walkways.length(node, other) * min(facing, junctions[other].facing[node]))
    return max(room, _LEAST)


def _pieces(ring: Sequence[int]) -> list[tuple[int, ...]]:
    """Split a convex polygon into polygons with few enough corners; two corners give none."""
    return [(ring[0], *ring[start : start + CORNERS - 1]) for start in range(1, len(ring) - 1, CORNERS - 2)]


def _neighbours(polygons: Sequence[tuple[int, ...]]) -> list[tuple[int | None, ...]]:
    # A side is shared by two polygons, which go along it in opposite directions.
    owners = {side: number for number, polygon in enumerate(polygons) for side in _sides(polygon)}
    return [tuple(owners.get((end, start)) for start, end in _sides(polygon)) for polygon in polygons]


def _sides(polygon: tuple[int, ...]) -> zip[tuple[int, int]]:
    return zip(polygon, (*polygon[1:], polygon[0]), strict=True)
