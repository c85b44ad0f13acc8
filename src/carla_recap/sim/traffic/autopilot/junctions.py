"""How drivers come through junctions: they ask for permission in time, stop without it, and give it back behind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.lights import GREEN
from carla_recap.sim.traffic.autopilot.gates import inside, next_gate, survey
from carla_recap.sim.traffic.autopilot.network import NONE
from carla_recap.sim.traffic.autopilot.permits import Permits, Request
from carla_recap.sim.traffic.autopilot.view import MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.town.town import Town
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.gates import Gate
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes
    from carla_recap.sim.traffic.autopilot.view import View

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

BEFORE_LINE: Final = 0.8  # m: so far before a line vehicles stop
_PAST: Final = 0.3  # m: who is so far beyond a line goes on
_COMFORTABLE: Final = 3.0  # m/s²: who would have to brake harder before a light that has changed goes on
_AT_SIGN: Final = 3.5  # m: so near to the line one has to have stopped
_STANDING: Final = 0.3  # m/s
_ROOM: Final = 3.0  # m more than its length: what a vehicle needs to wait between two junctions
_ASK: Final = 1.3  # so many times the distance at which a driver would begin to brake
_EARLIER: Final = 6.0  # m more than that
_FLOW: Final = 2.0  # s: for so long the last vehicle behind a junction is expected to go on as it does
_FAR: Final = 30.0  # m: nobody needs more room behind a junction


class Junctions:
    """Gates and permits of all drivers.

    Args:
        town: The town.
        network: Its lanes.
        drivers: The drivers; the columns on gates are kept by this class.
        routes: Their routes.
    """

    def __init__(self, town: Town, network: Network, drivers: Drivers, routes: Routes) -> None:
        self._network, self._drivers, self._routes = network, drivers, routes
        self._crossings = survey(town)
        self._rows: dict[int, int] = {}
        self._half = np.empty(0)
        self._rear: list[float] = []
        self._permits = Permits(
            self._crossings,
            lambda id: self._rear[self._rows[id]],
            lambda id: float(drivers.stood[self._rows[id]]),
        )
        self._gates: dict[int, Gate | None] = {}
        self._held: dict[int, list[Gate]] = {}

    def set_drivers(self, half_length: Floats) -> None:
        """Note that there are other drivers, or in another order, and half the lengths of their vehicles, in m."""
        self._rows = {id: row for row, id in enumerate(self._drivers.id.tolist())}
        self._half = half_length
        self._locate()

    def enter(self, row: int) -> None:
        """Begin with a driver, or anew after its route has changed."""
        id, along, half = int(self._drivers.id[row]), float(self._routes.along[row]), float(self._half[row])
        self.leave(id)
        self._locate()
        gate = inside(self._network, self._routes, row, along - half, along + half)
        if gate is not None:
            self._permits.hold(id, gate, 2 * half)
            self._held[id] = [gate]
        self._look_ahead(row, along + half)

    def leave(self, id: int) -> None:
        """Forget a driver."""
        for gate in self._held.pop(id, []):
            self._permits.release(id, gate)
        coming = self._gates.pop(id, None)
        if coming is not None:
            self._permits.release(id, coming)

    def pass_on(self) -> None:
        """Move the vehicles that have passed a line, or left a junction, on to what comes next."""
        drivers, along = self._drivers, self._routes.along
        self._locate()
        front, rear = along + self._half, along - self._half
        for row in np.flatnonzero(drivers.permitted & (front > drivers.line + _PAST)).tolist():
            gate = self._gates[int(drivers.id[row])]
            assert gate is not None
            self._held.setdefault(int(drivers.id[row]), []).append(gate)
            self._look_ahead(row, max(float(front[row]), gate.leave))
        for row in np.flatnonzero(rear > drivers.clear_at).tolist():
            id = int(drivers.id[row])
            held = self._held[id]
            self._permits.release(id, held.pop(0))
            drivers.clear_at[row] = held[0].leave if held else np.inf

    def decide(self, now: float, states: Integers, speed: Floats, view: View, braking: Floats, tails: Tails) -> None:
        """Take back permits for lights that have changed, and give new ones.

        Args:
            now: In s.
            states: Of the signals, and behind them green, for where there is none.
            speed: Of the vehicles, in m/s.
            view: What the drivers see.
            braking: From which distance each driver brakes before something that stands, in m.
            tails: The last vehicles on the lanes.
        """
        drivers = self._drivers
        distance = drivers.line - self._routes.along - self._half
        state = states[drivers.light]
        self._revoke(state, distance, speed)
        waiting = ~drivers.permitted & (distance < _ASK * braking + _EARLIER) & ~drivers.lost
        arrived = waiting & drivers.must_stop & (distance < _AT_SIGN) & (speed < _STANDING)
        drivers.must_stop[arrived] = False
        leader = np.maximum(view.leader, 0)
        leading = drivers.permitted[leader] | (view.free + 2 * self._half[leader] > distance)
        ahead = np.where(view.leader >= 0, leading, view.leader == MOVING)
        first = ahead | (view.free > distance - BEFORE_LINE)
        able = waiting & first & ~drivers.must_stop & (state >= GREEN)
        rows = np.flatnonzero(able)
        if not len(rows):
            return
        drivers.since[rows] = np.minimum(drivers.since[rows], now)
        requests = []
        for row in rows.tolist():
            gate = self._gates[int(drivers.id[row])]
            assert gate is not None
            id, length = int(drivers.id[row]), 2 * float(self._half[row])
            requests.append(
                Request(id, gate, float(drivers.since[row]), float(distance[row]), length, float(view.free[row]))
            )
        for request in self._permits.grant(requests, now, tails.room):
            drivers.permitted[self._rows[request.id]] = True

    def _revoke(self, state: Integers, distance: Floats, speed: Floats) -> None:
        drivers = self._drivers
        stoppable = speed**2 < 2 * _COMFORTABLE * np.maximum(distance - BEFORE_LINE, 0)
        for row in np.flatnonzero(drivers.permitted & (state < GREEN) & stoppable).tolist():
            gate = self._gates[int(drivers.id[row])]
            assert gate is not None
            self._permits.release(int(drivers.id[row]), gate)
            drivers.permitted[row] = False
            drivers.since[row] = np.inf

    def look_farther(self, row: int) -> None:
        """Look anew for the next gate of a driver who has not asked for it yet: more of the route is known."""
        if not self._drivers.permitted[row] and np.isinf(self._drivers.since[row]):
            held = self._held.get(int(self._drivers.id[row]))
            front = float(self._routes.along[row] + self._half[row])
            self._look_ahead(row, max(front, held[-1].leave) if held else front)

    def _look_ahead(self, row: int, front: float) -> None:
        """Find the next gate of a driver."""
        drivers, id = self._drivers, int(self._drivers.id[row])
        gate = next_gate(self._network, self._crossings, self._routes, row, front, 2 * float(self._half[row]) + _ROOM)
        self._gates[id] = gate
        held = self._held.get(id)
        drivers.clear_at[row] = held[0].leave if held else np.inf
        drivers.permitted[row], drivers.since[row] = False, np.inf
        drivers.line[row] = np.inf if gate is None else gate.line if gate.line > front - _PAST else gate.begin
        drivers.light[row] = NONE if gate is None else gate.light
        drivers.must_stop[row] = gate is not None and gate.stop_sign

    def _locate(self) -> None:
        self._rear = (self._routes.along - self._half).tolist()


class Tails:
    """The last vehicle on each lane.

    Args:
        network: The lanes.
        lane: The lanes that vehicles are on.
        rear: How far along these their rear ends are.
        speed: Their speeds in m/s.
    """

    def __init__(self, network: Network, lane: Integers, rear: Floats, speed: Floats) -> None:
        order = np.lexsort((rear, lane))[::-1]
        self._network = network
        self._last = dict(zip(lane[order].tolist(), (rear + _FLOW * speed)[order].tolist(), strict=True))

    def room(self, gate: Gate) -> float:
        """How much room there is behind a gate, or soon will be, in m."""
        for lane, start in gate.exits:
            if lane in self._last:
                return float(start - gate.leave + self._last[lane])
            if self._network.junction[lane] != NONE or start - gate.leave > _FAR:
                return max(start - gate.leave, 0.0)
        return _FAR
