"""Collisions, as events of a tick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carla_recap.sim.geometry import Location, Vector


@dataclass(frozen=True, slots=True)
class Collision:
    """A collision of an actor that is watched: a hero, or one with a collision sensor.

    Attributes:
        actor1: The id of that actor.
        actor2: The id of the actor that it collided with; None for a barrier, which is no actor.
        location: The first point of contact; in a replay, the point halfway between the actors.
        impulse: The impulse on actor1 in N s; in a replay, an estimate.
        hero1: Whether actor1 is a hero.
        hero2: Whether actor2 is a hero.
        number: The number of the collision in its episode, from 0; in a replay, the recorded number.
    """

    actor1: int
    actor2: int | None
    location: Location
    impulse: Vector
    hero1: bool
    hero2: bool
    number: int
