"""Recorded collisions, as events of the ticks in which they are replayed.

Replayed actors move through each other, so that physics finds no collisions between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.lives import is_object
from carla_recap.sim.actors.actor import Collision
from carla_recap.sim.actors.motion import is_watched
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.replaying.actor_mapping import TRAFFIC

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import Collided, Scene
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.replaying.actor_mapping import ActorMapping
    from carla_recap.sim.replaying.kinematic import KinematicReplay
    from carla_recap.sim.world import World
    from carla_recap.util.arrays import Floats


_SAME_CONTACT: Final = 0.25  # s of the recording between two collisions of the same actors


class CollisionReplay:
    """Adds the recorded collisions of replayed actors to the events of the world.

    A collision is reported for the actor for which it was recorded, and for the other one if it is watched, as by two
    collision sensors. A light or sign that the town does not have counts as a barrier; collisions with other actors that are
    not replayed are left out. A pair of actors has one collision in a
    tick, however many frames of the recording pass in it.

    Recordings contain no impulses. That between two actors is the impulse of an inelastic impact along the line between
    their centres, from their masses and their recorded velocities before it, and 0 while the contact lasts. That with a
    barrier is the mass times the recorded change of velocity in the tick.

    Args:
        world: The world.
        mapping: The replayed actors.
        kinematic: What moves them.
    """

    def __init__(self, world: World, mapping: ActorMapping, kinematic: KinematicReplay) -> None:
        self._world = world
        self._mapping = mapping
        self._kinematic = kinematic
        self._collided: list[Collided] = []
        self._recorded: Mapping[int, ActorLife] = {}
        self._actors: dict[int, Actor] = {}
        self._velocities: dict[int, Floats] = {}
        self._latest: dict[tuple[int, int | None], float] = {}

    def prepare(self, scene: Scene) -> None:
        """Keep what is needed of the actors that collide, before they are moved to a scene, or destroyed."""
        self._collided, self._recorded, replayed = scene.collisions, scene.actors, self._mapping.replayed
        ids = {id for each in self._collided for id in (each.actor1, each.actor2)}
        self._actors = {id: replayed[id] for id in ids if id in replayed}
        self._velocities = {actor.id: self._velocity(actor) for actor in self._actors.values()}

    def report(self) -> None:
        """Add the collisions of that scene to the pending events, after the actors have moved."""
        if not self._collided:
            return
        actors = {**self._actors, **self._mapping.replayed}
        pairs: dict[tuple[int, int | None], tuple[Actor, Actor | None, Collided]] = {}
        for each in self._collided:
            first, second = actors.get(each.actor1), actors.get(each.actor2)
            if first is not None and (second is not None or self._is_barrier(each.actor2)):
                pairs.setdefault((first.id, None if second is None else second.id), (first, second, each))
        for first, second, each in list(pairs.values()):
            if second is not None and is_watched(second):
                pairs.setdefault((second.id, first.id), (second, first, each))
        for pair, (first, second, each) in pairs.items():
            is_new = not abs(each.elapsed - self._latest.get(pair, -np.inf)) < _SAME_CONTACT
            self._latest[pair] = each.elapsed
            self._world.pending.collisions.append(self._collision(first, second, each.number, is_new=is_new))

    def _is_barrier(self, id: int) -> bool:
        """Return whether a recorded id that stands for no actor of the world is that of something that never moves."""
        actor = self._recorded.get(id)
        return is_object(id, self._recorded) or (actor is not None and actor.type_id.startswith(TRAFFIC))

    def _collision(self, first: Actor, second: Actor | None, number: int, *, is_new: bool) -> Collision:
        if second is None:
            point, impulse = _position(first), self._impulse_of_barrier(first)
        else:
            point = (_position(first) + _position(second)) / 2
            impulse = self._impulse(first, second) if is_new else np.zeros(3)
        return Collision(
            first.id,
            None if second is None else second.id,
            Location(*point.tolist()),
            Vector(*impulse.tolist()),
            first.is_hero,
            second is not None and second.is_hero,
            number,
        )

    def _impulse(self, first: Actor, second: Actor) -> Floats:
        """Return the estimated impulse of an actor on the first one, in N s."""
        line = _position(first) - _position(second)
        line[2] = 0.0
        distance, per_mass = np.linalg.norm(line).item(), _per_mass(first) + _per_mass(second)
        if not distance or not per_mass:
            return np.zeros(3)
        line /= distance
        closing = float((self._velocity_before(second) - self._velocity_before(first)) @ line)
        return max(closing, 0.0) / per_mass * line

    def _impulse_of_barrier(self, actor: Actor) -> Floats:
        """Return the estimated impulse of a barrier on an actor, in N s."""
        per_mass = _per_mass(actor)
        return (self._velocity(actor) - self._velocity_before(actor)) / per_mass if per_mass else np.zeros(3)

    def _velocity_before(self, actor: Actor) -> Floats:
        return self._velocities.get(actor.id, np.zeros(3))

    def _velocity(self, actor: Actor) -> Floats:
        return np.array(self._kinematic.velocity(actor) if isinstance(actor, MovingActor) else (0.0, 0.0, 0.0))


def _position(actor: Actor) -> Floats:
    location = actor.transform.location
    return np.array((location.x, location.y, location.z))


def _per_mass(actor: Actor) -> float:
    """Return 1 through the mass of an actor in kg: 0 for one that nothing moves."""
    if not (isinstance(actor, MovingActor) and actor.is_alive):
        return 0.0
    mass: float = actor.rows.mass[actor.row].item()
    return 1.0 / max(mass, 1.0)
