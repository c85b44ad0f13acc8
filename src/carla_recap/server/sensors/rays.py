"""Rays against the boxes of vehicles, walkers and props: what radars, lidars and obstacle detectors see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.actor import Prop
from carla_recap.sim.actors.moving import MovingActor

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.geometry import Location, Transform, Vector

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_STRAIGHT: Final = 1e-12  # instead of 0, where a ray runs along a side of a box


def axes(place: Transform) -> Floats:
    """The axes of a transform, (3, 3); see `Rotation.matrix`."""
    return np.array(place.rotation.matrix())


def row(value: Location | Vector) -> Floats:
    """A place or a direction as (3,)."""
    return np.array((value.x, value.y, value.z))


def rows(values: Iterable[Location | Vector]) -> Floats:
    """Places or directions as (n, 3)."""
    return np.array([(value.x, value.y, value.z) for value in values], np.float64).reshape(-1, 3)


def seen_by(sensor: Actor) -> list[Actor]:
    """Whoever a sensor can see: all who have a box, but for who carries it and what else is on that."""
    carrier = sensor
    while carrier.parent is not None:
        carrier = carrier.parent
    own = _family(carrier)
    others = sensor.context.actors.values()
    return [
        other
        for other in others
        if isinstance(other, (MovingActor, Prop)) and other.box.extent.length() and other not in own
    ]


def _family(actor: Actor) -> set[Actor]:
    return {actor}.union(*map(_family, actor.children))


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """What rays have hit first.

    Attributes:
        ray: The numbers of the rays that have hit something, ascending.
        box: The numbers of the boxes.
        distance: How far away, in m.
        cosine: Of the angle between the ray and the normal of the side that it hits.
    """

    ray: Integers
    box: Integers
    distance: Floats
    cosine: Floats


class Boxes:
    """The boxes of actors, as they stand.

    Args:
        actors: Whose.
        margin: So much larger are they taken to be on each side, in m.

    Attributes:
        actors: Whose they are.
    """

    def __init__(self, actors: Sequence[Actor], margin: float = 0.0) -> None:
        self.actors = actors
        places = [actor.transform for actor in actors]
        middles = [place.transform(actor.box.location) for place, actor in zip(places, actors, strict=True)]
        self._axes = np.array([place.rotation.matrix() for place in places]).reshape(-1, 3, 3)
        self._middle = rows(middles)
        self._extent = rows(actor.box.extent for actor in actors) + margin

    def cast(self, origin: Floats, directions: Floats, reach: float) -> Hits:
        """Send rays from a place.

        Args:
            origin: Where from, (3,) in m.
            directions: Where to, (n, 3), of length 1.
            reach: How far, in m.
        """
        ray, box = self._near(origin, directions, reach)
        start = ((origin - self._middle)[:, None] @ self._axes)[box, 0]
        along = (directions[ray][:, None] @ self._axes[box])[:, 0]
        along = np.where(np.abs(along) < _STRAIGHT, _STRAIGHT, along)
        extent = self._extent[box]
        enter = (-np.sign(along) * extent - start) / along
        leave = (np.sign(along) * extent - start) / along
        side = enter.argmax(axis=1)
        distance = np.maximum(enter.max(axis=1), 0.0)
        cosine = np.abs(np.take_along_axis(along, side[:, None], 1)[:, 0])
        hit = np.flatnonzero((distance <= leave.min(axis=1)) & (distance <= reach))
        order = hit[np.lexsort((distance[hit], ray[hit]))]
        first = order[np.unique(ray[order], return_index=True)[1]]
        return Hits(ray[first], box[first], distance[first], cosine[first])

    def _near(self, origin: Floats, directions: Floats, reach: float) -> tuple[Integers, Integers]:
        """Pairs of rays and boxes that may meet: the ray passes the sphere around the box."""
        to = self._middle - origin
        size = np.linalg.norm(self._extent, axis=1)
        away = np.linalg.norm(to, axis=1)
        boxes = np.flatnonzero(away - size <= reach)
        least = np.sqrt(np.maximum(away[boxes] ** 2 - size[boxes] ** 2, 0.0))  # as far along is where a ray touches it
        least[away[boxes] <= size[boxes]] = -np.inf
        ray, place = np.nonzero(directions @ to[boxes].T >= least)
        return ray, boxes[place]
