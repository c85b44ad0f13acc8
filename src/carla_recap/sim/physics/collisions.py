"""Whose collisions are noticed, and what a tick's contacts make of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING, Final

from carla_recap.sim.actors.actors import Vehicle, Walker
from carla_recap.sim.actors.blueprints import COLLISION_SENSOR
from carla_recap.sim.actors.events import Collision
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.physics.walkers import FALL

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.physics.plane import Contact
    from carla_recap.sim.world import World

_LEAST: Final = 1e-6  # N s: who only touches does not collide
_HEIGHT: Final = 0.5  # m: a bumper's, above the road


@dataclass(slots=True)
class _Push:
    """What an actor got from another in a tick: where it was pushed first, and all impulses."""

    point: tuple[float, float]
    x: float = 0.0
    y: float = 0.0


class Collisions:
    """Makes collisions out of contacts.

    Each is told from the side of who is watched; of two that are, from both sides, as two collision sensors would tell it.

    Args:
        world: The world.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._pushes: dict[tuple[int, int | None], _Push] = {}
        self._watched: dict[int, bool] = {}
        self._number = 0

    def add(self, contacts: Iterable[Contact]) -> None:
        """Take in the contacts of a step; walkers that are hit hard fall."""
        for contact in contacts:
            x, y = contact.impulse
            if hypot(x, y) <= _LEAST:
                continue
            a, b = self._world.owner(contact.a), self._world.owner(contact.b)
            self._pushed(a, b, (x, y), contact.point)
            self._pushed(b, a, (-x, -y), contact.point)

    def take(self) -> list[Collision]:
        """The collisions of the tick, in the order in which they began."""
        self._watched.clear()
        collisions = [self._collision(pair, push) for pair, push in self._pushes.items()]
        self._pushes = {}
        return collisions

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
            if hypot(*impulse) / walkers.mass[row] > FALL:
                walkers.fall(row)

    def _collision(self, pair: tuple[int, int | None], push: _Push) -> Collision:
        first, second = (None if id is None else self._world.actors[id] for id in pair)
        number, self._number = self._number, self._number + 1
        x, y = push.point
        place = Location(x, y, self._world.height(x, y) + _HEIGHT)
        impulse = Vector(push.x, push.y, 0.0)
        return Collision(*pair, place, impulse, _is_hero(first), _is_hero(second), number)

    def _is_watched(self, actor: Actor) -> bool:
        """Whether collisions of an actor are noticed, decided once a tick."""
        if actor.id not in self._watched:
            self._watched[actor.id] = self._is_to_be_watched(actor)
        return self._watched[actor.id]

    def _is_to_be_watched(self, actor: Actor) -> bool:
        if self._world.settings.collisions_of == "all" and isinstance(actor, (Vehicle, Walker)):
            return True
        return actor.is_hero or any(child.type_id == COLLISION_SENSOR for child in actor.children)


def _is_hero(actor: Actor | None) -> bool:
    return actor is not None and actor.is_hero
