"""The events of a recording as a replay gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carla_recap.model.lives import ActorLife


@dataclass(frozen=True, slots=True)
class Event:
    """An event at some elapsed seconds."""

    elapsed: float


@dataclass(frozen=True, slots=True)
class Spawned(Event):
    """An actor appeared; it is given as at the end of that frame."""

    actor: ActorLife


@dataclass(frozen=True, slots=True)
class Destroyed(Event):
    """An actor disappeared."""

    id: int


@dataclass(frozen=True, slots=True)
class Parented(Event):
    """An actor was attached to another one."""

    id: int
    parent: int


@dataclass(frozen=True, slots=True)
class Collided(Event):
    """Two actors touched; recorded in each frame of the contact."""

    number: int  # CARLA's number of the collision
    actor1: int  # the actor that has the sensor
    actor2: int  # what it touched; 4294967295 for a static object
    hero1: bool  # whether the first one is the hero
    hero2: bool  # whether the second one is
