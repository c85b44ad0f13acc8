"""The traffic lights ahead of places on lanes: where CARLA's clients say that a vehicle is at a light."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.town.junctions import SignalKind

if TYPE_CHECKING:
    from carla_recap.sim.town.loading import Town
    from carla_recap.util.arrays import Floats, Integers

_REACH: Final = 12.0  # m before the stop line: enough to stop comfortably at 40 km/h
NO_LIGHT: Final = -1


class LightsAhead:
    """The stretches before the stop lines of traffic lights."""

    def __init__(self, town: Town) -> None:
        stretches: set[tuple[int, float, float, int]] = set()
        lights = (signal for signal in town.signals if signal.kind is SignalKind.LIGHT)
        remaining = [(lane, stop, _REACH, row) for row, light in enumerate(lights) for lane, stop in light.stops]
        for lane, end, reach, row in remaining:  # grows
            stretch = lane, end - reach, end, row
            if end < reach and stretch not in stretches:
                before = [other for other in town.lanes[lane].predecessors if town.lanes[other].junction is None]
                remaining += [(other, town.lanes[other].length, reach - end, row) for other in before]
            stretches.add(stretch)
        self._stretches: defaultdict[int, list[tuple[float, float, int]]] = defaultdict(list)
        for lane, begin, end, row in sorted(stretches, key=lambda stretch: (stretch[1], -stretch[3])):  # nearest lines first
            self._stretches[lane].append((begin, end, row))

    def at(self, lane: Integers, s: Floats) -> Integers:
        """Return the rows of the lights ahead of places at some distances along lanes in m, (n,); `NO_LIGHT` for none."""
        places = zip(lane.tolist(), s.tolist(), strict=True)
        rows = [next((row for begin, end, row in self._stretches[on] if begin <= at <= end), NO_LIGHT) for on, at in places]
        return np.array(rows, np.int64)
