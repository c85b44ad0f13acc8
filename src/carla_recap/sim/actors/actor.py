"""Actors with CARLA's vocabulary: what all have in common, those that do not move by themselves, and collisions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.lives import HERO
from carla_recap.sim.errors import DeadActor
from carla_recap.sim.geometry import Transform, Vector
from carla_recap.sim.physics.plane import PROP
from carla_recap.sim.validation import expect_transform

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pymunk

    from carla_recap.model.records import ActorKind
    from carla_recap.sim.actors.blueprints import Blueprint
    from carla_recap.sim.actors.registry import ActorRegistry
    from carla_recap.sim.geometry import Box, Location


class Actor:
    """Something in a world. `World.spawn` makes them.

    Attributes:
        context: The actors of the episode that it belongs to.
        id: Its number, never reused.
        blueprint: The blueprint that it was made from.
        attributes: Its attributes, as text.
        parent: The actor that it is attached to.
        children: The actors that are attached to it.
        is_alive: Whether it has not been destroyed.
        has_motion: Whether it has a motion of its own, and not that of its parent.
    """

    has_motion = False

    def __init__(
        self,
        context: ActorRegistry,
        id: int,
        blueprint: Blueprint,
        transform: Transform,
        attributes: dict[str, str] | None = None,
        parent: Actor | None = None,
    ) -> None:
        self.context = context
        self.id = id
        self.blueprint = blueprint
        self.attributes = {**blueprint.attributes, **(attributes or {})}
        self.parent = parent
        self.children: list[Actor] = []
        self.is_alive = True
        self._transform = transform.copy()
        if parent is not None:
            parent.children.append(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.id}, {self.type_id!r})"

    @property
    def type_id(self) -> str:
        """The name of its blueprint."""
        return self.blueprint.id

    @property
    def kind(self) -> ActorKind:
        """Its kind, as recordings number kinds."""
        return self.blueprint.kind

    @property
    def box(self) -> Box:
        """The box around it, in its own axes."""
        return self.blueprint.box

    def heights(self) -> tuple[float, float]:
        """Return the z of the lowest and of the highest point of its box in the world, in m."""
        return self.box.heights(self.transform)

    @property
    def is_hero(self) -> bool:
        """Whether its role name is hero."""
        return self.attributes.get("role_name") == HERO

    @property
    def transform(self) -> Transform:
        """A copy of its transform in the world. Setting it moves the actor; an attached one, relative to its parent."""
        return self._transform.copy() if self.parent is None or not self.is_alive else transforms([self])[0]

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform("the transform", value, of=self)
        self._transform = value.copy()

    @property
    def relative_transform(self) -> Transform:
        """Its transform relative to its parent; in the world, if it has none."""
        return self._transform.copy() if self.parent is not None else self.transform

    @property
    def velocity(self) -> Vector:
        """Its velocity in m/s."""
        return Vector() if (carrier := self._carrier()) is None else carrier.velocity

    @property
    def angular_velocity(self) -> Vector:
        """Its angular velocity in degrees/s."""
        return Vector() if (carrier := self._carrier()) is None else carrier.angular_velocity

    @property
    def acceleration(self) -> Vector:
        """Its acceleration in m/s²."""
        return Vector() if (carrier := self._carrier()) is None else carrier.acceleration

    def _carrier(self) -> Actor | None:
        """Return the nearest actor with a motion of its own among those that it is attached to."""
        carrier = self.parent
        while carrier is not None and not carrier.has_motion:
            carrier = carrier.parent
        return carrier

    def destroy(self) -> bool:
        """Destroy it and what is attached to it; return False if it had been destroyed before."""
        return self.context.destroy(self)

    def mark_destroyed(self) -> None:
        """Keep its last transform, and let everything that needs a live actor raise `DeadActor` from now on."""
        self._transform = self.transform
        self.is_alive = False

    def check(self) -> None:
        """Make sure that it is alive.

        Raises:
            DeadActor: It has been destroyed.
        """
        if not self.is_alive:
            raise DeadActor(f"actor {self.id} ({self.type_id}) has been destroyed")


class Prop(Actor):
    """A static object.

    Attributes:
        body: Its body in the plane; None if it is attached to something, or has no size.
    """

    body: pymunk.Body | None = None

    @property
    def transform(self) -> Transform:
        """A copy of its transform in the world. Setting it moves the prop; an attached one, relative to its parent."""
        return super().transform

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform("the transform", value, of=self)
        self._transform = value.copy()
        if self.body is not None:
            x, y = value.location.x, value.location.y
            self.context.plane.move(self.body, x, y, np.radians(value.rotation.yaw).item())

    def set_collisions(self, enabled: bool = True) -> None:
        """Let it collide with others, or be passed through."""
        self.check()
        if self.body is not None:
            self.context.plane.set_touching(self.body, PROP, enabled)


class Sensor(Actor):
    """A sensor: a collision sensor has the collisions of its parent recorded, the others do nothing by themselves."""


class Spectator(Actor):
    """The viewpoint of the user."""


def transforms(actors: Sequence[Actor]) -> list[Transform]:
    """Return the transforms of actors in the world; each transform that others are relative to is computed once."""
    found: dict[Actor, Transform] = {}
    for actor in actors:
        base, chain = actor, []
        while base not in found and base.parent is not None and base.is_alive and not base.has_motion:
            chain.append(base)
            base = base.parent
        found[base] = place = found.get(base) or base.transform
        for each in reversed(chain):
            found[each] = place = place.attached(each._transform)
    return [found[actor] for actor in actors]


def attached_transform(parent: Actor, relative: Transform) -> Transform:
    """Return the transform in the world of something attached to a parent."""
    return parent.transform.attached(relative)


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
