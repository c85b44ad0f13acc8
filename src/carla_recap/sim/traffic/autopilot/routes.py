"""The ways that vehicles are on: for each, the lanes ahead, and how far along them it has come."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot.network import NONE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.network import Network

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

DEPTH: Final = 24
"""The most lanes of a route that are known at a time, the current one first."""
_LEAST_AHEAD: Final = 160.0  # m of every route that are known, if so many lanes are enough
_AHEAD: Final = 200.0  # m: so far a route is continued when it has become shorter than that


class Routes:
    """The routes of some vehicles; the distances along each count on and on, from where it began.

    Attributes:
        lanes: The lanes, the current one first, then `NONE`, (vehicles, DEPTH).
        starts: Where these lanes begin, then infinity, (vehicles, DEPTH).
        ends: Where the last of these lanes ends, (vehicles,).
        dead: Whether nothing follows there, (vehicles,).
        along: Where the vehicles are, (vehicles,).
        known: How many lanes the longest of the routes has.
    """

    def __init__(self, network: Network, random: np.random.Generator) -> None:
        self._network = network
        self._random = random
        self.lanes: Integers = np.empty((0, DEPTH), np.int64)
        self.starts: Floats = np.empty((0, DEPTH))
        self.ends: Floats = np.empty(0)
        self.dead: NDArray[np.bool_] = np.empty(0, np.bool_)
        self.along: Floats = np.empty(0)
        self.known = 1

    def __len__(self) -> int:
        return len(self.along)

    def choose(self, rows: Integers) -> None:
        """Go on with some of the vehicles, in a new order."""
        for name in ("lanes", "starts", "ends", "dead", "along"):
            setattr(self, name, getattr(self, name)[rows])
        self._count()

    def add(self) -> None:
        """Add a route that is not known yet."""
        self.lanes = np.concatenate((self.lanes, np.full((1, DEPTH), NONE)))
        self.starts = np.concatenate((self.starts, np.full((1, DEPTH), np.inf)))
        self.ends = np.append(self.ends, 0.0)
        self.dead = np.append(self.dead, False)
        self.along = np.append(self.along, 0.0)

    def begin(self, row: int, lane: int, s: float) -> None:
        """Begin the route of a vehicle anew, on a lane; the distances go on from where it is."""
        self.lanes[row], self.starts[row] = NONE, np.inf
        self.lanes[row, 0], self.starts[row, 0] = lane, self.along[row] - s
        self.ends[row] = self.starts[row, 0] + self._network.length[lane]
        self._extend(row)
        self._count()

    def move(self, along: Floats) -> Integers:
        """Put the vehicles where they have come to; returns the rows of those of whose route more is known by now."""
        self.along = along
        come = np.flatnonzero(along >= self.starts[:, 1])
        for row in come.tolist():
            while along[row] >= self.starts[row, 1]:
                self.lanes[row] = np.append(self.lanes[row, 1:], NONE)
                self.starts[row] = np.append(self.starts[row, 1:], np.inf)
        short = np.flatnonzero((self.ends < along + _LEAST_AHEAD) & ~self.dead & (self.lanes[:, -1] == NONE))
        for row in short.tolist():
            self._extend(row)
        if len(come) or len(short):
            self._count()
        return short

    def locate(self, ahead: Floats) -> tuple[Integers, Floats]:
        """The lanes that some distances ahead of the vehicles lie on, and how far along these: for `Network.spot`.

        Args:
            ahead: Distances from where they are, (vehicles, any).
        """
        target = self.along[:, None] + ahead
        rows = np.arange(len(self.along))[:, None]
        number = np.zeros(target.shape, np.int64)
        for start in range(1, self.known):
            number += target >= self.starts[:, start, None]
        return self.lanes[rows, number], target - self.starts[rows, number]

    def _count(self) -> None:
        self.known = max(int(np.isfinite(self.starts).any(axis=0).sum()), 1)

    def _extend(self, row: int) -> None:
        lanes, starts, length = self.lanes[row], self.starts[row], self._network.length
        used = int((lanes != NONE).sum())
        end = self.ends[row]
        while used < DEPTH and end < self.along[row] + _AHEAD:
            choices = self._network.onward[lanes[used - 1]]
            self.dead[row] = not choices
            if not choices:
                break
            choice = choices[0] if len(choices) == 1 else choices[int(self._random.integers(len(choices)))]
            lanes[used], starts[used] = choice, end
            end += length[choice]
            used += 1
        self.ends[row] = end
