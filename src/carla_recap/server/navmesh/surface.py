"""Where one can walk, as convex polygons that share sides: strips along the edges of a walk graph, and their meetings."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, pi, sin, tau
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.server.navmesh.ways import Place, Ways

    Floats = NDArray[np.float64]

CORNERS: Final = 6
"""The most corners that a polygon may have."""
_HALF_WIDTH: Final = 1.0  # m: of a strip; the sidewalks of CARLA's towns are 4 m and 6 m wide
_SHARE: Final = 0.45  # of an edge that each of the meetings at its ends may take: below a half, so that they are apart
_LEAST: Final = 0.05  # m: half the width of a passage where an edge is short or a bend is sharp


@dataclass(frozen=True, eq=False)
class Surface:
    """Convex polygons.

    Attributes:
        corners: Places in CARLA's axes, in m, (n, 3).
        polygons: Numbers of their corners, anticlockwise seen from above: from y towards x.
        neighbours: For each side of a polygon, from its corner to the next one, the polygon beyond it, if there is one.
        areas: What each is, as `ways` numbers it.
    """

    corners: Floats
    polygons: list[tuple[int, ...]]
    neighbours: list[tuple[int | None, ...]]
    areas: list[int]


class _Meeting:
    """Where ways meet at a node: a polygon around it that has a side across each of them.

    Its corners are on a circle, in the middle between the directions of two neighbouring ways; so it is convex. Of two
    ways there are but two corners: the side that their strips share. A way that ends is closed as if it went straight on.

    Attributes:
        others: The nodes at the other ends of the ways, in the order of their directions.
        directions: In which the corners are: each between the node beside it and the next one.
        facing: How much the side across each way is turned towards it: the cosine of the angle between.
    """

    def __init__(self, ways: Ways, node: int) -> None:
        x, y, _ = ways.places[node]
        directions = {
            other: atan2(ways.places[other][1] - y, ways.places[other][0] - x) for other in sorted(ways.areas[node])
        }
        self.others = sorted(directions, key=directions.__getitem__)
        turns = [directions[other] for other in self.others]
        if len(turns) == 1:
            turns.append(turns[0] + pi)
        halves = [(after - before) / 2 for before, after in zip(turns, [*turns[1:], turns[0] + tau], strict=True)]
        self.directions = [turn + half for turn, half in zip(turns, halves, strict=True)]
        self.facing = {other: cos((halves[at] - halves[at - 1]) / 2) for at, other in enumerate(self.others)}

    def corners(self, place: Place, radius: float) -> list[Place]:
        """The corners on a circle around the node."""
        x, y, z = place
        return [[x + radius * cos(direction), y + radius * sin(direction), z] for direction in self.directions]


def walkable_surface(ways: Ways) -> Surface:
    """Strips along the ways, and their meetings: polygons that hang together just as the ways do."""
    meetings = {node: _Meeting(ways, node) for node in sorted(ways.areas) if ways.areas[node]}
    corners: list[Place] = []
    polygons: list[tuple[int, ...]] = []
    areas: list[int] = []
    sides: dict[tuple[int, int], tuple[int, int]] = {}
    for node, meeting in meetings.items():
        ring = range(len(corners), len(corners) + len(meeting.directions))
        corners += meeting.corners(ways.places[node], _radius(ways, meetings, node))
        sides |= {(node, other): (ring[at - 1], ring[at]) for at, other in enumerate(meeting.others)}
        pieces = _pieces(ring[::-1])
        polygons += pieces
        areas += [min(ways.areas[node].values())] * len(pieces)
    for (node, other), (before, after) in sides.items():
        if node < other:
            polygons.append((after, *sides[other, node], before))
            areas.append(ways.areas[node][other])
    return Surface(np.array(corners).reshape(-1, 3), polygons, _neighbours(polygons), areas)


def _radius(ways: Ways, meetings: dict[int, _Meeting], node: int) -> float:
    """Of the circle around a node: so small that the strips to all its neighbours are convex."""
    room = _HALF_WIDTH
    for other, facing in meetings[node].facing.items():
        room = min(room, _SHARE * ways.length(node, other) * min(facing, meetings[other].facing[node]))
    return max(room, _LEAST)


def _pieces(ring: Sequence[int]) -> list[tuple[int, ...]]:
    """A convex polygon as ones with few enough corners; nothing of two corners."""
    return [(ring[0], *ring[at : at + CORNERS - 1]) for at in range(1, len(ring) - 1, CORNERS - 2)]


def _neighbours(polygons: Sequence[tuple[int, ...]]) -> list[tuple[int | None, ...]]:
    # A side is shared by two polygons, which go along it in opposite directions.
    owners = {side: number for number, polygon in enumerate(polygons) for side in _sides(polygon)}
    return [tuple(owners.get((end, start)) for start, end in _sides(polygon)) for polygon in polygons]


def _sides(polygon: tuple[int, ...]) -> zip[tuple[int, int]]:
    return zip(polygon, (*polygon[1:], polygon[0]), strict=True)
