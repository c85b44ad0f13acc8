"""The states of traffic lights over a recording, by the signals of a map."""

from __future__ import annotations

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

RED: Final = 0
"""The state of a red light."""

_NEAR: Final = 3.0  # m from a recorded light to the signal of the map that it is; CARLA's are 0.3 m apart


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
        if not records.shape[1] or not self._lights:
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
