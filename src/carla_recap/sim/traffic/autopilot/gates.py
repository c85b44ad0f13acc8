"""Where a route needs permission to go on: at lights, at stop signs, and at the lanes through junctions."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Final

from carla_recap.sim.town.town import SignalKind
from carla_recap.sim.traffic.autopilot.network import NONE

if TYPE_CHECKING:
    from carla_recap.sim.town.town import Conflict, Town
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes

_LOOK_BACK: Final = 15.0  # m: a stop line stands no farther before the junction that it is for
_PAST: Final = 1.0  # m: who is so far beyond a line has passed it


@dataclass(frozen=True)
class Gate:
    """A place on a route that is passed only with permission; all distances are along the route.

    Attributes:
        line: Where to stop.
        lanes: The lanes through the junction behind it, with where each begins; empty behind a light between junctions.
        leave: Where the last of these lanes ends, or the line, if there are none.
        exits: The lanes of the route from there on, with where each begins.
        light: The signal that is in force there, or `NONE`.
        stop_sign: Whether one has to stop at the line.
    """

    line: float
    lanes: tuple[tuple[int, float], ...]
    leave: float
    exits: tuple[tuple[int, float], ...]
    light: int = NONE
    stop_sign: bool = False

    @property
    def begin(self) -> float:
        """Where the junction begins, or the line, if there is none."""
        return self.lanes[0][1] if self.lanes else self.line


@dataclass
class Crossings:
    """What the gates of a town are made of.

    Attributes:
        conflicts: Of each lane, with where on the other lane the conflict ends.
        lights: The lights that one enters each lane by.
        stop_signs: The same for stop signs.
        lines: Where the stop lines of a signal are: by signal and lane, how far along that.
        alone: The lights between junctions: by lane.
    """

    conflicts: list[list[tuple[Conflict, float]]]
    lights: dict[int, int] = field(default_factory=dict)
    stop_signs: dict[int, int] = field(default_factory=dict)
    lines: dict[tuple[int, int], float] = field(default_factory=dict)
    alone: dict[int, tuple[int, float]] = field(default_factory=dict)


def survey(town: Town) -> Crossings:
    """Collect what gates are made of."""
    ends = {(c.lane, c.other): c.end for junction in town.junctions for c in junction.conflicts}
    conflicts: list[list[tuple[Conflict, float]]] = [[] for _ in town.lanes]
    for junction in town.junctions:
        for conflict in junction.conflicts:
            conflicts[conflict.lane].append((conflict, ends.get((conflict.other, conflict.lane), inf)))
    crossings = Crossings(conflicts)
    for signal in town.signals:
        if signal.kind not in (SignalKind.LIGHT, SignalKind.STOP):
            continue
        governing = crossings.lights if signal.kind is SignalKind.LIGHT else crossings.stop_signs
        governing.update((lane, signal.index) for lane in signal.governs)
        crossings.lines.update({(signal.index, lane): s for lane, s in signal.stops})
        if signal.kind is SignalKind.LIGHT and not signal.governs:
            crossings.alone.update((lane, (signal.index, s)) for lane, s in signal.stops)
    return crossings


def next_gate(network: Network, crossings: Crossings, routes: Routes, row: int, front: float, room: float) -> Gate | None:
    """The next gate of a route.

    Args:
        network: The lanes.
        crossings: What gates are made of.
        routes: The routes.
        row: The vehicle.
        front: How far its front end has come.
        room: How much room there must be between two junctions, so that the vehicle can wait there.
    """
    used = int((routes.lanes[row] != NONE).sum())
    lanes: list[int] = routes.lanes[row, :used].tolist()
    starts: list[float] = routes.starts[row, :used].tolist()
    for number, (lane, start) in enumerate(zip(lanes, starts, strict=True)):
        alone = crossings.alone.get(lane)
        if alone is not None and start + alone[1] > front - _PAST:
            return Gate(start + alone[1], (), start + alone[1], (), alone[0])
        if network.junction[lane] != NONE and start > front - _PAST:
            return _through(network, crossings, lanes, starts, number, room)
    return None


def inside(network: Network, routes: Routes, row: int, rear: float, front: float) -> Gate | None:
    """A gate that a vehicle is already beyond, if it is in a junction."""
    used = int((routes.lanes[row] != NONE).sum())
    lanes, starts = routes.lanes[row, :used].tolist(), routes.starts[row, : used + 1].tolist()
    through = tuple(
        (lane, start)
        for lane, start, end in zip(lanes, starts, starts[1:], strict=False)
        if network.junction[lane] != NONE and start <= front - _PAST and end > rear
    )
    if not through:
        return None
    last = through[-1][0]
    leave = through[-1][1] + float(network.length[last])
    after = lanes.index(last) + 1
    return Gate(through[0][1], through, leave, tuple(zip(lanes[after:], starts[after:], strict=False)))


def _through(
    network: Network, crossings: Crossings, lanes: list[int], starts: list[float], number: int, room: float
) -> Gate:
    """The gate before the junction that a lane of a route leads into."""
    entry, begin = lanes[number], starts[number]
    through: list[tuple[int, float]] = []
    leave, after = begin, number
    for place in range(number, len(lanes)):
        if network.junction[lanes[place]] != NONE:
            if starts[place] - leave >= room and through:
                break
            through.append((lanes[place], starts[place]))
            leave, after = starts[place] + float(network.length[lanes[place]]), place + 1
        elif starts[place] + float(network.length[lanes[place]]) - leave >= room:
            break
    light = crossings.lights.get(entry, NONE)
    sign = crossings.stop_signs.get(entry, NONE)
    line = begin
    for back in range(number - 1, -1, -1):
        if begin - starts[back + 1] > _LOOK_BACK:
            break
        for signal in (light, sign):
            s = crossings.lines.get((signal, lanes[back]))
            if s is not None and begin - starts[back] - s <= _LOOK_BACK:
                line = min(line, starts[back] + s)
    return Gate(
        line,
        tuple(through),
        leave,
        tuple(zip(lanes[after:], starts[after:], strict=True)),
        light,
        sign != NONE,
    )
