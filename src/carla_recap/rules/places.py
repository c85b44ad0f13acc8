"""Places: areas of the ground that rules are about, in right-handed axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, TypeAlias

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.roads.network import BOTH_WAYS, DRIVING, LANE_KINDS, NONE, UNPAVED
from carla_recap.roads.polylines import distances_to
from carla_recap.rules.values import listed

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.roads.network import RoadNetwork
    from carla_recap.rules.values import Quantity
    from carla_recap.util.arrays import Floats

    Roads = Callable[[frozenset[str] | None], RoadNetwork]

    Occasion: TypeAlias = "str | Place"
    """What begins or ends a scope: an actor's first incident of a kind, or its first time in a place."""

FOR_CARS: Final = "driving"
"""The word for all types of lanes for cars."""
LANE_TYPES: Final = (*LANE_KINDS, *UNPAVED)
"""The types of lanes in OpenDRIVE, lower-case."""
ANY_JUNCTION: Final = "any"


@dataclass(frozen=True, kw_only=True)
class Place:
    """An area of the ground."""

    name: str = ""  # in the file of rules; empty without one
    needs_roads: ClassVar[bool] = False  # whether it is an area of the roads of the map

    def outside(self, points: Floats, roads: Roads) -> Floats:
        """Return how far points, rows of x, y, z in m, are outside, in m; 0 within the place; for roads, see `Facts`."""
        raise NotImplementedError

    def __str__(self) -> str:
        return f"the place {self.name}" if self.name else self._words()

    def _words(self) -> str:
        """Return the place without a name in words."""
        raise NotImplementedError


@dataclass(frozen=True)
class Circle(Place):
    """What is within a distance of a point."""

    x: float  # m
    y: float
    z: float | None  # None: whatever the height
    within: Quantity
    written: str  # the point in the file of rules

    def outside(self, points: Floats, roads: Roads) -> Floats:
        """See `Place.outside`."""
        apart = points - (self.x, self.y, 0.0 if self.z is None else self.z)
        if self.z is None:
            apart = apart[:, :2]
        return np.asarray(np.maximum(np.linalg.norm(apart, axis=1) - self.within.value, 0.0))

    def _words(self) -> str:
        return f"the place within {self.within} of {self.written}"


@dataclass(frozen=True)
class Polygon(Place):
    """What is within a polygon, whatever the height."""

    corners: tuple[tuple[float, float], ...]  # x and y, in m

    def outside(self, points: Floats, roads: Roads) -> Floats:
        """See `Place.outside`."""
        x, y = points[:, 0], points[:, 1]
        within = np.zeros(len(points), np.bool_)
        distance = np.full(len(points), np.inf)
        for start, stop in zip(self._array, np.roll(self._array, -1, axis=0), strict=True):
            rows = np.flatnonzero((y < start[1]) != (y < stop[1]))
            beyond = start[0] + (y[rows] - start[1]) / (stop[1] - start[1]) * (stop[0] - start[0]) if len(rows) else 0.0
            within[rows] ^= x[rows] < beyond
            np.minimum(distance, distances_to(points[:, :2], start, stop), out=distance)
        return np.where(within, 0.0, distance)

    @property
    def _array(self) -> Floats:
        return np.array(self.corners, np.float64)

    @property
    def area(self) -> float:
        """The area, in m²."""
        x, y = self._array.T
        return abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) / 2

    def crossing(self) -> tuple[int, int] | None:
        """Return the numbers of two sides that cross each other, from 1; None if there are none."""
        start = self._array
        along = np.roll(start, -1, axis=0) - start

        def beside(point: Floats) -> Floats:
            """Return on which side of each side of the polygon, (rows), points are, (columns)."""
            away = point[None] - start[:, None]
            return np.sign(along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0])

        parted = beside(start) * beside(np.roll(start, -1, axis=0)) < 0
        found = np.argwhere(parted & parted.T)
        return (int(found[0, 0]) + 1, int(found[0, 1]) + 1) if len(found) else None

    def _words(self) -> str:
        return f"the polygon of {len(self.corners)} corners"


@dataclass(frozen=True)
class Lanes(Place):
    """What is on some lanes of the map."""

    types: tuple[str, ...] = ()  # OpenDRIVE's; `driving` stands for all that are for cars; none: all that are paved
    roads: tuple[str, ...] = ()  # the ids of the roads that they are of; none: any
    junctions: tuple[str, ...] = ()  # the ids of the junctions that they are in, or `any`; none: anywhere

    needs_roads: ClassVar[bool] = True

    def outside(self, points: Floats, roads: Roads) -> Floats:
        """See `Place.outside`."""
        cars = [each for each, kind in LANE_KINDS.items() if kind in (DRIVING, BOTH_WAYS)]
        types = frozenset(name for each in self.types for name in (cars if each == FOR_CARS else [each]))
        network = roads(types or None)
        road, junction = network.lanes["road"], network.lanes["junction"]
        lanes = np.ones(len(network.lanes), np.bool_)
        if self.roads:
            lanes &= np.isin(road, _indices("road", self.roads, network.road_ids, network.name))
        if ANY_JUNCTION in self.junctions:
            lanes &= junction != NONE
        elif self.junctions:
            lanes &= np.isin(junction, _indices("junction", self.junctions, network.junction_ids, network.name))
        return network.only(lanes).lanes_at(points).outside

    def _words(self) -> str:
        lanes = f"the {listed(self.types).replace(' or ', ' and ')} lanes" if self.types else ""
        roads = f"road {listed(self.roads)}" if self.roads else ""
        junctions = f"junction {listed(self.junctions)}" if self.junctions else ""
        if ANY_JUNCTION in self.junctions:
            junctions = "junctions"
        return " of ".join(filter(None, (lanes, roads, junctions)))


def _indices(noun: str, ids: tuple[str, ...], known: tuple[str, ...], name: str) -> list[int]:
    missing = [id for id in ids if id not in known]
    if missing:
        raise RecapError(f"the map {name} has no {noun} {missing[0]}")
    return [index for index, id in enumerate(known) if id in ids]
