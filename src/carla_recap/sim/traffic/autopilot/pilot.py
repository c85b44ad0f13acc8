"""The autopilot: drives all vehicles that have it switched on, at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.lights import GREEN
from carla_recap.sim.traffic.autopilot import drift
from carla_recap.sim.traffic.autopilot.cars import find
from carla_recap.sim.traffic.autopilot.drivers import Drivers
from carla_recap.sim.traffic.autopilot.following import wanted_gap
from carla_recap.sim.traffic.autopilot.handling import indicate, press, turn_wheel
from carla_recap.sim.traffic.autopilot.junctions import Junctions, Tails
from carla_recap.sim.traffic.autopilot.network import Network
from carla_recap.sim.traffic.autopilot.overtaking import lane_changes
from carla_recap.sim.traffic.autopilot.routes import Routes
from carla_recap.sim.traffic.autopilot.speeds import wishes
from carla_recap.sim.traffic.autopilot.steering import wrap
from carla_recap.sim.traffic.autopilot.surroundings import Surroundings
from carla_recap.sim.traffic.autopilot.view import see

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.actors.registry import ActorRegistry
    from carla_recap.sim.traffic.autopilot.cars import Cars
    from carla_recap.sim.traffic.autopilot.view import View

    Flags = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_REACTION: Final = 0.1  # s: so often drivers look; in between they do what follows from that
_STRAY: Final = 4.0  # m: who is farther from where its route has it begins a new one
_REACH: Final = 40.0  # m: who is farther from every lane stays where it is
_SEARCH: Final = 1.0  # s: between two attempts to find a lane
_BESIDE: Final = 2.2  # m: who is farther from the middle of every lane is not on the road
_STEEPEST: Final = 1.2  # radians: who heads farther away from the direction of its lane turns as hard as that


class Autopilot:
    """Drives the vehicles of a world that have `autopilot` switched on, as long as physics moves them.

    Whoever has it switched on while it drives goes on from where it is, at the speed that it has.

    Args:
        registry: The actors.
        random: What chooses the ways and the characters of the drivers.
    """

    def __init__(self, registry: ActorRegistry, random: np.random.Generator) -> None:
        self._registry = registry
        self._random = random
        self._town = registry.town
        self._clock = registry.clock
        self._network = Network(self._town)
        self._surroundings = Surroundings(registry)
        self._drivers = Drivers()
        self._routes = Routes(self._network, random)
        self._junctions = Junctions(self._town, self._network, self._drivers, self._routes)
        self._wishes: Floats | None = None
        self._looked = 0.0
        self._looks = 0

    def step(self, delta: float) -> None:
        """Set the controls and lights of all vehicles that are driven.

        Args:
            delta: The time until the next step, in s.
        """
        clock, drivers, routes, network = self._clock, self._drivers, self._routes, self._network
        vehicles = self._registry.vehicles
        rows = np.flatnonzero(self._driven())
        if not np.array_equal(vehicles.id[rows], drivers.id):
            self._change_drivers(rows)
        if not len(rows):
            return
        cars = find(vehicles, rows)
        self._follow(cars, delta)
        if self._wishes is None or clock.elapsed + delta / 2 >= self._looked + _REACTION:
            self._wishes, self._looked = wishes(cars, self._look(cars), drivers, routes, network), clock.elapsed
            indicate(cars, drivers, routes, network, vehicles)
        press(cars, drivers, vehicles, self._wishes, delta)
        turn_wheel(cars, drivers, routes, network, vehicles)

    def _driven(self) -> Flags:
        vehicles = self._registry.vehicles
        driven: Flags = vehicles.autopilot & vehicles.simulated
        return driven

    def _change_drivers(self, rows: Integers) -> None:
        """Let drivers come and go, so that they are those of some vehicles, in their order."""
        drivers, routes = self._drivers, self._routes
        ids: list[int] = self._registry.vehicles.id[rows].tolist()
        place = {id: number for number, id in enumerate(drivers.id.tolist())}
        new = [number for number, id in enumerate(ids) if id not in place]
        for id in [id for id in place if id not in set(ids)]:
            self._junctions.leave(id)
        for number in new:
            place[ids[number]] = len(drivers)
            drivers.add(ids[number], self._random)
            routes.add()
        order = np.array([place[id] for id in ids], np.int64)
        drivers.choose(order)
        routes.choose(order)
        cars = find(self._registry.vehicles, rows)
        self._junctions.set_drivers(cars.half_length)
        for number in new:
            self._begin(cars, number)
        self._wishes = None

    def _begin(self, cars: Cars, row: int) -> None:
        """Begin to drive a vehicle from where it is, on the nearest lane."""
        z = float(self._registry.vehicles.position[cars.rows[row], 2])
        lane, s = self._network.nearest(float(cars.x[row]), float(cars.y[row]), z, float(cars.yaw[row]))
        self._take_lane(cars, row, lane, s)
        away = abs(float(self._drivers.beside[row]))
        self._drivers.cautious[row], self._drivers.lost[row] = away > _BESIDE, away > _REACH

    def _change_lane(self, cars: Cars, row: int, lane: int) -> None:
        """Drive on another lane, beside the present one."""
        hint = self._routes.along[row] - self._routes.starts[row, 0]
        s, _ = self._town.project([lane], [cars.x[row]], [cars.y[row]], [hint])
        self._take_lane(cars, row, lane, float(np.clip(s[0], 0, self._network.length[lane])))

    def _take_lane(self, cars: Cars, row: int, lane: int, s: float) -> None:
        """Drive on a lane from now on, from a place along it that is beside the vehicle."""
        self._routes.begin(row, lane, s)
        place = self._network.places(self._network.spot(np.array([lane]), np.array([s])))
        x, y, heading = (float(column[0]) for column in place)
        away_x, away_y = float(cars.x[row]) - x, float(cars.y[row]) - y
        beside = away_y * np.cos(heading) - away_x * np.sin(heading)
        angle = float(np.clip(wrap(cars.yaw[row] - heading), -_STEEPEST, _STEEPEST))
        self._drivers.beside[row], self._drivers.cautious[row] = beside, False
        drift.begin_drift(
            self._drivers, row, float(self._routes.along[row]), float(cars.speed[row]), beside, float(np.tan(angle))
        )
        self._junctions.enter(row)

    def _follow(self, cars: Cars, delta: float) -> None:
        """Find out how far the vehicles have come, and who has left its way."""
        drivers, routes, network = self._drivers, self._routes, self._network
        guess = cars.speed * delta
        lane, s = routes.locate(guess[:, None])
        x, y, heading = network.places(network.spot(lane[:, 0], s[:, 0]))
        cos, sin = np.cos(heading), np.sin(heading)
        away_x, away_y = cars.x - x, cars.y - y
        ahead = away_x * cos + away_y * sin
        drivers.beside = away_y * cos - away_x * sin
        for row in routes.move(np.minimum(routes.along + guess + np.clip(ahead, -_STRAY, _STRAY), routes.ends)).tolist():
            self._junctions.look_farther(row)
        self._junctions.pass_on()
        expected = drift.aside(drivers.offset, drivers.slope, drift.share(drivers, routes.along))
        stray = (np.abs(ahead) > _STRAY) | (np.abs(drivers.beside - expected) > _STRAY)
        searching = self._clock.elapsed % _SEARCH < delta
        for row in np.flatnonzero(np.where(drivers.lost, searching, stray)).tolist():
            self._begin(cars, row)

    def _look(self, cars: Cars) -> View:
        """Look ahead, and decide what follows: who goes through which junction, and who changes lanes."""
        registry, drivers, routes, network = self._registry, self._drivers, self._routes, self._network
        driven = self._driven()
        self._looks += 1
        view = see(cars, drivers, routes, network, self._surroundings.boxes(driven))
        states = np.full(len(self._town.signals) + 1, GREEN)
        states[registry.signals.signal] = registry.signals.state
        braking = wanted_gap(cars.speed, cars.speed, drivers)
        self._junctions.decide(self._clock.elapsed, states, cars.speed, view, braking, self._tails(cars, driven))
        changes = lane_changes(cars, view, drivers, routes, network, registry.vehicles, self._looks)
        for row, lane in list(changes):
            self._change_lane(cars, row, lane)
        return view

    def _tails(self, cars: Cars, driven: Flags) -> Tails:
        """The last vehicles on the lanes, whoever drives them."""
        routes, vehicles, others = self._routes, self._registry.vehicles, np.flatnonzero(~driven)
        lane, s = routes.lanes[:, 0], routes.along - routes.starts[:, 0]
        speed, half = cars.speed, cars.half_length
        if len(others):
            (x, y, z), yaw = vehicles.position[others].T, np.radians(vehicles.rotation[others, 1])
            near, place = self._town.nearest_lane(x, y, z=z, heading=yaw)
            spot = self._network.spot(near, place)
            at_x, at_y, _ = self._network.places(spot)
            there = np.hypot(x - at_x, y - at_y) < _BESIDE
            there &= np.abs(z - self._network.height(spot[0])) < _BESIDE
            others = others[there]
            lane, s = np.concatenate((lane, near[there])), np.concatenate((s, place[there]))
            speed = np.concatenate((speed, vehicles.speed[others]))
            half = np.concatenate((half, vehicles.half_length[others]))
        return Tails(self._network, lane, s - half, speed)
