"""Where pedestrians walk, as a graph that is made fit for strips along its edges."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations
from math import cos, dist, hypot, pi
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from carla_recap.sim.town.town import WalkwayGraph

    Place = list[float]

SIDEWALK, CROSSWALK, ROAD = 1, 2, 3
"""Areas, as carla/nav/Navigation.h of LibCarla 0.9.16 numbers them; the smaller, the more it is for walkers."""
_STRAIGHT: Final = 0.05  # m: nodes as near as that to a straight line are left out
_APART: Final = 2.3  # m: nodes that are nearer to each other are one, so that strips are as wide as they should be
_SHARP: Final = cos(pi / 3.5)  # the cosine of the least angle between ways that part; of at most 60 degrees
_MOST_LEFT_OUT: Final = 40  # nodes of a straight way: it stays shorter than about 200 m
_TINY: Final = 1e-12  # m²


class Ways:
    """A graph of places that grows and shrinks.

    Attributes:
        places: Of the nodes.
        areas: For each node, the nodes beside it, and what the way to each is.
    """

    def __init__(self, walks: WalkwayGraph) -> None:
        self.places: list[Place] = walks.nodes.tolist()
        self.areas: dict[int, dict[int, int]] = defaultdict(dict)
        for (one, other), crossing in zip(walks.edges.tolist(), walks.crossing.tolist(), strict=True):
            self.link(one, other, CROSSWALK if crossing else SIDEWALK)

    def link(self, one: int, other: int, area: int) -> None:
        """A way between two nodes."""
        self.areas[one][other] = self.areas[other][one] = area

    def loosen(self) -> None:
        """Join nodes that are close together, and let ways that part at a sharp angle do so at a later node.

        Walkers keep off walls: they would not get through a narrow passage, nor past the tip between two such ways. Each
        change leaves fewer nodes, or shorter ways, so it ends.
        """
        left = sorted(self.areas)
        for node in left:  # grows
            if node not in self.areas:
                continue
            beside = sorted(self.areas[node], key=lambda other: (self.length(node, other), other))
            if beside and self.length(node, beside[0]) < _APART:
                self._merge(beside[0], node)
                left += [node, *beside[1:]]
            elif fork := self._fork(node, beside):
                left += [node, *fork]

    def _merge(self, node: int, into: int) -> None:
        for other, area in self.areas.pop(node).items():
            del self.areas[other][node]
            if other != into:
                self.link(into, other, min(area, self.areas[into].get(other, area)))

    def _fork(self, node: int, beside: list[int]) -> list[int]:
        """Let one of two ways in about the same direction begin where the nearer of them, a sidewalk, ends."""
        for near, far in combinations(beside, 2):
            if self.areas[node][near] == SIDEWALK and self._is_sharp(node, near, far):
                area = self.areas[node].pop(far)
                del self.areas[far][node]
                self.areas[near].setdefault(far, area)
                self.areas[far].setdefault(near, area)
                return [near, far]
        return []

    def length(self, one: int, other: int) -> float:
        """How far two nodes are apart, seen from above."""
        return dist(self.places[one][:2], self.places[other][:2])

    def _is_sharp(self, node: int, one: int, other: int) -> bool:
        x, y, _ = self.places[node]
        (ax, ay, _), (bx, by, _) = self.places[one], self.places[other]
        along = (ax - x) * (bx - x) + (ay - y) * (by - y)
        return along > _SHARP * self.length(node, one) * self.length(node, other)

    def straighten(self) -> None:
        """Leave out nodes in the middle of straight ways, so that there are few and long ones.

        The client finds ways over at most 256 polygons.
        """
        passed: dict[frozenset[int], list[int]] = defaultdict(list)
        for node in sorted(self.areas):
            beside = self.areas[node]
            if len(beside) != 2 or len(set(beside.values())) != 1:
                continue
            one, other = beside
            left_out = [*passed[frozenset((one, node))], node, *passed[frozenset((node, other))]]
            if other in self.areas[one] or len(left_out) > _MOST_LEFT_OUT:
                continue
            if all(self._is_between(one, other, middle) for middle in left_out):
                self.link(one, other, beside[one])
                passed[frozenset((one, other))] = left_out
                del self.areas[node], self.areas[one][node], self.areas[other][node]

    def _is_between(self, start: int, end: int, middle: int) -> bool:
        """Whether a node is on the straight line between two others, its height included."""
        (ax, ay, az), (bx, by, bz), (x, y, z) = self.places[start], self.places[end], self.places[middle]
        bx, by, bz, x, y, z = bx - ax, by - ay, bz - az, x - ax, y - ay, z - az
        share = (x * bx + y * by + z * bz) / max(bx * bx + by * by + bz * bz, _TINY)
        return 0 < share < 1 and hypot(x - share * bx, y - share * by, z - share * bz) < _STRAIGHT
