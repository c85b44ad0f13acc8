"""The autopilot: drives all vehicles that have it switched on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.signals import GREEN
from carla_recap.sim.traffic.autopilot.controls import desired_acceleration, set_lights, set_pedals, set_steering, wrap_angle
from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
from carla_recap.sim.traffic.autopilot.junctions import JunctionControl, QueueEnds
from carla_recap.sim.traffic.autopilot.perception import ObstacleTracker, perceive
from carla_recap.sim.traffic.autopilot.routes import (
    AutopilotState,
    LaneNetwork,
    Routes,
    lane_changes,
    lateral_offset,
    start_transition,
    transition_progress,
)

if TYPE_CHECKING:
    from carla_recap.sim.episode import Episode
    from carla_recap.sim.traffic.autopilot.perception import Perception
    from carla_recap.util.arrays import Booleans, Floats, Integers


_DECISION_INTERVAL: Final = 0.1  # s between two decisions of the drivers
_STRAY: Final = 4.0  # m off its route, from where on a vehicle begins a new one
_OFF_ROAD: Final = 40.0  # m from every lane, from where on a vehicle does not drive
_SEARCH_INTERVAL: Final = 1.0  # s between two attempts to find a lane
_ON_LANE: Final = 2.2  # m from the centre of a lane: vehicles farther away are not on it
_MAX_ANGLE: Final = 1.2  # radians to the direction of the lane, at the start of a transition


class Autopilot:
    """Drives the vehicles that have it switched on, as long as physics moves them; a controller of the world.

    The episode's random generator chooses the routes and the characteristics of the drivers.

    A vehicle that has it switched on while it drives goes on from its place and at its speed.
    """

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        self._random = episode.random
        self._town = episode.town
        self._clock = episode.clock
        self._network = LaneNetwork(self._town)
        self._tracker = ObstacleTracker(episode)
        self._drivers = Drivers()
        self._routes = Routes(self._network, episode.random)
        self._junctions = JunctionControl(self._town, self._network, self._drivers, self._routes)
        self._desired: Floats | None = None
        self._decided = 0.0
        self._decisions = 0

    def step(self, delta: float) -> None:
        """Set the controls and lights of all driven vehicles for the time until the next step, in s."""
        elapsed, drivers, vehicles = self._clock.elapsed, self._drivers, self._episode.vehicles
        rows = self._driven().nonzero()[0]
        if not np.array_equal(vehicles.id[rows], drivers.id):
            self._change_drivers(rows)
        if not len(rows):
            return
        cars = DrivenVehicles.of(vehicles, rows)
        self._update_routes(cars, delta)
        state = AutopilotState(cars, drivers, self._routes, self._network, vehicles)
        if self._desired is None or elapsed + delta / 2 >= self._decided + _DECISION_INTERVAL:
            perception = self._decide(state)
            self._desired, self._decided = desired_acceleration(state, perception), elapsed
            set_lights(state)
        set_pedals(state, self._desired, delta)
        set_steering(state)

    def _driven(self) -> Booleans:
        vehicles = self._episode.vehicles
        driven: Booleans = vehicles.autopilot & vehicles.simulated
        return driven

    def _change_drivers(self, rows: Integers) -> None:
        """Add and remove drivers, so that there is one for each of these vehicles, in their order."""
        drivers, routes = self._drivers, self._routes
        ids: list[int] = self._episode.vehicles.id[rows].tolist()
        driver = {id: number for number, id in enumerate(drivers.id.tolist())}
        new = [number for number, id in enumerate(ids) if id not in driver]
        present = set(ids)
        for id in [id for id in driver if id not in present]:
            self._junctions.leave(id)
        for number in new:
            driver[ids[number]] = len(drivers)
            drivers.add(ids[number], self._random)
            routes.add()
        order = np.array([driver[id] for id in ids], np.int64)
        drivers.select(order)
        routes.select(order)
        cars = DrivenVehicles.of(self._episode.vehicles, rows)
        self._junctions.set_drivers(cars.half_length)
        for number in new:
            self._start(cars, number)
        self._desired = None

    def _start(self, cars: DrivenVehicles, row: int) -> None:
        """Start to drive a vehicle from its place, on the nearest lane."""
        z = float(self._episode.vehicles.position[cars.rows[row], 2])
        lane, s = self._network.nearest(float(cars.x[row]), float(cars.y[row]), z, float(cars.yaw[row]))
        self._take_lane(cars, row, lane, s)
        distance = abs(float(self._drivers.lateral_offset[row]))
        self._drivers.returning[row], self._drivers.off_road[row] = distance > _ON_LANE, distance > _OFF_ROAD

    def _change_lane(self, cars: DrivenVehicles, row: int, lane: int) -> None:
        """Drive on an adjacent lane from now on."""
        hint = self._routes.position[row] - self._routes.starts[row, 0]
        s, _ = self._town.project([lane], [cars.x[row]], [cars.y[row]], [hint])
        self._take_lane(cars, row, lane, float(np.clip(s[0], 0, self._network.length[lane])))

    def _take_lane(self, cars: DrivenVehicles, row: int, lane: int, s: float) -> None:
        """Drive on a lane from now on, from the distance along it that is nearest to the vehicle."""
        drivers, position = self._drivers, float(self._routes.position[row])
        self._routes.restart(row, lane, s)
        pose = self._network.poses(self._network.points(np.array([lane]), np.array([s])))
        x, y, heading = (float(column[0]) for column in pose)
        away_x, away_y = float(cars.x[row]) - x, float(cars.y[row]) - y
        offset = away_y * np.cos(heading) - away_x * np.sin(heading)
        angle = float(np.clip(wrap_angle(cars.yaw[row] - heading), -_MAX_ANGLE, _MAX_ANGLE))
        drivers.lateral_offset[row], drivers.returning[row] = offset, False
        start_transition(drivers, row, position, float(cars.speed[row]), offset, float(np.tan(angle)))
        self._junctions.enter(row)

    def _update_routes(self, cars: DrivenVehicles, delta: float) -> None:
        """Update the positions of the vehicles along their routes, and start anew with those that have left theirs."""
        drivers, routes, network = self._drivers, self._routes, self._network
        guess = cars.speed * delta
        lane, s = routes.locate(guess[:, None])
        x, y, heading = network.poses(network.points(lane[:, 0], s[:, 0]))
        cos, sin = np.cos(heading), np.sin(heading)
        away_x, away_y = cars.x - x, cars.y - y
        ahead = away_x * cos + away_y * sin
        drivers.lateral_offset = away_y * cos - away_x * sin
        position = np.minimum(routes.position + guess + np.clip(ahead, -_STRAY, _STRAY), routes.ends)
        for row in routes.advance(position).tolist():
            self._junctions.update_next(row)
        self._junctions.update_passed()
        progress = transition_progress(drivers, routes.position)
        expected = lateral_offset(drivers.transition_offset, drivers.transition_slope, progress)
        stray = (np.abs(ahead) > _STRAY) | (np.abs(drivers.lateral_offset - expected) > _STRAY)
        searching = self._clock.elapsed % _SEARCH_INTERVAL < delta
        for row in np.where(drivers.off_road, searching, stray).nonzero()[0].tolist():
            self._start(cars, row)

    def _decide(self, state: AutopilotState) -> Perception:
        """Decide which vehicles pass their stop lines, and which change lanes; return what the drivers perceive."""
        cars, drivers, signals = state.cars, state.drivers, self._episode.signals
        driven = self._driven()
        self._decisions += 1
        perception = perceive(state, self._tracker.obstacles(driven))
        states = np.full(len(self._town.signals) + 1, GREEN)
        states[signals.signal] = signals.state
        braking = drivers.desired_gap(cars.speed, cars.speed)
        queues = self._queue_ends(cars, driven)
        self._junctions.decide(self._clock.elapsed, states, cars.speed, perception, braking, queues)
        leader = perception.free_distance, perception.leader_speed
        for row, lane in list(lane_changes(state, leader, self._decisions)):
            self._change_lane(cars, row, lane)
        return perception

    def _queue_ends(self, cars: DrivenVehicles, driven: Booleans) -> QueueEnds:
        """Return the last vehicles on the lanes, driven by the autopilot or not."""
        routes, vehicles, others = self._routes, self._episode.vehicles, (~driven).nonzero()[0]
        lane, s = routes.lanes[:, 0], routes.position - routes.starts[:, 0]
        speed, half = cars.speed, cars.half_length
        if len(others):
            (x, y, z), yaw = vehicles.position[others].T, np.radians(vehicles.rotation[others, 1])
            near, along = self._town.nearest_lane(x, y, z=z if self._town.index.has_levels else None, heading=yaw)
            points = self._network.points(near, along)
            lane_x, lane_y, _ = self._network.poses(points)
            on_lane = np.hypot(x - lane_x, y - lane_y) < _ON_LANE
            on_lane &= np.abs(z - self._network.height[points[0]]) < _ON_LANE
            others = others[on_lane]
            lane, s = np.concatenate((lane, near[on_lane])), np.concatenate((s, along[on_lane]))
            speed = np.concatenate((speed, vehicles.speed[others]))
            half = np.concatenate((half, vehicles.half_length[others]))
        return QueueEnds(self._network, lane, s - half, speed)
