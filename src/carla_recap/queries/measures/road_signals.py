"""The signals of a road network: the stop lines of lights and stop signs, what crosses them, and the states of lights."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import place_in_metres
from carla_recap.model.records import ActorKind
from carla_recap.roads import network as roads

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.util.arrays import Floats, Integers

RED: Final = 0
"""The state of a red light."""

_NEAR: Final = 3.0  # m from a recorded light to the signal of the map that it is; CARLA's are 0.3 m apart
_BESIDE: Final = 8.0  # m to the sides of the zone before a line
_LEVELS: Final = 3.0  # m between roads above each other
_BEHIND: Final = 0.5  # m behind a stop line at which a vehicle may still stop


class StopLines:
    """The stop lines of traffic lights and stop signs of a road network."""

    def __init__(self, network: RoadNetwork) -> None:
        lines = network.stop_lines
        self._kinds = network.signals["kind"][lines["signal"]]
        # Of each line: its signal and whether it is that of a stop sign, (lines,), and its middle: x, y, z in m, (lines, 3).
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


class LightHistory:
    """The states of the recorded traffic lights, by the signals of the map that they stand for.

    A recorded light is the nearest light of the map, at most 3 m away. The spawns of the recording are read at once.
    """

    def __init__(self, source: Reader, network: RoadNetwork) -> None:
        self._lights: dict[int, list[tuple[float, int]]] = defaultdict(list)  # since when which light, by signal
        self._times: dict[int, list[float]] = defaultdict(list)  # of the changes of each light
        self._states: dict[int, list[int]] = defaultdict(list)
        self._ids = np.zeros(0, np.uint32)
        self._current = np.zeros(0, np.int8)
        signals = np.flatnonzero(network.signals["kind"] == roads.LIGHT)
        positions = np.stack((network.signals["x"], network.signals["y"]), axis=1)[signals]
        if not len(signals):
            return
        for frame in source.frames(("spawned",), sparse=True):
            taken: set[int] = set()  # lights of one frame are different signals
            for spawn in frame["spawned"]:
                if spawn.kind == ActorKind.TRAFFIC_LIGHT:
                    apart = np.hypot(*(positions - place_in_metres(spawn.x, spawn.y, spawn.z)[:2]).T)
                    near = [number for number in np.argsort(apart).tolist() if apart[number] <= _NEAR]
                    signal = next((number for number in near if number not in taken), None)
                    if signal is not None:
                        taken.add(signal)
                        self._lights[int(signals[signal])].append((frame.elapsed, spawn.id))

    @property
    def signals(self) -> tuple[int, ...]:
        """The signals of the map that are recorded."""
        return tuple(self._lights)

    def add(self, batch: Batch) -> None:
        """Process the next frames; they have at least their states of lights."""
        records = batch.records("light_states")
        if batch.preamble or not records.shape[1] or not self._lights:
            return
        ids, states = records["id"], records["state"]
        changed = np.ones(len(records), np.bool_)
        changed[1:] = ((ids[1:] != ids[:-1]) | (states[1:] != states[:-1])).any(axis=1)
        if np.array_equal(ids[0], self._ids) and np.array_equal(states[0], self._current):
            changed[0] = False
        for row in np.flatnonzero(changed).tolist():
            time = float(batch.elapsed[row])
            for id, state in zip(ids[row].tolist(), states[row].tolist(), strict=True):
                known = self._states[id]
                if not known or known[-1] != state:
                    known.append(state)
                    self._times[id].append(time)
        self._ids, self._current = ids[-1].copy(), states[-1].copy()

    def red(self, signal: int, start: float, stop: float, *, always: bool) -> int | None:
        """Return the light of a signal if it is red from one time to another, in s, at some time or `always`; else None."""
        light = next((id for since, id in reversed(self._lights.get(signal, ())) if since <= start + SAME_TIME), None)
        if light is None:
            return None
        times, states = self._times[light], self._states[light]
        first = bisect_right(times, start + SAME_TIME) - 1
        if always:
            is_red = first >= 0 and states[first] == RED and (first + 1 >= len(times) or times[first + 1] > stop)
        else:
            is_red = RED in states[max(first, 0) : bisect_right(times, stop + SAME_TIME)]
        return light if is_red else None
