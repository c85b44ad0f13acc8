"""How vehicles pass junctions: they ask for a reservation in time, stop without one, and release it behind the junction.

Reservations are given at the stop lines on routes, by signs, priority and order of arrival.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.signals import GREEN
from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.traffic.autopilot.controls import BEFORE_LINE
from carla_recap.sim.traffic.autopilot.drivers import NONE
from carla_recap.sim.traffic.autopilot.perception import UNCONTROLLED

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.sim.town.junctions import Conflict
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.perception import Perception
    from carla_recap.sim.traffic.autopilot.routes import LaneNetwork, Routes
    from carla_recap.util.arrays import Floats, Integers

    FreeLength = Callable[["StopLine"], float]

_PASSED: Final = 0.3  # m beyond a line, from where on a vehicle goes on
_COMFORTABLE: Final = 3.0  # m/s²: vehicles that would have to brake harder for a light that has changed go on
_REACTION: Final = 0.3  # s until vehicles brake for it
_AT_SIGN: Final = 3.5  # m before the line of a stop sign, where vehicles have to have stopped
_STANDING: Final = 0.3  # m/s
_ROOM: Final = 3.0  # m that a vehicle needs to wait between two junctions, in addition to its length
_REQUEST: Final = 1.3  # distance of a request, as a multiple of that at which a vehicle would begin to brake
_REQUEST_MARGIN: Final = 6.0  # m in addition to that
_FLOW: Final = 2.0  # s for which the last vehicle behind a junction is expected to go on at its speed
_FAR: Final = 30.0  # m: no vehicle needs more room behind a junction
_MAX_SETBACK: Final = 15.0  # m: a stop line stands no farther before the junction that it is for
_BEHIND_LINE: Final = 1.0  # m beyond a line, from where on a vehicle has passed it
_PATIENCE: Final = 4.0  # s: vehicles that wait longer no longer let others go first
_LONG: Final = 20.0  # s: vehicles that wait longer go when the path is free, even if others that are stuck have reservations
_STUCK: Final = 10.0  # s of standing in a junction, from which on a vehicle counts as stuck
_AT_LINE: Final = 12.0  # m before a line, where vehicles count as waiting there
_GAP: Final = 2.0  # m between standing vehicles
_SPARE: Final = 1.0  # m less room between two junctions that is enough to wait for a light; a length and the gap are left


class JunctionControl:
    """The stop lines and reservations of all drivers; it maintains the columns of drivers about stop lines."""

    def __init__(self, town: Town, network: LaneNetwork, drivers: Drivers, routes: Routes) -> None:
        self._network, self._drivers, self._routes = network, drivers, routes
        self._rules = JunctionRules.of(town)
        self._rows: dict[int, int] = {}
        lights = {lights for lines in self._rules.midblock_lights.values() for _, lights in lines}
        groups = [*sorted(lights | {*self._rules.lights.values()}), ()]  # what stands for none is the last one
        most = max(1, *map(len, groups))
        self._number_of = {group: number for number, group in enumerate(groups)}
        self._lights = np.array([[*group, *[NONE] * (most - len(group))] for group in groups])
        self._half_length = np.empty(0)
        self._rear: list[float] = []
        self._reservations = Reservations(
            self._rules,
            lambda id: self._rear[self._rows[id]],
            lambda id: float(drivers.standing_time[self._rows[id]]),
        )
        self._next: dict[int, StopLine | None] = {}
        self._passed: dict[int, list[StopLine]] = {}

    def set_drivers(self, half_length: Floats) -> None:
        """Adopt a new order of the drivers, and half of the lengths of their vehicles in m."""
        self._rows = {id: row for row, id in enumerate(self._drivers.id.tolist())}
        self._half_length = half_length
        self._locate()

    def enter(self, row: int) -> None:
        """Begin with a driver, or again after its route has changed."""
        id, position = int(self._drivers.id[row]), float(self._routes.position[row])
        half = float(self._half_length[row])
        self.leave(id)
        self._locate()
        line = current_junction(self._network, self._routes, row, position - half, position + half)
        if line is not None:
            self._reservations.reserve(id, line, 2 * half)
            self._passed[id] = [line]
        self._find_next(row, position + half)

    def leave(self, id: int) -> None:
        """Release the reservations of a driver."""
        for line in (*self._passed.pop(id, []), self._next.pop(id, None)):
            if line is not None:
                self._reservations.release(id, line)

    def update_passed(self) -> None:
        """Find the next stop lines of vehicles that have passed one, and release the junctions that vehicles have left."""
        drivers, position = self._drivers, self._routes.position
        self._locate()
        front, rear = position + self._half_length, position - self._half_length
        for row in (drivers.has_reservation & (front > drivers.stop_line + _PASSED)).nonzero()[0].tolist():
            line = self._next[int(drivers.id[row])]
            assert line is not None
            self._passed.setdefault(int(drivers.id[row]), []).append(line)
            self._find_next(row, max(float(front[row]), line.end))
        for row in (rear > drivers.junction_end).nonzero()[0].tolist():
            id = int(drivers.id[row])
            passed = self._passed[id]
            self._reservations.release(id, passed.pop(0))
            drivers.junction_end[row] = passed[0].end if passed else np.inf

    def decide(
        self, now: float, states: Integers, speed: Floats, perception: Perception, braking: Floats, queues: QueueEnds
    ) -> None:
        """Release reservations for lights that have changed, and grant new ones.

        The states are those of the town's signals, and green as the last one, for `NONE`; each driver brakes for a standing
        obstacle from a distance in m.
        """
        drivers = self._drivers
        distance = drivers.stop_line - self._routes.position - self._half_length
        state = states[self._lights[drivers.lights]].min(axis=1)
        self._revoke(state, distance, speed)
        near = distance < _REQUEST * braking + _REQUEST_MARGIN
        waiting = ~drivers.has_reservation & near & ~drivers.off_road
        stopped = waiting & drivers.must_stop & (distance < _AT_SIGN) & (speed < _STANDING)
        drivers.must_stop[stopped] = False
        leader = np.maximum(perception.leader, 0)
        leader_goes = drivers.has_reservation[leader]
        leader_goes |= perception.free_distance + 2 * self._half_length[leader] > distance
        first = np.where(perception.leader >= 0, leader_goes, perception.leader == UNCONTROLLED)
        first |= perception.free_distance > distance - BEFORE_LINE
        rows = (waiting & first & ~drivers.must_stop & (state >= GREEN)).nonzero()[0]
        if not len(rows):
            return
        drivers.waiting_since[rows] = np.minimum(drivers.waiting_since[rows], now)
        requests = []
        for row in rows.tolist():
            id, length = int(drivers.id[row]), 2 * float(self._half_length[row])
            line, since = self._next[id], float(drivers.waiting_since[row])
            assert line is not None
            free = float(perception.free_distance[row])
            requests.append(ReservationRequest(id, line, since, float(distance[row]), length, free))
        for request in self._reservations.grant(requests, now, queues.free_length):
            drivers.has_reservation[self._rows[request.id]] = True

    def _revoke(self, state: Integers, distance: Floats, speed: Floats) -> None:
        drivers = self._drivers
        before = np.minimum(BEFORE_LINE, _REACTION * speed)  # so that those that stand right at the line wait, too
        can_stop = speed**2 < 2 * _COMFORTABLE * np.maximum(distance - before, 0)
        can_stop |= (speed < _STANDING) & (distance > 0)
        for row in (drivers.has_reservation & (state < GREEN) & can_stop).nonzero()[0].tolist():
            line = self._next[int(drivers.id[row])]
            assert line is not None
            self._reservations.release(int(drivers.id[row]), line)
            drivers.has_reservation[row] = False
            drivers.waiting_since[row] = np.inf

    def update_next(self, row: int) -> None:
        """Find the next stop line of a driver again, unless it has asked to pass it: the route was extended."""
        if not self._drivers.has_reservation[row] and np.isinf(self._drivers.waiting_since[row]):
            passed = self._passed.get(int(self._drivers.id[row]))
            front = float(self._routes.position[row] + self._half_length[row])
            self._find_next(row, max(front, passed[-1].end) if passed else front)

    def _find_next(self, row: int, front: float) -> None:
        """Find the next stop line of a driver."""
        drivers, id = self._drivers, int(self._drivers.id[row])
        room = 2 * float(self._half_length[row]) + _ROOM
        line = next_stop_line(self._network, self._rules, self._routes, row, front, room)
        self._next[id] = line
        passed = self._passed.get(id)
        drivers.junction_end[row] = passed[0].end if passed else np.inf
        drivers.has_reservation[row], drivers.waiting_since[row] = False, np.inf
        drivers.lights[row] = self._number_of[() if line is None else line.lights]
        drivers.must_stop[row] = line is not None and line.has_stop_sign
        if line is None:
            drivers.stop_line[row] = np.inf
        else:
            drivers.stop_line[row] = line.position if line.position > front - _PASSED else line.start

    def _locate(self) -> None:
        self._rear = (self._routes.position - self._half_length).tolist()


class QueueEnds:
    """The last vehicle on each lane, by the distances of rear ends along lanes in m and their speeds in m/s."""

    def __init__(self, network: LaneNetwork, lane: Integers, rear: Floats, speed: Floats) -> None:
        order = np.lexsort((rear, lane))[::-1]
        self._network = network
        self._last = dict(zip(lane[order].tolist(), (rear + _FLOW * speed)[order].tolist(), strict=True))

    def free_length(self, line: StopLine) -> float:
        """Return the length behind the junction of a stop line that is free, or soon will be, in m."""
        for lane, start in line.exits:
            if lane in self._last:
                return float(start - line.end + self._last[lane])
            if self._network.junction[lane] != NONE or start - line.end > _FAR:
                return max(start - line.end, 0.0)
        return _FAR


@dataclass(frozen=True)
class StopLine:
    """A position on a route that is passed with a reservation only; all positions are along the route, in m.

    Attributes:
        position: The position of the line.
        lanes: The lanes through the junction behind it, with their starts; empty behind a light between junctions.
        end: The end of the last of these lanes; a bit behind the line, if there are none.
        exits: The lanes of the route from there on, with their starts.
        lights: The indices of the lights that are in force there; the strictest acts.
        has_stop_sign: Whether vehicles have to stop at the line.
    """

    position: float
    lanes: tuple[tuple[int, float], ...]
    end: float
    exits: tuple[tuple[int, float], ...]
    lights: tuple[int, ...] = ()
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
        midblock_lights: The distances of stop lines between junctions, ascending, with their lights.
    """

    conflicts: list[list[tuple[Conflict, float]]]
    lights: dict[int, tuple[int, ...]] = field(default_factory=dict)
    stop_signs: dict[int, int] = field(default_factory=dict)
    lines: dict[tuple[int, int], float] = field(default_factory=dict)
    midblock_lights: dict[int, list[tuple[float, tuple[int, ...]]]] = field(default_factory=dict)

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
            rules.lines.update({(signal.index, lane): s for lane, s in signal.stops})
            if signal.kind is SignalKind.STOP:
                rules.stop_signs.update((lane, signal.index) for lane in signal.governs)
                continue
            for lane in signal.governs:
                rules.lights[lane] = (*rules.lights.get(lane, ()), signal.index)
            for lane, s in signal.stops:
                if set(town.lanes[lane].successors) & set(signal.governs):
                    continue
                lines = dict(rules.midblock_lights.get(lane, ()))
                lines[s] = (*lines.get(s, ()), signal.index)
                rules.midblock_lights[lane] = sorted(lines.items())
        return rules


def next_stop_line(
    network: LaneNetwork, rules: JunctionRules, routes: Routes, row: int, front: float, room: float
) -> StopLine | None:
    """Return the next stop line of a route beyond the front end of a vehicle, if there is one.

    The room is the least length between two junctions in which the vehicle can wait, in m.
    """
    used = int((routes.lanes[row] != NONE).sum())
    lanes: list[int] = routes.lanes[row, :used].tolist()
    starts: list[float] = routes.starts[row, :used].tolist()
    for number, (lane, start) in enumerate(zip(lanes, starts, strict=True)):
        for s, lights in rules.midblock_lights.get(lane, ()):
            if start + s > front - _BEHIND_LINE:
                return StopLine(start + s, (), start + s + _BEHIND_LINE, (), lights)
        if network.junction[lane] != NONE and start > front - _BEHIND_LINE:
            return _before_junction(network, rules, lanes, starts, number, room)
    return None


def current_junction(network: LaneNetwork, routes: Routes, row: int, rear: float, front: float) -> StopLine | None:
    """Return the stop line before the junction that a vehicle is in, if it is in one."""
    used = int((routes.lanes[row] != NONE).sum())
    lanes, starts = routes.lanes[row, :used].tolist(), routes.starts[row, : used + 1].tolist()
    through = tuple(
        (lane, start)
        for lane, start, end in zip(lanes, starts, starts[1:], strict=False)
        if network.junction[lane] != NONE and start <= front - _BEHIND_LINE and end > rear
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
        if network.junction[lanes[index]] == NONE:
            continue
        spare = _SPARE if lanes[index] in rules.lights else 0.0  # so that few drive on to the light behind both
        if starts[index] - end >= room - spare:
            break
        through.append((lanes[index], starts[index]))
        end, after = starts[index] + float(network.length[lanes[index]]), index + 1
    lights = rules.lights.get(entry, ())
    sign = rules.stop_signs.get(entry, NONE)
    position = begin
    for back in range(number - 1, -1, -1):
        if begin - starts[back + 1] > _MAX_SETBACK:
            break
        for signal in (*lights, sign):
            s = rules.lines.get((signal, lanes[back]))
            if s is not None and begin - starts[back] - s <= _MAX_SETBACK:
                position = min(position, starts[back] + s)
    exits = tuple(zip(lanes[after:], starts[after:], strict=True))
    return StopLine(position, tuple(through), end, exits, lights, sign != NONE)


@dataclass
class ReservationRequest:
    """A vehicle that asks to pass its stop line, since a time in s.

    The distance is that from its front end to the line, and the free one that to the nearest obstacle on its path, in m.
    """

    id: int
    stop_line: StopLine
    since: float
    distance: float
    length: float
    free_distance: float


class Reservations:
    """The reservations of lanes through junctions, by the rear ends of vehicles along their routes in m."""

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
        """Decide which vehicles get a reservation at a time in s, reserve, and return the requests that are granted.

        The vehicles are considered in the order in which they first asked. One that has to wait holds up no others at first,
        so that a junction is used as long as any path through it is free. After `_PATIENCE`, it no longer yields to vehicles
        with priority, and those that asked later no longer go before it: once it is at its line, they get no lane that is in
        conflict with its own lanes; where its exit is full, they get no room there. So each vehicle gets its turn.
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
