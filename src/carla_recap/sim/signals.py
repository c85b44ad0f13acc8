"""The traffic lights of a town as arrays, and their cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.town.junctions import SignalKind

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from carla_recap.sim.town.loading import Town
    from carla_recap.util.arrays import Integers


RED, YELLOW, GREEN, OFF, UNKNOWN = range(5)
GREEN_TIME, YELLOW_TIME, RED_TIME = 10.0, 3.0, 2.0
"""CARLA's default durations in s: of green, of yellow, and of red for all after that."""
_ROUNDING: Final = 1e-9  # s


class Signals:
    """The traffic lights as a struct of arrays; row i is `World.traffic_lights[i]`, times are in s.

    A group is the lights of a junction; a phase is those of them that are green together. Its times are those of its first
    light.

    Attributes:
        signal: The index of each light among the town's signals, (n,).
        state: 0 red, 1 yellow, 2 green, 3 off, 4 unknown, (n,).
        elapsed: How long each has been in its state.
        red_time: The time after yellow in which all lights of its group are red.
        held: Whether a replay sets the states, which then do not change with time.
    """

    def __init__(self, town: Town) -> None:
        self.signal = np.array([s.index for s in town.signals if s.kind is SignalKind.LIGHT], np.int64)
        count = len(self.signal)
        self.id = np.zeros(count, np.int64)
        self.held = False
        self.state = np.full(count, RED, np.int64)
        self.elapsed = np.zeros(count)
        self.frozen = np.zeros(count, np.bool_)
        self._times = np.repeat([[RED_TIME], [YELLOW_TIME], [GREEN_TIME]], count, axis=1)  # a row for each stage
        self.red_time, self.yellow_time, self.green_time = self._times
        self._groups = self._grouped(town)
        self._group_of = np.zeros(count, np.int64)
        for number, group in enumerate(self._groups):
            for phase in group:
                self._group_of[phase] = number
        self._phase = np.zeros(len(self._groups), np.int64)
        self._stage = np.full(len(self._groups), GREEN)
        self._clock = np.zeros(len(self._groups))
        self._halted = np.zeros(len(self._groups), np.bool_)
        self._leader = np.zeros(len(self._groups), np.int64)
        self._governing = self._lanes(town)
        self.reset_all()

    def __len__(self) -> int:
        return len(self.signal)

    def step(self, seconds: float) -> None:
        """Advance the cycles by a tick of a length in s."""
        if self.held:
            return
        self.elapsed += seconds * ~self.frozen
        self._clock += seconds * ~self._halted
        times = self._times[self._stage, self._leader]
        for number in (self._clock >= times - _ROUNDING).nonzero()[0].tolist():
            stage, phase = int(self._stage[number]), int(self._phase[number])
            if stage == RED:
                self._enter(number, (phase + 1) % len(self._groups[number]), GREEN)
            else:
                self._enter(number, phase, YELLOW if stage == GREEN else RED)

    def state_of_lane(self, lane: ArrayLike) -> Integers:
        """Return the states for lanes, (k,): of several lights that govern one, the strictest; off if none does."""
        states = np.append(self.state, OFF)[self._governing[np.asarray(lane)]]
        strictest: Integers = np.where(states == UNKNOWN, OFF, states).min(axis=-1)
        return strictest

    def group_of(self, row: int) -> list[int]:
        """Return the rows of the lights in the group of a light, itself included."""
        return sorted(row for phase in self._groups[self._group_of[row]] for row in phase)

    def set_state(self, row: int, state: int) -> None:
        """Set the state of a light until its group changes it the next time."""
        if state != self.state[row]:
            self.elapsed[row] = 0.0
        self.state[row] = state

    def freeze(self, row: int, frozen: bool) -> None:
        """Stop the time of a light's group, or continue it."""
        group = self._group_of[row]
        self._halted[group] = frozen
        self.frozen[self.group_of(row)] = frozen

    def freeze_all(self, frozen: bool) -> None:
        """Stop the time of all lights, or continue it."""
        self._halted[:] = frozen
        self.frozen[:] = frozen

    def reset(self, row: int) -> None:
        """Restart the cycle of a light's group."""
        self._enter(int(self._group_of[row]), 0, GREEN)

    def reset_all(self) -> None:
        """Restart the cycles of all groups."""
        for number in range(len(self._groups)):
            self._enter(number, 0, GREEN)

    def _enter(self, number: int, phase: int, stage: int) -> None:
        """Begin a stage of a group's cycle: one phase is green, then yellow, then red like the others."""
        group = self._groups[number]
        self._phase[number], self._stage[number], self._clock[number] = phase, stage, 0.0
        self._leader[number] = group[phase][0]
        for other, rows in enumerate(group):
            for row in rows:
                self.set_state(row, stage if other == phase else RED)

    def _grouped(self, town: Town) -> list[list[list[int]]]:
        """Return the rows of the lights by group and phase; a light without a junction is a group of its own."""
        row_of = {index: row for row, index in enumerate(self.signal.tolist())}
        groups = [[[row_of[index] for index in phase] for phase in j.phases] for j in town.junctions if j.phases]
        grouped = {row for group in groups for phase in group for row in phase}
        return groups + [[[row]] for row in row_of.values() if row not in grouped]

    def _lanes(self, town: Town) -> Integers:
        """Return the rows of the lights that govern each lane, padded with a row beyond the last, (lanes, most)."""
        governing: list[list[int]] = [[] for _ in town.lanes]
        for row, index in enumerate(self.signal.tolist()):
            signal = town.signals[index]
            for lane in dict.fromkeys((*(lane for lane, _ in signal.stops), *signal.governs)):
                governing[lane].append(row)
        most = max(1, *(len(rows) for rows in governing)) if governing else 1
        return np.array([rows + [len(self)] * (most - len(rows)) for rows in governing], np.int64).reshape(-1, most)
