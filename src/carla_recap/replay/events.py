"""The events of a recording as a replay gives them, and the actors that are present."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carla_recap.util.text import readable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.actors import BoundingBox
    from carla_recap.model.records import Spawn


@dataclass(frozen=True, slots=True)
class Present:
    """A present actor.

    Attributes:
        spawn: The record of its spawn: blueprint, attributes, pose (cm, degrees, left-handed).
        since: The elapsed seconds at which it appeared.
        parent: The actor that it is attached to, if any.
        attached: Whether it was attached when it was spawned: the pose of its spawn is then in the parent's axes.
        box: Its box in m, right-handed, if a valid one was recorded.
    """

    spawn: Spawn
    since: float
    parent: int | None = None
    attached: bool = False
    box: BoundingBox | None = None

    @property
    def id(self) -> int:
        """The actor id."""
        return self.spawn.id

    @property
    def kind(self) -> int:
        """The kind of actor; see `carla_recap.ActorKind`."""
        return self.spawn.kind

    @property
    def type_id(self) -> str:
        """The blueprint, such as vehicle.tesla.model3."""
        return readable(self.spawn.type_id)

    @property
    def role_name(self) -> str:
        """The attribute role_name, "" without one."""
        return readable(self.spawn.attribute("role_name") or "")

    @property
    def is_hero(self) -> bool:
        """Whether its role_name is hero."""
        return self.role_name == "hero"

    @property
    def spawn_pose(self) -> NDArray[np.float64]:
        """x, y, z in cm and roll, pitch, yaw in degrees, in the world; in the parent's axes if it is `attached`."""
        spawn = self.spawn
        return np.array((spawn.x, spawn.y, spawn.z, spawn.roll, spawn.pitch, spawn.yaw))


@dataclass(frozen=True, slots=True)
class Event:
    """An event at some elapsed seconds."""

    elapsed: float


@dataclass(frozen=True, slots=True)
class Spawned(Event):
    """An actor appeared; it is given as at the end of that frame."""

    actor: Present


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
    """Two actors touched; recorded in each frame of the contact.

    Attributes:
        number: CARLA's number of the collision.
        actor1: The actor that has the sensor.
        actor2: What it touched; 4294967295 for a static object.
        hero1: Whether the first one is the hero.
        hero2: Whether the second one is.
    """

    number: int
    actor1: int
    actor2: int
    hero1: bool
    hero2: bool
