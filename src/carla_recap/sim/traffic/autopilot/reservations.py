"""Stop lines on routes, and the reservations of the junctions behind them: by signs, priority and order of arrival."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Final

from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.traffic.autopilot.drivers import NONE

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.sim.town.junctions import Conflict
    from carla_recap.sim.town.town import Town
    from carla_recap.sim.traffic.autopilot.routes import LaneNetwork, Routes

    FreeLength = Callable[["StopLine"], float]

_MAX_SETBACK: Final = 15.0  # m: a stop line stands no farther before the junction that it is for
_PASSED: Final = 1.0  # m beyond a line, from where on a vehicle has passed it
_PATIENCE: Final = 4.0  # s: vehicles that wait longer no longer let others go first
_LONG: Final = 20.0  # s: vehicles that wait longer go when the path is free, even if others that are stuck have reservations
_STUCK: Final = 10.0  # s of standing in a junction, from which on a vehicle counts as stuck
_AT_LINE: Final = 12.0  # m before a line, where vehicles count as waiting there
_GAP: Final = 2.0  # m between standing vehicles
_SPARE: Final = 1.0  # m less room between two junctions that is enough to wait for a light; a length and the gap are left


@dataclass(frozen=True)
class StopLine:
    """A position on a route that is passed with a reservation only; all positions are along the route, in m.

    Attributes:
        position: The position of the line.
        lanes: The lanes through the junction behind it, with their starts; empty behind a light between junctions.
        end: The end of the last of these lanes; the line, if there are none.
        exits: The lanes of the route from there on, with their starts.
        signal: The index of the light that is in force there, or `NONE`.
        has_stop_sign: Whether vehicles have to stop at the line.
    """

    position: float
    lanes: tuple[tuple[int, float], ...]
    end: float
    exits: tuple[tuple[int, float], ...]
    signal: int = NONE
    has_stop_sign: bool = False

    @property
    def start(self) -> float:
        """The start of the junction; the line, if there is none."""
        return self.lanes[0][1] if self.lanes else self.position


@dataclass
class JunctionRules:
    """The conflicts, lights and stop signs of a town by lane.

    Attributes:
        conflicts: The conflicts of each lane, with the ends of the conflicts along the other lanes.
        lights: The lights at the entrance of lanes.
        stop_signs: The stop signs at the entrance of lanes.
        lines: The distances of stop lines along lanes, by signal and lane.
        midblock_lights: The lights between junctions, with the distances of their stop lines.
    """

    conflicts: list[list[tuple[Conflict, float]]]
    lights: dict[int, int] = field(default_factory=dict)
    stop_signs: dict[int, int] = field(default_factory=dict)
    lines: dict[tuple[int, int], float] = field(default_factory=dict)
    midblock_lights: dict[int, tuple[int, float]] = field(default_factory=dict)

    @classmethod
    def of(cls, town: Town) -> JunctionRules:
        """Return the rules of a town."""
        ends = {(c.lane, c.other): c.end for junction in town.junctions for c in junction.conflicts}
        rules = cls([[] for _ in town.lanes])
        for junction in town.junctions:
            for conflict in junction.conflicts:
                rules.conflicts[conflict.lane].append((conflict, ends.get((conflict.other, conflict.lane), inf)))
        for signal in town.signals:
            if signal.kind not in (SignalKind.LIGHT, SignalKind.STOP):
                continue
            governing = rules.lights if signal.kind is SignalKind.LIGHT else rules.stop_signs
            governing.update((lane, signal.index) for lane in signal.governs)
            rules.lines.update({(signal.index, lane): s for lane, s in signal.stops})
            if signal.kind is SignalKind.LIGHT and not signal.governs:
                rules.midblock_lights.update((lane, (signal.index, s)) for lane, s in signal.stops)
        return rules


def next_stop_line(
    network: LaneNetwork, rules: JunctionRules, routes: Routes, row: int, front: float, room: float
) -> StopLine | None:
    """Return the next stop line of a route, if there is one.

    Args:
        network: The lanes.
        rules: The rules of the junctions.
        routes: The routes.
        row: The row of the vehicle's driver.
        front: The position of its front end.
        room: The least length between two junctions in which the vehicle can wait, in m.
    """
    used = int((routes.lanes[row] != NONE).sum())
    lanes: list[int] = routes.lanes[row, :used].tolist()
    starts: list[float] = routes.starts[row, :used].tolist()
    for number, (lane, start) in enumerate(zip(lanes, starts, strict=True)):
        midblock = rules.midblock_lights.get(lane)
        if midblock is not None and start + midblock[1] > front - _PASSED:
            return StopLine(start + midblock[1], (), start + midblock[1], (), midblock[0])
        if network.junction[lane] != NONE and start > front - _PASSED:
            return _before_junction(network, rules, lanes, starts, number, room)
    return None


def current_junction(network: LaneNetwork, routes: Routes, row: int, rear: float, front: float) -> StopLine | None:
    """Return the stop line before the junction that a vehicle is in, if it is in one."""
    used = int((routes.lanes[row] != NONE).sum())
    lanes, starts = routes.lanes[row, :used].tolist(), routes.starts[row, : used + 1].tolist()
    through = tuple(
        (lane, start)
        for lane, start, end in zip(lanes, starts, starts[1:], strict=False)
        if network.junction[lane] != NONE and start <= front - _PASSED and end > rear
    )
    if not through:
        return None
    last = through[-1][0]
    end = through[-1][1] + float(network.length[last])
    after = lanes.index(last) + 1
    return StopLine(through[0][1], through, end, tuple(zip(lanes[after:], starts[after:], strict=False)))


def _before_junction(
    network: LaneNetwork, rules: JunctionRules, lanes: list[int], starts: list[float], number: int, room: float
) -> StopLine:
    """Return the stop line before the junction that a lane of a route leads into."""
    entry, begin = lanes[number], starts[number]
    through: list[tuple[int, float]] = []
    end, after = begin, number
    for index in range(number, len(lanes)):
        if network.junction[lanes[index]] != NONE:
            spare = _SPARE if lanes[index] in rules.lights else 0.0  # so that few drive on to the light behind both
            if starts[index] - end >= room - spare and through:
                break
            through.append((lanes[index], starts[index]))
            end, after = starts[index] + float(network.length[lanes[index]]), index + 1
        elif starts[index] + float(network.length[lanes[index]]) - end >= room:
            break
    light = rules.lights.get(entry, NONE)
    sign = rules.stop_signs.get(entry, NONE)
    position = begin
    for back in range(number - 1, -1, -1):
        if begin - starts[back + 1] > _MAX_SETBACK:
            break
        for signal in (light, sign):
            s = rules.lines.get((signal, lanes[back]))
            if s is not None and begin - starts[back] - s <= _MAX_SETBACK:
                position = min(position, starts[back] + s)
    exits = tuple(zip(lanes[after:], starts[after:], strict=True))
    return StopLine(position, tuple(through), end, exits, light, sign != NONE)


@dataclass
class ReservationRequest:
    """A vehicle that asks to pass its stop line.

    Attributes:
        id: The id of the vehicle.
        stop_line: The stop line.
        since: The time at which it first asked, in s.
        distance: The distance from its front end to the line, in m.
        length: The length of the vehicle in m.
        free_distance: The distance from its front end to the nearest obstacle on its path, in m.
    """

    id: int
    stop_line: StopLine
    since: float
    distance: float
    length: float
    free_distance: float


class Reservations:
    """The reservations of lanes through junctions.

    Args:
        rules: The rules of the junctions.
        rear: Returns the position of the rear end of a vehicle along its route, in m.
        standing_time: Returns how long a vehicle has been standing, in s.
    """

    def __init__(self, rules: JunctionRules, rear: Callable[[int], float], standing_time: Callable[[int], float]) -> None:
        self._conflicts = rules.conflicts
        self._rear, self._standing_time = rear, standing_time
        self._holders: dict[int, dict[int, float]] = defaultdict(dict)  # lane → vehicle → start of the lane
        self._leaving: dict[int, dict[int, tuple[float, float]]] = defaultdict(dict)  # exit → vehicle → its start, length

    def reserve(self, id: int, stop_line: StopLine, length: float) -> None:
        """Reserve the lanes behind a stop line for a vehicle of a length in m."""
        for lane, start in stop_line.lanes:
            self._holders[lane][id] = start
        if stop_line.exits:
            self._leaving[stop_line.exits[0][0]][id] = stop_line.end, length + _GAP

    def release(self, id: int, stop_line: StopLine) -> None:
        """Release the reservation of a vehicle."""
        for lane, _ in stop_line.lanes:
            self._holders[lane].pop(id, None)
        if stop_line.exits:
            self._leaving[stop_line.exits[0][0]].pop(id, None)

    def grant(self, requests: list[ReservationRequest], now: float, free_length: FreeLength) -> list[ReservationRequest]:
        """Decide which vehicles get a reservation, and reserve.

        Args:
            requests: The requests of all vehicles that wait.
            now: The time in s.
            free_length: Returns the free length behind the junction of a stop line, in m.

        Returns:
            The requests that are granted.
        """
        granted: list[ReservationRequest] = []
        claimed: set[int] = set()
        claimed_exits: set[int] = set()
        by_lane: dict[int, list[ReservationRequest]] = defaultdict(list)
        for request in requests:
            for lane, _ in request.stop_line.lanes:
                by_lane[lane].append(request)
        for request in sorted(requests, key=lambda request: (request.since, request.id)):
            lanes = [lane for lane, _ in request.stop_line.lanes]
            waited = now - request.since
            exit = request.stop_line.exits[0][0] if request.stop_line.exits else NONE
            if exit in claimed_exits or self._is_full(request, free_length):
                if waited > _PATIENCE and exit != NONE:
                    claimed_exits.add(exit)
                continue
            if not (
                any(lane in claimed or self._is_occupied(request, lane, waited) for lane in lanes)
                or (waited < _PATIENCE and self._must_yield(request, by_lane))
            ):
                self.reserve(request.id, request.stop_line, request.length)
                granted.append(request)
            elif waited > _PATIENCE and request.distance < _AT_LINE:
                claimed.update(conflict.other for lane in lanes for conflict, _ in self._conflicts[lane])
        return granted

    def _is_occupied(self, request: ReservationRequest, lane: int, waited: float) -> bool:
        """Return whether another vehicle has reserved a lane in conflict with this one, and has not cleared the conflict.

        A vehicle that has waited for long, and whose path is free, ignores others that are stuck.
        """
        line = request.stop_line
        ignores_stuck = waited > _LONG and request.free_distance > request.distance + line.end - line.position
        return any(
            other != request.id and self._rear(other) < start + end and not (ignores_stuck and self._is_stuck(other, start))
            for conflict, end in self._conflicts[lane]
            for other, start in self._holders[conflict.other].items()
        )

    def _is_stuck(self, id: int, start: float) -> bool:
        """Return whether a vehicle has been standing for long, beyond the start of a lane of its route."""
        return self._standing_time(id) > _STUCK and self._rear(id) > start

    def _must_yield(self, request: ReservationRequest, by_lane: dict[int, list[ReservationRequest]]) -> bool:
        """Return whether a vehicle with priority asks for a lane in conflict."""
        return any(
            conflict.yields and any(other is not request for other in by_lane.get(conflict.other, ()))
            for lane, _ in request.stop_line.lanes
            for conflict, _ in self._conflicts[lane]
        )

    def _is_full(self, request: ReservationRequest, free_length: FreeLength) -> bool:
        """Return whether there is too little room for a vehicle behind the junction."""
        line = request.stop_line
        if not line.lanes or not line.exits:
            return False
        leaving = self._leaving[line.exits[0][0]]
        needed = sum(need for id, (end, need) in leaving.items() if id != request.id and self._rear(id) < end)
        return free_length(line) < needed + request.length + _GAP
