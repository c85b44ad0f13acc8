"""Actors that have been destroyed, and that clients still ask for: what is kept of each is small."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.server.attributes import readable_attributes

if TYPE_CHECKING:
    from carla_recap.records import ActorKind
    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.actors.blueprints import Blueprint
    from carla_recap.sim.geometry import Box, Transform

_MOST: Final = 10_000
"""So many of the latest ones are kept."""


@dataclass(frozen=True, slots=True)
class Ghost:
    """What is kept of an actor.

    Attributes:
        id: Its number.
        blueprint: What it was made from.
        changes: What it had, where that was not what its blueprint has.
        transform: Where it was at last.
    """

    id: int
    blueprint: Blueprint
    changes: tuple[tuple[str, str], ...]
    transform: Transform

    @property
    def type_id(self) -> str:
        """The name of its blueprint."""
        return self.blueprint.id

    @property
    def kind(self) -> ActorKind:
        """What it was, as recordings number it."""
        return self.blueprint.kind

    @property
    def box(self) -> Box:
        """The box around it, in its own axes."""
        return self.blueprint.box

    @property
    def attributes(self) -> dict[str, str]:
        """What it had."""
        return {**self.blueprint.attributes, **dict(self.changes)}


class Memory:
    """Knows the actors of a world, and the latest ones of those that are no more."""

    def __init__(self) -> None:
        self._alive: dict[int, Actor] = {}
        self._ghosts: OrderedDict[int, Ghost] = OrderedDict()

    def enter(self, actor: Actor) -> None:
        """Know an actor from now on."""
        self._alive[actor.id] = actor

    def bury(self, id: int) -> None:
        """Keep no more of an actor that has been destroyed than is needed."""
        actor = self._alive.pop(id, None)
        if actor is not None:
            self._ghosts[id] = _ghost(actor)
            if len(self._ghosts) > _MOST:
                self._ghosts.popitem(last=False)

    def bury_all(self) -> None:
        """Do the same with all who have been destroyed."""
        for actor in tuple(self._alive.values()):
            if not actor.is_alive:
                self.bury(actor.id)

    def find(self, id: int) -> Actor | Ghost | None:
        """Who has, or had, an id; None if that is not known."""
        return self._alive.get(id) or self._ghosts.get(id)


def _ghost(actor: Actor) -> Ghost:
    told = readable_attributes(actor.blueprint, actor.attributes, actor.context.blueprints)
    changes = tuple((key, value) for key, value in told.items() if actor.blueprint.attributes.get(key) != value)
    return Ghost(actor.id, actor.blueprint, changes, actor.transform)
