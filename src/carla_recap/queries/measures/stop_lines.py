"""The stop lines of traffic lights and stop signs, and what crosses them."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads import network as roads

if TYPE_CHECKING:
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.util.arrays import Floats, Integers

_CELL: Final = 8.0  # m, of the grid of stop lines
_LEVELS: Final = 3.0  # m between roads above each other
_BEHIND: Final = 0.5  # m behind a stop line at which a vehicle may still stop


class StopLines:
    """The stop lines of traffic lights and stop signs, in the squares of a grid.

    Args:
        network: The roads.
    """

    def __init__(self, network: RoadNetwork) -> None:
        lines = network.stop_lines
        self._kinds = network.signals["kind"][lines["signal"]]
        self._signal_of_line, self._signals = lines["signal"], network.signals
        self._middle = np.stack([(lines[f"{axis}0"] + lines[f"{axis}1"]) / 2 for axis in "xyz"], axis=1)
        self._half = np.hypot(lines["x1"] - lines["x0"], lines["y1"] - lines["y0"]) / 2
        self._ahead = np.stack((np.cos(lines["heading"]), np.sin(lines["heading"])), axis=1)
        cells: dict[tuple[int, int], list[int]] = defaultdict(list)
        for line in np.flatnonzero(self._kinds != roads.YIELD).tolist():
            column, row = np.floor(self._middle[line, :2] / _CELL).astype(np.int64).tolist()
            for x in (-1, 0, 1):
                for y in (-1, 0, 1):
                    cells[column + x, row + y].append(line)
        keys = {_key(np.array(column), np.array(row)).item(): lines for (column, row), lines in cells.items()}
        self._keys = np.array(sorted(keys), np.int64)
        self._of_cell = np.full((len(keys) + 1, max(map(len, cells.values()), default=0)), roads.NONE)
        for number, key in enumerate(self._keys.tolist()):
            self._of_cell[number, : len(keys[key])] = keys[key]

    def signal(self, line: int) -> int:
        """Return the signal of a line."""
        return int(self._signal_of_line[line])

    def middle(self, line: int) -> Floats:
        """Return the middle of a line: x, y, z in m, (3,)."""
        middle: Floats = self._middle[line]
        return middle

    def place(self, signal: int) -> tuple[float, float, float]:
        """Return the position of a signal: x, y, z in m."""
        row = self._signals[signal]
        return float(row["x"]), float(row["y"]), float(row["z"])

    def is_stop(self, line: int) -> bool:
        """Return whether a line is that of a stop sign."""
        return bool(self._kinds[line] == roads.STOP)

    def is_before(self, line: int, point: tuple[float, ...], zone: float) -> bool:
        """Return whether a point is in the zone before a line in which vehicles stop.

        Args:
            line: The line.
            point: x and y in m, and maybe z.
            zone: The length of the zone, in m.
        """
        away = np.array(point[:2]) - self._middle[line, :2]
        along = float(away @ self._ahead[line])
        return -zone <= along <= _BEHIND and float(np.hypot(*away)) <= zone + _CELL

    def crossed(
        self, start: Floats, end: Floats, heading: Floats, *, wider: float = 1.0, turned: float = 45.0
    ) -> tuple[Integers, Integers, Floats]:
        """Return which steps cross which line in its direction, and at which share of the step.

        Args:
            start: Where each step begins: x, y, z in m, (n, 3).
            end: Where each step ends, (n, 3).
            heading: The heading of the vehicle in radians, (n,).
            wider: The factor by which a line is wider than its lane.
            turned: The greatest angle between the heading and the direction of the lane, in degrees.
        """
        same_way = math.cos(math.radians(turned))
        cells = np.floor(end[:, :2] / _CELL)
        near = np.abs(cells).max(axis=1, initial=0) < _FARTHEST_CELL
        keys = _key(*np.where(near[:, None], cells, 0).astype(np.int64).T)
        slots = np.minimum(np.searchsorted(self._keys, keys), max(len(self._keys) - 1, 0))
        known = near & (self._keys[slots] == keys) if len(self._keys) else np.zeros(len(keys), np.bool_)
        steps = np.flatnonzero(known)
        found: list[tuple[Integers, Integers, Floats]] = []
        for number in range(self._of_cell.shape[1]):
            line = self._of_cell[slots[steps], number]
            steps, line = steps[line != roads.NONE], line[line != roads.NONE]
            if not len(steps):
                break
            ahead, middle = self._ahead[line], self._middle[line]
            before = ((start[steps, :2] - middle[:, :2]) * ahead).sum(axis=1)
            after = ((end[steps, :2] - middle[:, :2]) * ahead).sum(axis=1)
            share = before / (before - after)
            point = start[steps] + share[:, None] * (end[steps] - start[steps]) - middle
            beside = np.abs(point[:, 1] * ahead[:, 0] - point[:, 0] * ahead[:, 1])
            crosses = (before < 0) & (after >= 0) & (beside <= wider * self._half[line]) & (np.abs(point[:, 2]) < _LEVELS)
            crosses &= np.cos(heading[steps]) * ahead[:, 0] + np.sin(heading[steps]) * ahead[:, 1] > same_way
            found.append((steps[crosses], line[crosses], share[crosses]))
        if not found:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        index, lines, shares = (np.concatenate(values) for values in zip(*found, strict=True))
        return index, lines, shares


_FARTHEST_CELL: Final = 1 << 30


def _key(column: Integers, row: Integers) -> Integers:
    return (column << 32) + row
