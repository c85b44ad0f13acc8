"""Walkers that find their way: along sidewalks, and over crossings when cars have to wait or are far."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import dist
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.lights import OFF, RED
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location
from carla_recap.sim.town.paths import Paths
from carla_recap.sim.traffic.avoidance import evade

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.actors.moving import Walker
    from carla_recap.sim.actors.registry import ActorRegistry

    Floats = NDArray[np.float64]

_USUAL_SPEED: Final = {"child": 1.3}  # m/s by age, of walkers whose attribute `speed` is 0; that of all others:
_ADULT_SPEED: Final = 1.4  # m/s
_TINY: Final = 1e-9  # m
_NEAR: Final = 0.3  # m: so near a corner of the way counts as reached
_GAP: Final = 4.0  # s: no car may reach a crossing sooner than that when one steps on it
_BESIDE: Final = 3.0  # m: cars so far beside a crossing pass it
_MOVING: Final = 0.5  # m/s: slower cars are letting walkers pass


@dataclass(slots=True)
class _Mind:
    """What a walker is up to.

    Attributes:
        place: Where it walks.
        speed: How fast, in m/s.
        kerb: The latest corner of its way.
        corners: Those that lie ahead.
        crossings: Which of them are reached over a crossing.
        waits: Whether it waits at the kerb.
        turn: Which way it walks around a vehicle; see `evade`.
    """

    place: Location
    speed: float
    kerb: tuple[float, float] = (0.0, 0.0)
    corners: list[tuple[float, float]] = field(default_factory=list)
    crossings: list[bool] = field(default_factory=list)
    waits: bool = False
    turn: int = 0


class PedestrianNavigation:
    """Leads walkers that have destinations; a controller of the world.

    Args:
        registry: The actors.
        random: What chooses the next destinations.
    """

    def __init__(self, registry: ActorRegistry, random: np.random.Generator) -> None:
        self._registry = registry
        self._random = random
        self._town = registry.town
        self._graph = self._town.walks
        self._paths = Paths(self._graph)
        self._crossing = {
            frozenset(edge) for edge, over in zip(self._graph.edges.tolist(), self._graph.crossing, strict=True) if over
        }
        self._lanes: dict[tuple[tuple[float, float], tuple[float, float]], NDArray[np.int64]] = {}
        self._minds: dict[int, _Mind] = {}

    def destination(self, walker: int) -> Location | None:
        """Return the destination of a walker; None if it has none."""
        mind = self._minds.get(walker)
        return None if mind is None else mind.place

    def clear_destination(self, walker: int) -> None:
        """Leave a walker to its control."""
        self._minds.pop(walker, None)

    def set_destination(self, walker: Walker, place: Location) -> None:
        """Have a walker walk somewhere, and then on to other places.

        Raises:
            SimError: The town has no sidewalks, or none leads there.
        """
        if not len(self._graph.nodes):
            raise SimError(f"{self._town.name} has no sidewalks: walkers can only be steered")
        here = walker.transform.location
        path = self._paths.find(self._paths.nearest(here.x, here.y), self._paths.nearest(place.x, place.y))
        if not path:
            raise SimError(f"no sidewalk leads from ({here.x:.1f}, {here.y:.1f}) to ({place.x:.1f}, {place.y:.1f})")
        usual = _USUAL_SPEED.get(walker.attributes.get("age", ""), _ADULT_SPEED)
        mind = _Mind(Location(place.x, place.y, place.z), float(walker.attributes.get("speed") or 0) or usual)
        self._lead(mind, path)
        self._minds[walker.id] = mind

    def random_place(self) -> Location:
        """Somewhere on a sidewalk."""
        return self._place(int(self._random.integers(len(self._graph.nodes))))

    def step(self, delta: float) -> None:
        """Turn everybody towards the next corner of the way."""
        self._minds = {id: mind for id, mind in self._minds.items() if self._can_walk(id)}
        if not self._minds:
            return
        walkers, minds = self._registry.walkers, list(self._minds.values())
        rows = np.searchsorted(walkers.id, list(self._minds))
        speed = np.array([mind.speed for mind in minds])
        places = walkers.position[rows, :2]
        ahead = np.array([mind.corners[0] for mind in minds]) - places
        arrived = np.hypot(*ahead.T) <= np.maximum(_NEAR, speed * delta)
        for index in np.flatnonzero(arrived).tolist():
            self._go_on(minds[index])
            ahead[index] = minds[index].corners[0] - places[index]
        for mind in minds:
            mind.waits = mind.waits and not self._is_safe(mind.kerb, mind.corners[0])
        ahead /= np.maximum(np.hypot(*ahead.T), _TINY)[:, None]
        self._evade(minds, places, ahead)
        stands = np.array([mind.waits for mind in minds]) | ~ahead.any(axis=1)
        walkers.direction[rows[~stands], :2] = ahead[~stands]
        walkers.speed[rows] = np.where(stands, 0.0, speed)

    def _evade(self, minds: list[_Mind], places: Floats, ahead: Floats) -> None:
        """Have those that are on a crossing not walk into vehicles; changes where they walk."""
        on_road = [index for index, mind in enumerate(minds) if mind.crossings[0] and not mind.waits]
        if not on_road:
            return
        turns = np.array([minds[index].turn for index in on_road])
        ahead[on_road] = evade(places[on_road], ahead[on_road], turns, self._registry.vehicles)
        for index, turn in zip(on_road, turns.tolist(), strict=True):
            minds[index].turn = turn

    def _can_walk(self, walker: int) -> bool:
        walkers = self._registry.walkers
        return walker in self._registry.actors and not walkers.fallen[walkers.row(walker)]

    def _go_on(self, mind: _Mind) -> None:
        """Let a walker that is at a corner turn to the next one; at its destination, to another one."""
        mind.kerb = mind.corners.pop(0)
        mind.crossings.pop(0)
        if not mind.corners:
            here = self._paths.nearest(*mind.kerb)
            there = int(self._random.choice(self._paths.reachable(here)))
            mind.place = self._place(there)
            self._lead(mind, self._paths.find(here, there))
        mind.waits, mind.turn = mind.crossings[0], 0

    def _lead(self, mind: _Mind, path: list[int]) -> None:
        mind.corners = [(x, y) for x, y, _ in self._graph.nodes[path].tolist()]
        mind.crossings = [False, *(frozenset(pair) in self._crossing for pair in pairwise(path))]

    def _place(self, node: int) -> Location:
        return Location(*self._graph.nodes[node].tolist())

    def _is_safe(self, start: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether the lanes of a crossing have red, or no light, and no car comes."""
        if (start, end) not in self._lanes:
            share = np.linspace(0, 1, max(2, int(2 * dist(start, end))))[:, None]
            places = np.array(start) + share * (np.array(end) - start)
            self._lanes[start, end] = np.unique(self._town.nearest_lane(*places.T)[0])
        shown = self._registry.signals.state_of_lane(self._lanes[start, end])
        return bool(((shown == RED) | (shown == OFF)).all()) and not self._is_approached(np.array((start, end)))

    def _is_approached(self, ends: Floats) -> bool:
        vehicles = self._registry.vehicles
        middle, half = ends.mean(axis=0), dist(*ends) / 2
        yaw = np.radians(vehicles.yaw)
        x, y = (middle - vehicles.position[:, :2]).T
        ahead = np.cos(yaw) * x + np.sin(yaw) * y
        aside = np.abs(np.cos(yaw) * y - np.sin(yaw) * x)
        moving = vehicles.speed > _MOVING
        near = (ahead > -vehicles.half_length) & (ahead - vehicles.half_length < vehicles.speed * _GAP)
        return bool((moving & near & (aside < half + _BESIDE)).any())
