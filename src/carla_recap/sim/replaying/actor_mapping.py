"""Who plays whom in a replay: the actors of a recording, and the actors of the world that stand for them."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.actors import Mover, Prop, Sign, Spectator, Vehicle, Walker
from carla_recap.sim.recording.poses import CM_PER_M, transform
from carla_recap.sim.replaying.substitutes import blueprint_for

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from carla_recap.replay import Present, Scene
    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.interfaces import ReplayWorld

_NEAR: Final = 15.0  # m: a light or sign of the recording is none of the town's that is farther away
_SPECTATOR: Final = "spectator"
_SENSOR: Final = "sensor."
_TRAFFIC: Final = "traffic."


class Cast:
    """The actors of a replay.

    An actor of the world that has the id and the blueprint of one of the recording plays it; for others, one is spawned.
    Lights and signs are those of the town that are nearest to the recorded ones; the spectator is the spectator.

    Args:
        world: The world.
        replay_sensors: Spawn sensors, too.

    Attributes:
        roles: The actors of the world by the ids of the recording.
        substitutes: Blueprints of the recording that are not in the library, and what has been taken for them.
        changes: How often somebody came or went.
    """

    def __init__(self, world: ReplayWorld, *, replay_sensors: bool) -> None:
        self._world = world
        self._replay_sensors = replay_sensors
        self._spawned: set[int] = set()
        self.roles: dict[int, Actor] = {}
        self.substitutes: dict[str, str] = {}
        self.changes = 0

    @property
    def mapping(self) -> Mapping[int, int]:
        """Ids of the recording, and those of the actors that play them."""
        return MappingProxyType({id: actor.id for id, actor in self.roles.items()})

    def enter(self, actors: Iterable[Present], scene: Scene) -> None:
        """Let actors of the recording appear.

        Args:
            actors: They; who is gone by the moment of the scene does not appear.
            scene: Where they are.
        """
        actors = [actor for actor in actors if actor.id in scene.actors]
        signs = [actor for actor in actors if actor.type_id.startswith(_TRAFFIC)]
        self.roles |= self._nearest(signs)
        for actor in actors:
            if not actor.type_id.startswith(_TRAFFIC) and (player := self._player(actor, scene)) is not None:
                self.roles[actor.id] = player
                _take_over(player)
        self.changes += 1

    def leave(self, id: int) -> None:
        """Let an actor of the recording disappear, whoever it is that plays it; lights, signs and spectator stay."""
        player = self.roles.pop(id, None)
        self._spawned.discard(id)
        if player is not None and not isinstance(player, (Sign, Spectator)):
            self._world.destroy(player)
        self.changes += 1

    def forget_dead(self) -> None:
        """Go on without those that somebody else has destroyed."""
        dead = [id for id, player in self.roles.items() if not player.is_alive]
        for id in dead:
            del self.roles[id]
            self._spawned.discard(id)
        self.changes += len(dead)

    def dismiss(self) -> None:
        """Take those out of the world that were spawned for the replay."""
        for id in list(self._spawned):
            self.leave(id)

    def _player(self, actor: Present, scene: Scene) -> Actor | None:
        if actor.type_id == _SPECTATOR:
            return self._world.spectator
        if actor.type_id.startswith(_SENSOR) and not self._replay_sensors:
            return None
        there = self._world.actors.get(actor.id)
        if there is not None and there.type_id == actor.type_id and there not in self.roles.values():
            return there
        return self._spawn(actor, scene)

    def _spawn(self, actor: Present, scene: Scene) -> Actor | None:
        blueprint, model = blueprint_for(actor, self._world.blueprints)
        parent = self.roles.get(actor.parent) if actor.attached and actor.parent is not None else None
        pose = scene.pose_of(actor.id) if parent is None else actor.spawn_pose
        if pose is None:  # it is attached to somebody who is left out
            return None
        player = self._world.place(blueprint, transform(pose), parent=parent)
        self._spawned.add(actor.id)
        if actor.type_id not in self._world.blueprints:
            self.substitutes[actor.type_id] = model
            if isinstance(player, Prop):
                player.set_collisions(False)  # nobody knows its shape
        return player

    def _nearest(self, signs: Sequence[Present]) -> dict[int, Actor]:
        """For each sign the town's that is nearest, each for one: the nearest pairs first."""
        taken = list(self.roles.values())
        there = [actor for actor in self._world.actors.values() if isinstance(actor, Sign) and actor not in taken]
        if not signs or not there:
            return {}
        places = np.array([actor.spawn_pose[:3] for actor in signs]) / CM_PER_M
        others = np.array([(at.x, at.y, at.z) for at in (actor.transform.location for actor in there)])
        distances = np.linalg.norm(places[:, None] - others, axis=2)
        unlike = np.array([[actor.type_id != other.type_id for other in there] for actor in signs])
        distances[unlike] = np.inf
        found: dict[int, Actor] = {}
        for pair in np.argsort(distances, axis=None, kind="stable").tolist():
            sign, other = divmod(pair, len(there))
            if not distances[sign, other] <= _NEAR:
                break
            if signs[sign].id not in found and there[other] not in found.values():
                found[signs[sign].id] = there[other]
        return found


def _take_over(player: Actor) -> None:
    """Have an actor moved by nothing but the replay."""
    if isinstance(player, Mover):
        player.set_simulate_physics(False)
    if isinstance(player, Vehicle):
        player.set_autopilot(False)
    if isinstance(player, Walker):
        player.destination = None
