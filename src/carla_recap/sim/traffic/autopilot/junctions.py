"""How vehicles pass junctions: they ask for a reservation in time, stop without one, and release it behind the junction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.lights import GREEN
from carla_recap.sim.traffic.autopilot.acceleration import BEFORE_LINE
from carla_recap.sim.traffic.autopilot.drivers import NONE
from carla_recap.sim.traffic.autopilot.perception import UNCONTROLLED
from carla_recap.sim.traffic.autopilot.reservations import (
    JunctionRules,
    ReservationRequest,
    Reservations,
    current_junction,
    next_stop_line,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.town.town import Town
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.perception import Perception
    from carla_recap.sim.traffic.autopilot.reservations import StopLine
    from carla_recap.sim.traffic.autopilot.routes import LaneNetwork, Routes

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

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


class JunctionControl:
    """The stop lines and reservations of all drivers.

    Args:
        town: The town.
        network: Its lanes.
        drivers: The drivers; this class maintains the columns about stop lines.
        routes: Their routes.
    """

    def __init__(self, town: Town, network: LaneNetwork, drivers: Drivers, routes: Routes) -> None:
        self._network, self._drivers, self._routes = network, drivers, routes
        self._rules = JunctionRules.of(town)
        self._rows: dict[int, int] = {}
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
        for row in np.flatnonzero(drivers.has_reservation & (front > drivers.stop_line + _PASSED)).tolist():
            line = self._next[int(drivers.id[row])]
            assert line is not None
            self._passed.setdefault(int(drivers.id[row]), []).append(line)
            self._find_next(row, max(float(front[row]), line.end))
        for row in np.flatnonzero(rear > drivers.junction_end).tolist():
            id = int(drivers.id[row])
            passed = self._passed[id]
            self._reservations.release(id, passed.pop(0))
            drivers.junction_end[row] = passed[0].end if passed else np.inf

    def decide(
        self, now: float, states: Integers, speed: Floats, perception: Perception, braking: Floats, queues: QueueEnds
    ) -> None:
        """Release reservations for lights that have changed, and grant new ones.

        Args:
            now: The time in s.
            states: The states of the town's signals, and green as the last one, for `NONE`.
            speed: The speeds of the vehicles in m/s.
            perception: What the drivers perceive.
            braking: The distance from which each driver brakes for a standing obstacle, in m.
            queues: The last vehicles on the lanes.
        """
        drivers = self._drivers
        distance = drivers.stop_line - self._routes.position - self._half_length
        state = states[drivers.signal]
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
        rows = np.flatnonzero(waiting & first & ~drivers.must_stop & (state >= GREEN))
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
        for row in np.flatnonzero(drivers.has_reservation & (state < GREEN) & can_stop).tolist():
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
        drivers.signal[row] = NONE if line is None else line.signal
        drivers.must_stop[row] = line is not None and line.has_stop_sign
        if line is None:
            drivers.stop_line[row] = np.inf
        else:
            drivers.stop_line[row] = line.position if line.position > front - _PASSED else line.start

    def _locate(self) -> None:
        self._rear = (self._routes.position - self._half_length).tolist()


class QueueEnds:
    """The last vehicle on each lane.

    Args:
        network: The lanes.
        lane: The lanes of the vehicles.
        rear: The distances of their rear ends along these, in m.
        speed: Their speeds in m/s.
    """

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
