"""Routes along lanes from place to place, as CARLA's global route planner finds them.

The graph has an edge for each lane and lane that follows it, and one of no length for each change to a lane beside. Its
nodes are the ends of lanes, rounded to metres. The way from node to node is found by A*, which visits equally good nodes in
the order of networkx, so that the way is CARLA's. Along an edge, there are points at equal distances.

Where lanes lie on each other, as where they part, CARLA takes the one that rounding makes nearest, this planner the one with
which the route is shortest.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count, pairwise
from math import dist
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.roads.curves import single
from carla_recap.roads.polylines import stations
from carla_recap.roads.waypoints import NONE, Waypoints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.roads.waypoints import LaneMap
    from carla_recap.util.arrays import Floats, Integers

    Node = tuple[float, float, float]
    Place = tuple[int, float]  # a lane and a station

_SAME_PLACE: Final = 0.05  # m: lanes that are no farther apart lie on each other
_DETOUR: Final = 5.0  # times the straight distance: from there on, a leg warns
_SHORT_LEG: Final = 100.0  # m: a leg that is shorter does not
_ON_CHANGE: Final = 5  # points by which a change of lane goes on along the other lane
_LONGEST: Final = 100_000  # points of a lane


@dataclass(slots=True)
class _Edge:
    """A lane up to one that follows it, or a change to the lane beside it."""

    points: list[Place]  # the places between its ends
    first: Place  # the place at which it begins
    last: Place  # the place at which it ends
    length: int  # the number of steps between its points and ends
    is_change: bool = False


class RoutePlanner:
    """Finds routes along the lanes of a town, whose points are `spacing` m apart."""

    def __init__(self, town: LaneMap, spacing: float = 1.0) -> None:
        self._town, self._spacing = town, spacing
        self._edges: dict[Node, dict[Node, _Edge]] = {}
        self._of_lane: dict[int, tuple[Node, Node]] = {}
        self._segments: list[tuple[Node, int, list[Place]]] = []
        lanes, every = _driving_lanes(town), np.arange(len(town.lanes))
        self._starts = town.at(every, town.starts).position  # a lane for parking can follow one for driving
        self._ends = dict(zip(lanes.tolist(), town.at(lanes, town.ends[lanes]).position, strict=True))
        for lane in lanes.tolist():
            self._add(lane)
        for node, lane, points in self._segments:
            self._add_changes(node, lane, points)

    def route(self, places: Floats, name: str = "the route") -> Waypoints:
        """Return the route that passes two or more places in their order, (n, 3), in m; warnings call it by its name.

        Raises:
            ValueError: A place is far from all lanes, or there is no way to the next one.
            RecapWarning: The way to the next place is many times as long as the straight line.
        """
        plans: dict[Place, tuple[int, list[list[Place]]]] = {start: (0, []) for start in self._candidates(places[0], 1)}
        for number, place in enumerate(places[1:], 2):
            following: dict[Place, tuple[int, list[list[Place]]]] = {}
            for stop in self._candidates(place, number):
                for start, (points, legs) in plans.items():
                    way = self._path(start[0], stop[0])
                    leg = [] if way is None else self._traced(way, start, stop, place)
                    if leg and (stop not in following or points + len(leg) < following[stop][0]):
                        following[stop] = points + len(leg), [*legs, leg]
            if not following:
                raise ValueError(f"no lanes lead from position {number - 1} to position {number}")
            plans = following
        _, legs = min(plans.values(), key=lambda plan: plan[0])
        for number, leg in enumerate(legs, 1):
            length, straight = stations(self._positions(leg))[-1], dist(*places[number - 1 : number + 1])
            if length > max(_DETOUR * straight, _SHORT_LEG):
                message = f"{length:,.0f} m from position {number} to position {number + 1}, which is {straight:,.0f} m away"
                warnings.warn(f"{name}: {message}", RecapWarning, stacklevel=2)
        lanes, at = (np.array(values) for values in zip(*(place for leg in legs for place in leg), strict=True))
        return self._town.at(lanes, at)

    def _candidates(self, place: Floats, number: int) -> list[Place]:
        """Return the places on lanes that are nearest to a place, first the one that `LaneMap.nearest` finds."""
        at = self._town.nearest(place[None])
        if at.lane[0] == NONE:
            raise ValueError(f"position {number} is far from all lanes for cars")
        nearest = int(at.lane[0]), float(at.station[0])
        around = self._town.around(place, float(np.linalg.norm(at.position[0] - place)) + _SAME_PLACE)
        return [nearest, *(each for each in around if each[0] != nearest[0])]

    def _add(self, lane: int) -> None:
        """Add the edges of a lane: one to each lane that follows it, or to its end."""
        town = self._town
        first = lane, float(town.starts[lane])
        following = [(other, float(town.starts[other])) for other in town.successors[lane]]
        for last, end in [(place, self._starts[place[0]]) for place in following] or [
            ((lane, float(town.ends[lane])), self._ends[lane])
        ]:
            points = self._points(first, end)
            if points is not None:
                nodes = _node(self._starts[lane]), _node(end)
                self._of_lane[lane] = nodes
                for node in nodes:
                    self._edges.setdefault(node, {})
                self._edges[nodes[0]][nodes[1]] = _Edge(points, first, last, len(points) + 1)
                self._segments.append((nodes[0], lane, points))

    def _points(self, first: Place, end: Floats) -> list[Place] | None:
        """Return the places from a lane's start to an end, at equal distances; None if the lane is too short to have any."""
        spacing, (lane, station) = self._spacing, first
        if _apart(self._starts[lane], end) <= spacing:
            following = self._town.ahead(lane, station, spacing)
            return None if following is None else [following]
        length = abs(float(self._town.ends[lane]) - station)
        sign = -1.0 if self._town.lanes[lane].reverse else 1.0
        along = station + sign * spacing * np.arange(1.0, int(length / spacing) + 1)
        places = [(lane, each) for each in along.tolist()]
        near = _apart(self._town.at(np.full(len(along), lane), along).position, end) <= spacing
        if near.any():
            return places[: int(np.argmax(near))]
        place = places[-1] if places else first
        for _ in range(_LONGEST):  # the lane is longer than its road, which measures the distances
            following = self._town.ahead(place[0], place[1], spacing)
            if following is None:
                break
            place = following
            if _apart(self._positions([place])[0], end) <= spacing:
                break
            places.append(place)
        return places

    def _add_changes(self, node: Node, lane: int, points: Sequence[Place]) -> None:
        """Add a change to each lane beside one, at the first point at which the markings allow it."""
        if self._town.in_junction[lane]:
            return
        sides = [False, True]  # to the left?
        for on, station in points:
            to_left, to_right = self._town.lanes[on].allowed(station).crossings
            for left in [side for side in sides if (to_left if side else to_right)]:
                other = self._town.beside(on, left=left)
                if other is not None and other in self._of_lane:
                    change = _Edge([], (on, station), (other, station), 0, is_change=True)
                    self._edges[node][self._of_lane[other][0]] = change
                    sides.remove(left)

    def _path(self, start: int, stop: int) -> list[Node] | None:
        """Return the nodes from a lane to another one; None if no lanes lead there."""
        if start not in self._of_lane or stop not in self._of_lane:
            return None
        (source, _), (target, end) = self._of_lane[start], self._of_lane[stop]
        numbers = count()
        queue: list[tuple[float, int, Node, float, Node | None]] = [(0.0, next(numbers), source, 0.0, None)]
        best: dict[Node, float] = {}
        before: dict[Node, Node | None] = {}
        while queue:
            _, _, node, cost, parent = heappop(queue)
            if node == target:
                way = [node]
                while parent is not None:
                    way.append(parent)
                    parent = before[parent]
                return [*reversed(way), end]
            if node in before and (before[node] is None or best[node] < cost):
                continue
            before[node] = parent
            for following, edge in self._edges[node].items():
                total = cost + edge.length
                if total < best.get(following, np.inf):
                    best[following] = total
                    heappush(queue, (total + dist(following, target), next(numbers), following, total, node))
        return None

    def _traced(self, way: Sequence[Node], start: Place, stop: Place, destination: Floats) -> list[Place]:
        """Return the places along a way between two places."""
        current = start
        found: list[Place] = []
        for number, (node, following) in enumerate(pairwise(way)):
            edge, is_last = self._edges[node][following], number >= len(way) - 2
            if edge.is_change:
                found.append(current)
                nodes = self._of_lane[edge.last[0]]
                beside = self._edges[nodes[0]][nodes[1]]
                if beside.points:
                    index = self._closest(current, beside.points) + _ON_CHANGE
                    current = beside.points[min(index, len(beside.points) - 1)]
                else:
                    current = beside.last
                found.append(current)
                continue
            path = [edge.first, *edge.points, edge.last]
            first = self._closest(current, path)
            near = _apart(self._positions(path[first:]), destination) < 2 * self._spacing
            past = is_last and first > self._closest(stop, path)
            for place, is_near in zip(path[first:], near.tolist(), strict=True):
                current = place
                found.append(place)
                if is_last and (is_near or (past and place[0] == stop[0])):
                    break
        return found

    def _positions(self, places: Sequence[Place]) -> Floats:
        lanes, along = zip(*places, strict=True)
        return self._town.at(np.array(lanes), np.array(along)).position

    def _closest(self, place: Place, places: Sequence[Place]) -> int:
        """Return the index of the first of those places that are closest to one."""
        positions = self._positions([place, *places])
        return int(np.argmin(_apart(positions[1:], positions[0])))


def _driving_lanes(town: LaneMap) -> Integers:
    """Return the indices of the lanes for cars: road by road, section by section, with ascending ids."""
    roads = {road: number for number, road in enumerate(dict.fromkeys(lane.road for lane in town.lanes))}
    driving = [(roads[lane.road], lane.section, lane.id, index) for index, lane in enumerate(town.lanes) if lane.is_driving]
    return np.array([index for *_, index in sorted(driving)], np.int64)


def _apart(positions: Floats, place: Floats) -> Floats:
    """Return the distances of positions from a place, (n, 3) or (3,), in single precision as CARLA's."""
    away = single(positions) - single(place)
    apart: Floats = np.sqrt((away * away).sum(axis=-1))
    return apart


def _node(position: Floats) -> Node:
    x, y, z = (float(value) + 0.0 for value in np.round(position))
    return x, y, z
