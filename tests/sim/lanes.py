"""Small towns out of straight lanes and arcs, for tests of vehicles that drive there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from carla_recap.sim.town.lanes import NO_LANE, Lane
from carla_recap.sim.town.loading import Town
from tests.sim.flat import flat_town

LIMIT = 12.0  # m/s


def lane(
    index: int,
    *pieces: tuple[float, float],
    start: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    successors: tuple[int, ...] = (),
    junction: int | None = None,
    turn: str = "straight",
    left: int | None = None,
    right: int | None = None,
    changes: tuple[float, float] = (0.0, np.inf),
) -> Lane:
    """A lane of pieces: each a length in m, and how many degrees it turns to the right on that.

    The markings allow to change to the lanes beside it within a range of its length.
    """
    length = sum(piece[0] for piece in pieces)
    s = np.linspace(0, length, round(length) + 1)
    knots = np.cumsum([0, *(piece[0] for piece in pieces)])
    turned = np.cumsum([yaw, *(piece[1] for piece in pieces)])
    fine = np.linspace(0, length, 40 * (len(s) - 1) + 1)
    heading = np.radians(np.interp(fine, knots, turned))
    middle = (heading[1:] + heading[:-1]) / 2
    steps = np.stack((np.cos(middle), np.sin(middle)), axis=1) * length / (len(fine) - 1)
    places = np.concatenate((np.array((start,)), start + np.cumsum(steps, axis=0)))
    points = np.column_stack((places, np.zeros(len(fine))))[::40]
    limits, allowed = np.full(len(s), LIMIT), (changes[0] <= s) & (s <= changes[1])
    beside = (np.where(allowed, NO_LANE if side is None else side, NO_LANE) for side in (left, right))
    return Lane(index, 1, 0, -1, False, points, s, heading[::40], 3.5, limits, successors, (), *beside, junction, turn)


def ring(*pieces: tuple[float, float], start: tuple[float, float] = (0.0, 0.0)) -> list[Lane]:
    """Two lanes, each of these pieces, that together lead round and round."""
    first = lane(0, *pieces, start=start, successors=(1,))
    x, y, _ = first.points[-1].tolist()
    return [first, lane(1, *pieces, start=(x, y), yaw=float(np.degrees(first.heading[-1])), successors=(0,))]


def small_town(lanes: Sequence[Lane], **others: Any) -> Town:
    """A town of lanes, which get to know their predecessors."""
    before: list[list[int]] = [[] for _ in lanes]
    for one in lanes:
        for other in one.successors:
            before[other].append(one.index)
    return flat_town(lanes=[replace(one, predecessors=tuple(before[one.index])) for one in lanes], **others)
