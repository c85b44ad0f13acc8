"""Shortest paths along a graph of walkways.

networkx finds the same paths in two to three times the time.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.town.sidewalks import WalkwayGraph

    Floats = NDArray[np.float64]


class Paths:
    """Finds shortest paths along a graph.

    Args:
        graph: The graph of walkways.
    """

    def __init__(self, graph: WalkwayGraph) -> None:
        self._nodes = graph.nodes
        self._together: dict[int, list[int]] = {}
        self._next: list[list[tuple[int, float]]] = [[] for _ in graph.nodes]
        lengths = np.linalg.norm(graph.nodes[graph.edges[:, 0]] - graph.nodes[graph.edges[:, 1]], axis=1)
        for (a, b), length in zip(graph.edges.tolist(), lengths.tolist(), strict=True):
            self._next[a].append((b, length))
            self._next[b].append((a, length))

    def nearest(self, x: float, y: float) -> int:
        """Return the node nearest to a location."""
        return int(((self._nodes[:, :2] - (x, y)) ** 2).sum(axis=1).argmin())

    def reachable(self, node: int) -> list[int]:
        """Return the nodes that can be reached from a node, itself included, in ascending order."""
        if node not in self._together:
            found = {node: None}
            for other in (queue := [node]):
                new = [neighbour for neighbour, _ in self._next[other] if neighbour not in found]
                found.update(dict.fromkeys(new))
                queue += new
            together = sorted(found)
            self._together.update(dict.fromkeys(together, together))
        return self._together[node]

    def find(self, start: int, goal: int) -> list[int]:
        """Return the nodes of the shortest path from one node to another (A*), both included; empty if there is none."""
        remaining = np.linalg.norm(self._nodes - self._nodes[goal], axis=1)
        best, before = {start: 0.0}, {start: start}
        queue = [(float(remaining[start]), start)]
        done = set()
        while queue:
            _, node = heappop(queue)
            if node == goal:
                return self._back(before, goal)
            if node in done:
                continue
            done.add(node)
            for other, length in self._next[node]:
                distance = best[node] + length
                if distance < best.get(other, np.inf):
                    best[other], before[other] = distance, node
                    heappush(queue, (distance + float(remaining[other]), other))
        return []

    @staticmethod
    def _back(before: dict[int, int], goal: int) -> list[int]:
        path = [goal]
        while before[path[-1]] != path[-1]:
            path.append(before[path[-1]])
        return path[::-1]
