"""The stop lines of traffic lights and stop signs, and what crosses them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads import network as roads

if TYPE_CHECKING:
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.util.arrays import Floats, Integers

_BESIDE: Final = 8.0  # m to the sides of the zone before a line
_LEVELS: Final = 3.0  # m between roads above each other
_BEHIND: Final = 0.5  # m behind a stop line at which a vehicle may still stop


class StopLines:
    """The stop lines of traffic lights and stop signs of a road network.

    Attributes:
        signal: The signal of each line, (lines,).
        is_stop: Whether each is that of a stop sign, (lines,).
        middle: The middle of each: x, y, z in m, (lines, 3).
    """

    def __init__(self, network: RoadNetwork) -> None:
        lines = network.stop_lines
        self._kinds = network.signals["kind"][lines["signal"]]
        self.signal, self._signals, self.is_stop = lines["signal"], network.signals, self._kinds == roads.STOP
        self.middle = np.stack([(lines[f"{axis}0"] + lines[f"{axis}1"]) / 2 for axis in "xyz"], axis=1)
        self._half = np.hypot(lines["x1"] - lines["x0"], lines["y1"] - lines["y0"]) / 2
        self._ahead = np.stack((np.cos(lines["heading"]), np.sin(lines["heading"])), axis=1)

    def place(self, signal: int) -> tuple[float, float, float]:
        """Return the position of a signal: x, y, z in m."""
        row = self._signals[signal]
        return float(row["x"]), float(row["y"]), float(row["z"])

    def is_before(self, line: int, point: tuple[float, ...], zone: float) -> bool:
        """Return whether a point, in m, is in the zone of a length in m before a line, in which vehicles stop."""
        away = np.array(point[:2]) - self.middle[line, :2]
        along = float(away @ self._ahead[line])
        return -zone <= along <= _BEHIND and float(np.hypot(*away)) <= zone + _BESIDE

    def crossed(
        self, start: Floats, end: Floats, heading: Floats, *, wider: float = 1.0, turned: float = 45.0
    ) -> tuple[Integers, Integers, Floats]:
        """Return which steps cross which line in its direction, and at which share of the step.

        Steps have a start and an end, x, y, z in m, (n, 3), and a heading in radians, (n,). A line is `wider` than its lane
        by a factor, and the heading is `turned` by an angle in degrees from the direction of the lane at most.
        """
        same_way = math.cos(math.radians(turned))
        finite = np.flatnonzero(np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1))
        order = finite[np.argsort(end[finite, 0], kind="stable")]
        longest = float(np.abs(end[finite] - start[finite]).max(initial=0.0))
        found = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
        for line in np.flatnonzero(self._kinds != roads.YIELD).tolist():
            middle, ahead, half = self.middle[line], self._ahead[line], wider * float(self._half[line])
            first, last = np.searchsorted(end[order, 0], middle[0] + (half + longest) * np.array((-1, 1)))
            steps = order[first:last]
            steps = steps[np.abs(end[steps, 1] - middle[1]) <= half + longest]
            before, after = (start[steps, :2] - middle[:2]) @ ahead, (end[steps, :2] - middle[:2]) @ ahead
            crosses = (before < 0) & (after >= 0)
            steps, before, after = steps[crosses], before[crosses], after[crosses]
            share = before / (before - after)
            point = start[steps] + share[:, None] * (end[steps] - start[steps]) - middle
            beside = np.abs(point[:, 1] * ahead[0] - point[:, 0] * ahead[1])
            crosses = (beside <= half) & (np.abs(point[:, 2]) < _LEVELS)
            crosses &= np.cos(heading[steps]) * ahead[0] + np.sin(heading[steps]) * ahead[1] > same_way
            found.append((steps[crosses], np.full(np.count_nonzero(crosses), line), share[crosses]))
        index, lines, shares = (np.concatenate(values) for values in zip(*found, strict=True))
        return index, lines, shares
