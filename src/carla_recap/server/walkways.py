"""Where pedestrians walk: a graph with paths across roads, and strips along its edges as convex polygons."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from math import atan2, cos, dist, hypot, pi, sin, tau
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.town.sidewalks import WalkwayGraph
    from carla_recap.util.arrays import Floats

    Point = list[float]

SIDEWALK, CROSSWALK, ROAD = 1, 2, 3
"""Areas as carla/nav/Navigation.h of LibCarla 0.9.16 numbers them, in the order of preference."""
_STRAIGHT: Final = 0.05  # m: nodes nearer to a straight line are removed
_APART: Final = 2.3  # m: nodes nearer to each other are merged, so that strips have their full width
_SHARP: Final = cos(pi / 3.5)  # the cosine of the least angle between two paths of a fork
_MOST_REMOVED: Final = 40  # nodes of a straight path: it stays shorter than about 200 m
_TINY: Final = 1e-12  # m²

_SPACING: Final = 20.0  # m: between paths across roads, at least
_FACING: Final = 3.0  # m: the offset of points on both sides of a road, at most; their spacing is 5 m
_NARROWEST, _WIDEST = 5.0, 40.0  # m: between the sidewalks of a road
_LEVEL: Final = 1.5  # m: the difference in height, at most; else one is on a bridge
_LANES: Final = 0.3  # the share of lanes in a road, at least; the rest is verges, medians and half of both sidewalks
_SAMPLES: Final = 21  # along a line across a road
CORNERS: Final = 6
"""The most corners that a polygon may have."""
_HALF_WIDTH: Final = 1.0  # m: of a strip; the sidewalks of CARLA's towns are 4 m and 6 m wide
_SHARE: Final = 0.45  # of an edge that each of the junctions at its ends may take: below a half, so that they are apart
_LEAST: Final = 0.05  # m: half the width of a passage where an edge is short or a bend is sharp


class WalkwayEditor:
    """An editable copy of a walkway graph: `areas` has for each node its neighbours, and the area of the path to each."""

    def __init__(self, walks: WalkwayGraph) -> None:
        self.points: list[Point] = walks.nodes.tolist()
        self.areas: dict[int, dict[int, int]] = defaultdict(dict)
        for (one, other), crossing in zip(walks.edges.tolist(), walks.crossing.tolist(), strict=True):
            self.link(one, other, CROSSWALK if crossing else SIDEWALK)

    def link(self, one: int, other: int, area: int) -> None:
        """Add a path between two nodes."""
        self.areas[one][other] = self.areas[other][one] = area

    def loosen(self) -> None:
        """Merge nodes that are close together, and move sharp forks to a later node.

        Walkers keep a distance from walls: they would not get through a narrow passage, nor past the tip of a sharp fork.
        Each change leaves fewer nodes or shorter paths, so this ends.
        """
        queue = sorted(self.areas)
        for node in queue:  # grows
            if node not in self.areas:
                continue
            beside = sorted(self.areas[node], key=lambda other: (self.length(node, other), other))
            if beside and self.length(node, beside[0]) < _APART:
                self._merge(beside[0], node)
                queue += [node, *beside[1:]]
            elif fork := self._fork(node, beside):
                queue += [node, *fork]

    def _merge(self, node: int, into: int) -> None:
        for other, area in self.areas.pop(node).items():
            del self.areas[other][node]
            if other != into:
                self.link(into, other, min(area, self.areas[into].get(other, area)))

    def _fork(self, node: int, beside: list[int]) -> list[int]:
        """Let one of two paths in about the same direction begin where the nearer of them, a sidewalk, ends."""
        for near, far in combinations(beside, 2):
            if self.areas[node][near] == SIDEWALK and self._is_sharp(node, near, far):
                area = self.areas[node].pop(far)
                del self.areas[far][node]
                self.areas[near].setdefault(far, area)
                self.areas[far].setdefault(near, area)
                return [near, far]
        return []

    def length(self, one: int, other: int) -> float:
        """Return the horizontal distance of two nodes, in m."""
        return dist(self.points[one][:2], self.points[other][:2])

    def _is_sharp(self, node: int, one: int, other: int) -> bool:
        x, y, _ = self.points[node]
        (ax, ay, _), (bx, by, _) = self.points[one], self.points[other]
        along = (ax - x) * (bx - x) + (ay - y) * (by - y)
        return along > _SHARP * self.length(node, one) * self.length(node, other)

    def straighten(self) -> None:
        """Remove nodes in the middle of straight paths: the client finds paths over at most 256 polygons."""
        passed: dict[frozenset[int], list[int]] = defaultdict(list)
        for node in sorted(self.areas):
            beside = self.areas[node]
            if len(beside) != 2 or len(set(beside.values())) != 1:
                continue
            one, other = beside
            removed = [*passed[frozenset((one, node))], node, *passed[frozenset((node, other))]]
            if other in self.areas[one] or len(removed) > _MOST_REMOVED:
                continue
            if all(self._is_between(one, other, middle) for middle in removed):
                self.link(one, other, beside[one])
                passed[frozenset((one, other))] = removed
                del self.areas[node], self.areas[one][node], self.areas[other][node]

    def _is_between(self, start: int, end: int, middle: int) -> bool:
        """Return whether a node is on the straight line between two others, height included."""
        (ax, ay, az), (bx, by, bz), (x, y, z) = self.points[start], self.points[end], self.points[middle]
        bx, by, bz, x, y, z = bx - ax, by - ay, bz - az, x - ax, y - ay, z - az
        share = (x * bx + y * by + z * bz) / max(bx * bx + by * by + bz * bz, _TINY)
        return 0 < share < 1 and hypot(x - share * bx, y - share * by, z - share * bz) < _STRAIGHT


def cross_roads(walkways: WalkwayEditor, town: Town) -> None:
    """Add paths across roads beside the crossings; `World.set_pedestrians_cross_factor` says how many walkers take them."""
    nodes = [node for node in sorted(walkways.areas) if list(walkways.areas[node].values()) == [SIDEWALK, SIDEWALK]]
    nodes.sort(key=lambda node: walkways.points[node][0])
    points = np.array([walkways.points[node] for node in nodes]).reshape(-1, 3)
    starts = np.searchsorted(points[:, 0], points[:, 0] - _WIDEST)
    ends = np.searchsorted(points[:, 0], points[:, 0] + _WIDEST)
    free = np.ones(len(nodes), np.bool_)
    for number, node in enumerate(nodes):
        if not free[number]:
            continue
        near = slice(starts[number], ends[number])
        one, other = (np.array(walkways.points[neighbour]) for neighbour in walkways.areas[node])
        across = _across(points[near] - points[number], other - one)
        if across is None or not free[near][across]:
            continue
        opposite = near.start + across
        if _is_road(town, points[number], points[opposite]):
            walkways.link(node, nodes[opposite], ROAD)
            for end in (number, opposite):
                around = slice(starts[end], ends[end])
                free[around] &= np.linalg.norm(points[around] - points[end], axis=1) >= _SPACING


def _across(away: Floats, along: Floats) -> int | None:
    """Return the nearest of some points that is perpendicular to a sidewalk and on its level."""
    distance = np.hypot(away[:, 0], away[:, 1])
    beside = np.abs(away[:, :2] @ along[:2]) / max(float(np.hypot(*along[:2])), _FACING)
    level = np.abs(away[:, 2]) < _LEVEL
    facing = np.flatnonzero(level & (beside < _FACING) & (distance > _NARROWEST) & (distance < _WIDEST))
    return int(facing[distance[facing].argmin()]) if len(facing) else None


def _is_road(town: Town, start: Floats, end: Floats) -> bool:
    """Return whether enough of the line between two points is on lanes for cars."""
    x, y, z = (start + np.linspace(0, 1, _SAMPLES)[:, None] * (end - start)).T
    return float(town.on_road(x, y, z).mean()) >= _LANES


@dataclass(frozen=True, eq=False)
class WalkableSurface:
    """Convex polygons.

    Attributes:
        corners: Points in CARLA's axes, in m, (n, 3).
        polygons: The indices of their corners, anticlockwise seen from above: from y towards x.
        neighbours: For each side of a polygon, from its corner to the next one, the index of the polygon beyond it, or
            None.
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
