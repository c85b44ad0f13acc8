"""The motion of vehicles and walkers in a tick, and their collisions."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.blueprints import COLLISION_SENSOR
from carla_recap.sim.episode import Collision
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.physics.walkers import FALL

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.physics.plane import BodyContact
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers

_STRIDE: Final = 1.0  # m that the fastest vehicle covers in a step at most
_ROUNDING: Final = 1e-6
_LEAST_IMPULSE: Final = 1e-6  # N s: less is a touch, no collision
_BUMPER_HEIGHT: Final = 0.5  # m above the road


class ActorMotion:
    """Moves the vehicles and walkers of an episode."""

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        self._collisions = CollisionDetector(episode)

    def advance(self, delta: float) -> list[Collision]:
        """Move all vehicles and walkers for a tick of a length in s, and return their collisions."""
        vehicles, walkers, plane = self._episode.vehicles, self._episode.walkers, self._episode.plane
        self._collisions.clear()
        groups: list[Vehicles | Walkers] = [group for group in (vehicles, walkers) if len(group)]
        moving = [group.begin_tick(delta) for group in groups]
        if any(moving) or plane.disturbed:
            steps = self._steps(delta)
            for _ in range(steps):
                for group in groups:
                    group.write_velocities(delta / steps)
                self._collisions.add(plane.step(delta / steps))
                for group in groups:
                    group.read_bodies()
        for group in groups:
            group.end_tick(delta)
        for actor in self._episode.attached.values():
            actor.follow_parent()
        return self._collisions.take()

    def _steps(self, delta: float) -> int:
        """Return the number of steps in which a tick is simulated: more if a vehicle is fast."""
        settings, vehicles = self._episode.settings, self._episode.vehicles
        if not settings.substepping:
            return 1
        fastest: float = max(np.abs(speeds).max(initial=0).item() for speeds in (vehicles.speed, vehicles.sideways))
        wanted = max(delta / settings.max_substep_delta_time, fastest * delta / _STRIDE)
        return min(max(ceil(wanted - _ROUNDING), 1), max(1, settings.max_substeps))


@dataclass(slots=True)
class _Push:
    """The first point of contact of a pair of actors in a tick, and the sum of the impulses."""

    point: tuple[float, float]
    x: float = 0.0
    y: float = 0.0


class CollisionDetector:
    """Makes collisions out of the contacts of an episode.

    A collision is reported for an actor that is watched; if both are, once for each, as by two collision sensors.
    """

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        self._pushes: dict[tuple[int, int | None], _Push] = {}
        self._watched: dict[int, bool] = {}
        self._number = 0

    def clear(self) -> None:
        """Begin a tick; one before that failed may have left something."""
        self._pushes.clear()
        self._watched.clear()

    def add(self, contacts: Iterable[BodyContact]) -> None:
        """Add the contacts of a step; walkers that are hit hard by a vehicle fall."""
        for contact in contacts:
            x, y = contact.impulse
            if hypot(x, y) <= _LEAST_IMPULSE:
                continue
            a, b = self._episode.owners.get(contact.a), self._episode.owners.get(contact.b)
            self._pushed(a, b, (x, y), contact.point)
            self._pushed(b, a, (-x, -y), contact.point)

    def take(self) -> list[Collision]:
        """Return the collisions of the tick, in the order in which they began."""
        return [self._collision(pair, push) for pair, push in self._pushes.items()]

    def _pushed(
        self, actor: Actor | None, by: Actor | None, impulse: tuple[float, float], point: tuple[float, float]
    ) -> None:
        if actor is None:
            return
        if self._is_watched(actor):
            push = self._pushes.setdefault((actor.id, None if by is None else by.id), _Push(point))
            push.x += impulse[0]
            push.y += impulse[1]
        if isinstance(actor, Walker) and isinstance(by, Vehicle):
            walkers, row = actor.rows, actor.row
            if walkers.simulated[row] and hypot(*impulse) / walkers.mass[row] > FALL:
                walkers.fall(row, impulse)

    def _collision(self, pair: tuple[int, int | None], push: _Push) -> Collision:
        first, second = (None if id is None else self._episode.actors[id] for id in pair)
        number, self._number = self._number, self._number + 1
        x, y = push.point
        z = None if first is None else [first.transform.location.z]
        height = self._episode.town.height([x], [y], z).item()
        location = Location(x, y, height + _BUMPER_HEIGHT)
        impulse = Vector(push.x, push.y, 0.0)
        return Collision(*pair, location, impulse, _is_hero(first), _is_hero(second), number)

    def _is_watched(self, actor: Actor) -> bool:
        """Return whether the collisions of an actor are reported; decided once per tick."""
        if actor.id not in self._watched:
            is_of_all = self._episode.settings.collisions_of == "all" and isinstance(actor, (Vehicle, Walker))
            self._watched[actor.id] = is_of_all or is_watched(actor)
        return self._watched[actor.id]


def is_watched(actor: Actor) -> bool:
    """Return whether the collisions of an actor are reported in any case: it is a hero, or has a collision sensor."""
    return actor.is_hero or any(child.type_id == COLLISION_SENSOR for child in actor.children)


def _is_hero(actor: Actor | None) -> bool:
    return actor is not None and actor.is_hero
