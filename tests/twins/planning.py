"""The twin of the route planner: lanes of a row of straight roads, searched metre by metre."""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple


class PlainRoad(NamedTuple):
    """A straight road with lanes in one direction.

    Attributes:
        length: The length in m.
        lanes: The markings to the right of each lane, from the left: where each begins, and the changes that it allows.
    """

    length: float
    lanes: list[list[tuple[float, str]]]


def allowed(marks: list[tuple[float, str]], station: float) -> str:
    """Return the changes that the marking to the right of a lane allows at a station."""
    word = "none"
    for start, changes in marks:
        if start <= station:
            word = changes
    return word


def changes(road: PlainRoad, number: int) -> list[int]:
    """Return the lanes to which one changes at any of its metres but those at its ends."""
    found = []
    metre = 1
    while metre < road.length - 1:
        if number + 1 < len(road.lanes) and allowed(road.lanes[number], metre) in ("both", "increase"):
            found.append(number + 1)
        if number and allowed(road.lanes[number - 1], metre) in ("both", "decrease"):
            found.append(number - 1)
        metre += 1
    return sorted(set(found))


def shortest(roads: list[PlainRoad], start: tuple[int, int], stop: tuple[int, int]) -> float | None:
    """Return the length of the shortest way from the start of a lane to that of another one; None if there is none.

    As CARLA's planner does, it changes to the start of the lane beside, which takes no way.

    Args:
        roads: The roads, one after the other.
        start: A road and a lane.
        stop: Another one.
    """
    queue: list[tuple[float, tuple[int, int]]] = [(0.0, start)]
    done = set()
    while queue:
        length, at = heappop(queue)
        if at == stop:
            return length
        if at in done:
            continue
        done.add(at)
        road, lane = at
        for other in changes(roads[road], lane):
            heappush(queue, (length, (road, other)))
        if road + 1 < len(roads) and lane < len(roads[road + 1].lanes):
            heappush(queue, (length + roads[road].length, (road + 1, lane)))
    return None
