"""Pedestrian navigation: along sidewalks, over crossings when cars have to wait or are far, and around standing vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import copysign, dist
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.attributes import number
from carla_recap.sim.signals import OFF, RED
from carla_recap.sim.validation import MAX_SPEED

if TYPE_CHECKING:
    from carla_recap.sim.episode import Episode
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.util.arrays import Floats, Integers

    Waypoint = tuple[float, float]

_SPEED_BY_AGE: Final = {"child": 1.3}  # m/s, of walkers whose attribute `speed` is 0; that of all others:
_ADULT_SPEED: Final = 1.4  # m/s
_TINY: Final = 1e-9  # m
_REACHED: Final = 0.3  # m from a waypoint
_TIME_GAP: Final = 4.0  # s: a walker steps on a crossing if no car reaches it sooner
_BESIDE: Final = 3.0  # m beside a crossing, where cars pass it
_MOVING: Final = 0.5  # m/s: slower cars let walkers pass
_LOOK_AHEAD: Final = 0.6  # m
_MARGIN: Final = 0.45  # m between the centre of a walker and a vehicle
_SAME_LEVEL: Final = 3.0  # m: vehicles that are farther above or below are on another road
_STANDING: Final = 0.3  # m/s: walkers go around slower vehicles


@dataclass(slots=True)
class _Journey:
    """The journey of a walker to its destination, at a speed in m/s.

    Attributes:
        last: The waypoint that was reached last.
        waypoints: The waypoints ahead.
        crossings: Whether each of these is reached over a crossing.
        waits: Whether the walker waits before a crossing.
        side: The side on which it passes a vehicle; see `_avoid`.
    """

    destination: tuple[float, ...]
    speed: float
    last: Waypoint = (0.0, 0.0)
    waypoints: list[Waypoint] = field(default_factory=list)
    crossings: list[bool] = field(default_factory=list)
    waits: bool = False
    side: int = 0


class PedestrianNavigation:
    """Steers the walkers that have destinations; the episode's random generator chooses the next ones."""

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        self._random = episode.random
        self._town = episode.town
        self._graph = self._town.walks
        self._paths = self._town.paths
        edges = zip(self._graph.edges.tolist(), self._graph.crossing, strict=True)
        self._crossings = {frozenset(edge) for edge, is_crossing in edges if is_crossing}
        self._lanes: dict[tuple[Waypoint, Waypoint], Integers] = {}
        self._journeys: dict[int, _Journey] = {}

    def step(self, delta: float) -> None:
        """Set the directions and speeds of the walkers, for a tick of a length in s."""
        walkers = self._episode.walkers
        walkers.destination[walkers.fallen] = np.nan
        self._update_journeys()
        if not self._journeys:
            return
        journeys = list(self._journeys.values())
        rows = np.array([walkers.row(id) for id in self._journeys])
        speed = np.array([journey.speed for journey in journeys])
        positions = walkers.position[rows, :2]
        direction = np.array([journey.waypoints[0] for journey in journeys]) - positions
        arrived = np.hypot(*direction.T) <= np.maximum(_REACHED, speed * delta)
        for index in np.flatnonzero(arrived).tolist():
            self._advance(journeys[index])
            walkers.destination[rows[index]] = journeys[index].destination
            direction[index] = journeys[index].waypoints[0] - positions[index]
        for journey, z in zip(journeys, walkers.position[rows, 2].tolist(), strict=True):
            journey.waits = journey.waits and not self._is_safe(journey.last, journey.waypoints[0], z)
        direction /= np.maximum(np.hypot(*direction.T), _TINY)[:, None]
        self._avoid_vehicles(journeys, walkers.position[rows], direction)
        stands = np.array([journey.waits for journey in journeys]) | ~direction.any(axis=1)
        walkers.direction[rows[~stands], :2] = direction[~stands]
        walkers.speed[rows] = np.where(stands, 0.0, speed)

    def _update_journeys(self) -> None:
        """Plan the journeys of walkers that have got another destination, and end those of walkers that have none."""
        walkers = self._episode.walkers
        rows = np.flatnonzero(walkers.has_destination)
        wanted = dict(zip(walkers.id[rows].tolist(), map(tuple, walkers.destination[rows].tolist()), strict=True))
        self._journeys = {id: each for id, each in self._journeys.items() if wanted.get(id) == each.destination}
        for row, (id, destination) in zip(rows.tolist(), wanted.items(), strict=True):
            if id in self._journeys:
                continue
            path = self._paths.find(*(self._paths.nearest(x, y) for x, y, _ in (walkers.position[row], destination)))
            if path:
                attributes = self._episode.actors[id].attributes
                usual = _SPEED_BY_AGE.get(attributes.get("age", ""), _ADULT_SPEED)
                journey = self._journeys[id] = _Journey(destination, number(attributes, "speed", usual, MAX_SPEED) or usual)
                self._set_path(journey, path)
            else:  # it has been moved since its destination was set
                walkers.destination[row] = np.nan

    def _avoid_vehicles(self, journeys: list[_Journey], positions: Floats, direction: Floats) -> None:
        """Change the directions of walkers on crossings, so that they do not walk into vehicles."""
        on_road = [index for index, journey in enumerate(journeys) if journey.crossings[0] and not journey.waits]
        if not on_road:
            return
        sides = np.array([journeys[index].side for index in on_road])
        direction[on_road] = _avoid(positions[on_road], direction[on_road], sides, self._episode.vehicles)
        for index, side in zip(on_road, sides.tolist(), strict=True):
            journeys[index].side = side

    def _advance(self, journey: _Journey) -> None:
        """Turn from a waypoint that is reached to the next one; from the destination, to another destination."""
        journey.last = journey.waypoints.pop(0)
        journey.crossings.pop(0)
        if not journey.waypoints:
            start = self._paths.nearest(*journey.last)
            goal = int(self._random.choice(self._paths.reachable(start)))
            journey.destination = tuple(self._graph.nodes[goal].tolist())
            self._set_path(journey, self._paths.find(start, goal))
        journey.waits, journey.side = journey.crossings[0], 0

    def _set_path(self, journey: _Journey, path: list[int]) -> None:
        journey.waypoints = [(x, y) for x, y, _ in self._graph.nodes[path].tolist()]
        journey.crossings = [False, *(frozenset(edge) in self._crossings for edge in pairwise(path))]

    def _is_safe(self, start: Waypoint, end: Waypoint, z: float) -> bool:
        """Return whether the lanes of a crossing have red or no light, and no car approaches; z is that of the walker."""
        if (start, end) not in self._lanes:
            share = np.linspace(0, 1, max(2, int(2 * dist(start, end))))[:, None]
            points = np.array(start) + share * (np.array(end) - start)
            heights = np.full(len(points), z) if self._town.index.has_levels else None
            self._lanes[start, end] = np.unique(self._town.nearest_lane(*points.T, z=heights)[0])
        states = self._episode.signals.state_of_lane(self._lanes[start, end])
        return bool(((states == RED) | (states == OFF)).all()) and not self._is_approached(np.array((start, end)), z)

    def _is_approached(self, ends: Floats, z: float) -> bool:
        vehicles = self._episode.vehicles
        middle, half = ends.mean(axis=0), dist(*ends) / 2
        yaw = np.radians(vehicles.yaw)
        x, y = (middle - vehicles.position[:, :2]).T
        ahead = np.cos(yaw) * x + np.sin(yaw) * y
        lateral = np.abs(np.cos(yaw) * y - np.sin(yaw) * x)
        moving = vehicles.speed > _MOVING
        near = (ahead > -vehicles.half_length) & (ahead - vehicles.half_length < vehicles.speed * _TIME_GAP)
        near &= np.abs(vehicles.position[:, 2] - z) < _SAME_LEVEL
        return bool((moving & near & (lateral < half + _BESIDE)).any())


def _avoid(positions: Floats, directions: Floats, sides: Integers, vehicles: Vehicles) -> Floats:
    """Return directions that do not lead into vehicles: walkers wait for moving ones, and go around standing ones.

    Directions have length 1, or 0 to wait, (k, 2). A side is 1 to go around a vehicle to the right, -1 to the left, 0 where
    a walker has not decided, (k,): it is changed where one decides, and kept until the walker is across the road.
    """
    if not len(vehicles):
        return directions
    yaw = np.radians(vehicles.yaw)
    along = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    across = np.stack((-along[:, 1], along[:, 0]), axis=1)
    size = np.stack((vehicles.half_length, vehicles.half_width), axis=1) + _MARGIN
    away = (positions[:, None] - vehicles.position)[..., :2]
    local = np.stack(((away * along).sum(axis=2), (away * across).sum(axis=2)), axis=2)
    step = _LOOK_AHEAD * np.stack((directions @ along.T, directions @ across.T), axis=2)
    distance, next_distance = ((np.abs(point) - size).max(axis=2) for point in (local, local + step))
    same_level = np.abs(positions[:, None, 2] - vehicles.position[:, 2]) < _SAME_LEVEL
    blocking = (next_distance < 0) & (next_distance < distance) & same_level
    result = directions.copy()
    for walker in np.flatnonzero(blocking.any(axis=1)).tolist():
        vehicle = int(blocking[walker].argmax())
        result[walker] = 0.0
        if abs(vehicles.speed[vehicle]) < _STANDING:
            (x, y), (length, width) = local[walker, vehicle].tolist(), size[vehicle].tolist()
            (forward, right), sides[walker] = _around(x, y, length, width, int(sides[walker]))
            result[walker] = forward * along[vehicle] + right * across[vehicle]
    return result


def _around(x: float, y: float, length: float, width: float, side: int) -> tuple[tuple[float, float], int]:
    """Return the direction along a box in its own axes, and the side; an undecided walker takes the nearest corner."""
    if abs(y) - width > abs(x) - length:
        sign = copysign(1, y)
        side = side or int(-sign * copysign(1, x))
        return (-side * sign, 0.0), side
    sign = copysign(1, x)
    side = side or int(sign * copysign(1, y))
    return (0.0, side * sign), side
