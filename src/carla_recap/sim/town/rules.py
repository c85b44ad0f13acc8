"""The rules of the roads: speed limits, and the stretches before the stop lines of traffic lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.town.junctions import SignalKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.town.town import Town
    from carla_recap.util.arrays import Floats, Integers


_REACH: Final = 12.0  # m before the stop line: enough to stop comfortably at 40 km/h
NO_LIGHT: Final = -1


@dataclass(frozen=True, slots=True)
class LaneRules:
    """The rules at some locations on lanes, (n,) each.

    Attributes:
        speed_limit: The speed limit in m/s.
        light: The row of the traffic light ahead; `NO_LIGHT` if there is none.
    """

    speed_limit: Floats
    light: Integers


class Rules:
    """The rules of a town's roads.

    Args:
        town: The town.
    """

    def __init__(self, town: Town) -> None:
        self._limit = np.array([lane.speed_limit for lane in town.lanes])
        zones = sorted(set(_zones(town)))
        self._begin = np.array([zone[1] for zone in zones])
        self._end = np.array([zone[2] for zone in zones])
        self._light = np.array([zone[3] for zone in zones], np.int64)
        lanes = np.array([zone[0] for zone in zones], np.int64)
        self._first = np.searchsorted(lanes, np.arange(len(town.lanes)))
        self._count = np.searchsorted(lanes, np.arange(len(town.lanes)), side="right") - self._first

    def at(self, lane: Integers, s: Floats) -> LaneRules:
        """Return the rules at some distances along lanes.

        Args:
            lane: The lanes, (n,).
            s: The distances in m, (n,).
        """
        light = np.full(len(lane), NO_LIGHT)
        for place in range(self._count.max(initial=0)):
            some = np.flatnonzero(self._count[lane] > place)
            zone = self._first[lane[some]] + place
            inside = (self._begin[zone] <= s[some]) & (s[some] <= self._end[zone])
            light[some[inside]] = self._light[zone[inside]]
        return LaneRules(self._limit[lane], light)


def _zones(town: Town) -> Iterator[tuple[int, float, float, int]]:
    """Yield the lane, begin, end and row of the light of each stretch before a light's stop line."""
    lights = (signal for signal in town.signals if signal.kind is SignalKind.LIGHT)
    for row, signal in enumerate(lights):
        for lane, stop in signal.stops:
            yield from _before(town, lane, stop, _REACH, row)


def _before(town: Town, lane: int, end: float, reach: float, row: int) -> Iterator[tuple[int, float, float, int]]:
    begin = end - reach
    yield lane, max(0.0, begin), end, row
    if begin < 0:
        for previous in town.lanes[lane].predecessors:
            if town.lanes[previous].junction is None:
                yield from _before(town, previous, town.lanes[previous].length, -begin, row)
