"""Which actors are there: those far from the height of the roads are not.

Scenarios hide the actors that they need later below the ground: ScenarioRunner by 50 to 500 m. The height of the roads is
taken from the recording itself, so that the answer is the same with and without a map, at any altitude: from traffic lights
and signs, which stand beside the roads, and from the road users.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.lives import ROAD_USERS
from carla_recap.model.records import CM
from carla_recap.model.segment import segments

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.util.arrays import Booleans, Floats, Integers


LEVEL: Final = 30.0
"""The height in m between roads above each other, at most: more than that of a bridge, less than what scenarios hide by."""
SLOPE: Final = 0.2
"""The slope of the land between roads, at most: steeper than any road."""
FAR: Final = 1e7
"""The distance in m from the origin from which on a place is none: no coordinates in use are as large."""

_LANDMARKS: Final = ("traffic_light", "traffic_sign")


class RoadHeights:
    """Tells which actors are far above or below the roads.

    An actor is there if its height is at most 30 m from that of some traffic light, sign or road user, which is at most 30 m
    from that of another one, and so on. Where these heights are in several groups, the one of most lights and signs counts,
    or without any that of a hero, else that of most road users, of equal ones the highest. An actor of another group is
    there, too, if a slope of 20% leads to it from what is nearest of that group, within 30 m.
    """

    def __init__(self, actors: Collection[ActorLife] = ()) -> None:
        self._actors = actors

    @cached_property
    def _landmarks(self) -> Floats:
        """Where the largest group of lights and signs is, in m, (landmarks, 3)."""
        standing = [actor.spawn_pose[:3] for actor in self._actors if actor.kind in _LANDMARKS and not actor.attached]
        places = np.array(standing, np.float64).reshape(-1, 3) * CM
        places = places[(np.abs(places) < FAR).all(axis=1)]
        low, high = _largest_group(places[None, :, 2])
        return np.asarray(places[(places[:, 2] >= low) & (places[:, 2] <= high)])

    @cached_property
    def _bounds(self) -> tuple[float, float]:
        """The lowest and highest of these, in m; infinite without any."""
        heights = self._landmarks[:, 2]
        return float(heights.min(initial=np.inf)), float(heights.max(initial=-np.inf))

    def _ids(self, counts: Callable[[ActorLife], bool]) -> Integers:
        return np.array([actor.id for actor in self._actors if counts(actor)], np.int64)

    def away(self, ids: NDArray[np.integer], places: Floats) -> Booleans:
        """Return which actors are too far from the roads to be there; sensors may be anywhere.

        Places are in cm, as recorded, (moments, actors, 3 or more), NaN where unknown; the answer is (moments, actors).
        """
        z, (lowest, highest) = places[..., 2], self._bounds
        low, high = np.fmin.reduce(z, axis=None, initial=lowest / CM), np.fmax.reduce(z, axis=None, initial=highest / CM)
        if high - low <= LEVEL / CM:
            return np.zeros(z.shape, np.bool_)
        places = places[..., :3] * CM
        z, known = places[..., 2], (np.abs(places) < FAR).all(axis=2)
        users = known & np.isin(ids, self._ids(lambda actor: actor.kind in ROAD_USERS))
        if len(self._landmarks):
            low, high = np.full(len(z), lowest), np.full(len(z), highest)
        else:
            low, high = _largest_group(np.where(users, z, np.nan))
            heroes = np.where(users & np.isin(ids, self._ids(lambda actor: actor.is_hero)), z, np.nan)
            with_hero = ~np.isnan(heroes).all(axis=1)
            low[with_hero] = high[with_hero] = np.nanmax(heroes[with_hero], axis=1)
        high = _reach(np.where(users, z, np.nan), high)
        low = -_reach(np.where(users, -z, np.nan), -low)
        with np.errstate(invalid="ignore"):
            away = known & ((z > high[:, None] + LEVEL) | (z < low[:, None] - LEVEL))
        away[:, np.isin(ids, self._ids(lambda actor: actor.kind == "sensor" or actor.type_id == "spectator"))] = False
        away[~(low <= high)] = False  # there is nothing to compare with
        references = users & ~away
        # The nearest reference is not farther than any other one: most actors that are away are too far for a slope from it.
        one = places[np.arange(len(z)), references.argmax(axis=1)]
        one[~references.any(axis=1)] = self._landmarks[0] if len(self._landmarks) else np.inf
        with np.errstate(invalid="ignore", over="ignore"):
            reach = 2 * LEVEL + SLOPE * np.hypot(places[..., 0] - one[:, None, 0], places[..., 1] - one[:, None, 1])
            near = away & (z <= high[:, None] + reach) & (z >= low[:, None] - reach)
        for column in np.flatnonzero(near.any(axis=0)).tolist():
            rows = np.flatnonzero(near[:, column])
            away[rows, column] = ~self._on_a_slope(places[rows, column], places[rows], references[rows])
        return away

    @np.errstate(invalid="ignore")  # of signalling NaN
    def away_in(self, transforms: NDArray[np.void]) -> Booleans:
        """Return which vehicles and walkers are away, for the transforms of some frames: (frames, records of each)."""
        found = np.zeros(transforms.shape, np.bool_)
        users = self._ids(lambda actor: actor.kind in ROAD_USERS)
        for segment in segments(transforms):
            there = segment.only(np.isin(segment.ids, users))
            places = np.stack([there.field(axis) for axis in "xyz"], axis=2).astype(np.float64)
            found[there.frames, there.columns] = self.away(there.ids, places)
        return found

    def is_away(self, id: int, place: tuple[float, float, float]) -> bool:
        """Return whether an actor is away at a place in cm, as recorded, by where the other road users have been spawned."""
        ids, places = self._spawned
        others = ids != id
        ids, places = np.append(ids[others], id), np.append(places[others], [place], axis=0)
        return bool(self.away(ids, places[None])[0, -1])

    @cached_property
    def _spawned(self) -> tuple[Integers, Floats]:
        """The ids of all road users, and where each has been spawned, in cm, (road users, 3)."""
        users = [actor for actor in self._actors if actor.kind in ROAD_USERS]
        places = np.array([actor.spawn_pose[:3] for actor in users], np.float64).reshape(-1, 3)
        return np.array([actor.id for actor in users], np.int64), places

    def _on_a_slope(self, places: Floats, others: Floats, references: Booleans) -> Booleans:
        """Return whether a slope leads to places, (moments, 3), from the nearest reference at that moment."""
        distance = np.full(len(places), np.inf)
        height = np.zeros(len(places))
        for points, counts in ((others, references), (self._landmarks[None], np.ones((1, len(self._landmarks)), np.bool_))):
            if not points.shape[1]:
                continue
            with np.errstate(invalid="ignore", over="ignore"):
                apart = np.hypot(points[..., 0] - places[:, None, 0], points[..., 1] - places[:, None, 1])
            apart = np.where(counts, apart, np.inf)
            nearest = apart.argmin(axis=1)
            rows = np.arange(len(places))
            closer = apart[rows, nearest] < distance
            distance = np.where(closer, apart[rows, nearest], distance)
            height = np.where(closer, np.broadcast_to(points[..., 2], apart.shape)[rows, nearest], height)
        return np.asarray(np.isfinite(distance) & (np.abs(places[:, 2] - height) <= LEVEL + SLOPE * distance))


def _largest_group(heights: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and highest of the largest group of heights, (moments, heights), of equal ones the highest."""
    moments, count = heights.shape
    if not count:
        return np.full(moments, np.inf), np.full(moments, -np.inf)
    ordered = np.sort(heights, axis=1)  # NaN last
    with np.errstate(invalid="ignore"):
        gaps = np.diff(ordered, axis=1, prepend=ordered[:, :1]) > LEVEL
    group = np.cumsum(gaps, axis=1)
    sizes = np.zeros((moments, count), np.intp)
    rows = np.broadcast_to(np.arange(moments)[:, None], group.shape)
    np.add.at(sizes, (rows, group), np.isfinite(ordered))
    best = sizes.shape[1] - 1 - sizes[:, ::-1].argmax(axis=1)
    inside = (group == best[:, None]) & np.isfinite(ordered)
    return np.where(inside, ordered, np.inf).min(axis=1), np.where(inside, ordered, -np.inf).max(axis=1)


def _reach(heights: Floats, start: Floats) -> Floats:
    """Return how high one gets from a height by steps of 30 m at most from one of the heights to the next, (moments,)."""
    ordered = np.sort(heights, axis=1)
    ordered = np.where(ordered > start[:, None], ordered, start[:, None])
    with np.errstate(invalid="ignore"):  # of infinite heights
        steps = np.diff(ordered, axis=1, prepend=start[:, None])
    broken = np.logical_or.accumulate(~(steps <= LEVEL), axis=1)
    return np.asarray(np.where(broken, start[:, None], ordered).max(axis=1, initial=-np.inf))
