"""The traffic lights of a town: one group for each junction, whose phases are green one after another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.town.town import SignalKind

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from carla_recap.sim.town.town import Town

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

RED, YELLOW, GREEN, OFF, UNKNOWN = range(5)
GREEN_TIME, YELLOW_TIME, RED_TIME = 10.0, 3.0, 2.0
"""How long a light is green and yellow, and then all are red, in s: CARLA's defaults."""
_ROUNDING: Final = 1e-9  # s


class Signals:
    """The lights as a struct of arrays; row i is `world.traffic_lights[i]`.

    A phase is the lights of a junction that are green together. Its times are those of its first light.

    Args:
        town: The town.

    Attributes:
        signal: The index of each light among the town's signals, (n,).
        state: 0 red, 1 yellow, 2 green, 3 off, 4 unknown, (n,).
        elapsed: For how long each has been in its state, in s.
        frozen: Whether its time stands still.
        green_time: How long it is green, in s.
        yellow_time: How long it is yellow, in s.
        red_time: How long all are red after it, in s.
        held: Whether somebody else says what all of them show, as a replay does: time then does nothing.
    """

    def __init__(self, town: Town) -> None:
        self.signal = np.array([s.index for s in town.signals if s.kind is SignalKind.LIGHT], np.int64)
        count = len(self.signal)
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
        """Let time pass."""
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
        """What the lights show for lanes: of several that govern one, the strictest; off where none does.

        Args:
            lane: Indices of lanes, (k,).
        """
        shown = np.append(self.state, OFF)[self._governing[np.asarray(lane)]]
        states: Integers = np.where(shown == UNKNOWN, OFF, shown).min(axis=-1)
        return states

    def group_of(self, row: int) -> list[int]:
        """The rows of the lights that take turns with a light, itself included."""
        return sorted(row for phase in self._groups[self._group_of[row]] for row in phase)

    def set_state(self, row: int, state: int) -> None:
        """Show something until the group changes the light the next time."""
        if state != self.state[row]:
            self.elapsed[row] = 0.0
        self.state[row] = state

    def freeze(self, row: int, frozen: bool) -> None:
        """Stop the time of a light's group, or let it go on."""
        group = self._group_of[row]
        self._halted[group] = frozen
        self.frozen[self.group_of(row)] = frozen

    def freeze_all(self, frozen: bool) -> None:
        """Stop the time of all lights, or let it go on."""
        self._halted[:] = frozen
        self.frozen[:] = frozen

    def reset(self, row: int) -> None:
        """Let the group of a light begin its cycle again."""
        self._enter(int(self._group_of[row]), 0, GREEN)

    def reset_all(self) -> None:
        """Let all groups begin their cycles again."""
        for number in range(len(self._groups)):
            self._enter(number, 0, GREEN)

    def _enter(self, number: int, phase: int, stage: int) -> None:
        """Begin a stage of a group's cycle: a phase is green, then yellow, then red like the others."""
        group = self._groups[number]
        self._phase[number], self._stage[number], self._clock[number] = phase, stage, 0.0
        self._leader[number] = group[phase][0]
        for other, rows in enumerate(group):
            for row in rows:
                self.set_state(row, stage if other == phase else RED)

    def _grouped(self, town: Town) -> list[list[list[int]]]:
        """The rows of the lights by group and phase; who is in none takes turns with itself."""
        row_of = {index: row for row, index in enumerate(self.signal.tolist())}
        groups = [[[row_of[index] for index in phase] for phase in j.phases] for j in town.junctions if j.phases]
        grouped = {row for group in groups for phase in group for row in phase}
        return groups + [[[row]] for row in row_of.values() if row not in grouped]

    def _lanes(self, town: Town) -> Integers:
        """The rows of the lights that govern each lane, filled up with a row beyond the last, (lanes, most)."""
        governing: list[list[int]] = [[] for _ in town.lanes]
        for row, index in enumerate(self.signal.tolist()):
            signal = town.signals[index]
            for lane in dict.fromkeys((*(lane for lane, _ in signal.stops), *signal.governs)):
                governing[lane].append(row)
        most = max(1, *(len(rows) for rows in governing)) if governing else 1
        return np.array([rows + [len(self)] * (most - len(rows)) for rows in governing], np.int64).reshape(-1, most)
