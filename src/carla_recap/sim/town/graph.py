"""Graphs of lanes and of walkways: what is connected, and shortest paths.

networkx finds the same paths in two to three times the time.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.util.arrays import Floats, Integers


def reached(neighbours: Sequence[Sequence[int]], start: int, seen: set[int]) -> list[int]:
    """Return the nodes that can be reached from a node, itself first, and add them to those that were seen before."""
    seen.add(start)
    nodes = [start]
    for node in nodes:  # grows
        new = [other for other in neighbours[node] if other not in seen]
        seen.update(new)
        nodes += new
    return nodes


def components(neighbours: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the connected components of a graph in which each edge leads both ways."""
    seen: set[int] = set()
    return [reached(neighbours, node, seen) for node in range(len(neighbours)) if node not in seen]


def largest_strong_component(successors: Sequence[Sequence[int]], predecessors: Sequence[Sequence[int]]) -> list[int]:
    """Return the largest set of nodes of which each leads to all others (Kosaraju), in ascending order."""
    seen: set[int] = set()
    order = reversed(_postorder(successors))
    found: list[list[int]] = [reached(predecessors, node, seen) for node in order if node not in seen]
    largest: list[int] = max(found, key=len)
    return sorted(largest)


def _postorder(successors: Sequence[Sequence[int]]) -> list[int]:
    order, seen = [], set()
    for start in range(len(successors)):
        stack = [(start, iter(successors[start]))] if start not in seen else []
        seen.add(start)
        while stack:
            node, rest = stack[-1]
            unseen = next((other for other in rest if other not in seen), None)
            if unseen is None:
                order.append(node)
                stack.pop()
            else:
                seen.add(unseen)
                stack.append((unseen, iter(successors[unseen])))
    return order


class Paths:
    """Finds shortest paths along a graph of nodes, (n, 3) in m, and pairs of them that are connected, (k, 2)."""

    def __init__(self, nodes: Floats, edges: Integers) -> None:
        self._nodes = nodes
        self._together: dict[int, list[int]] = {}
        self._next: list[list[tuple[int, float]]] = [[] for _ in nodes]
        lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
        for (a, b), length in zip(edges.tolist(), lengths.tolist(), strict=True):
            self._next[a].append((b, length))
            self._next[b].append((a, length))

    def nearest(self, x: float, y: float) -> int:
        """Return the node nearest to a location."""
        return int(((self._nodes[:, :2] - (x, y)) ** 2).sum(axis=1).argmin())

    def reachable(self, node: int) -> list[int]:
        """Return the nodes that can be reached from a node, itself included, in ascending order."""
        if node not in self._together:
            together = sorted(reached([[other for other, _ in edges] for edges in self._next], node, set()))
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
