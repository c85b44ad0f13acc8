"""The actors of a recording that is replayed, and the actors of the world that stand for them."""

from __future__ import annotations

import warnings
from dataclasses import replace
from difflib import SequenceMatcher
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.blueprints import other_names
from carla_recap.model.records import CM_PER_M, ActorKind
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor, Vehicle, Walker
from carla_recap.sim.actors.props import Prop
from carla_recap.sim.actors.spawning import place
from carla_recap.sim.blueprints import Blueprint
from carla_recap.sim.episode import LARGEST_WANTED
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Box, Location, Vector
from carla_recap.sim.physics.physics_control import expect_physics
from carla_recap.sim.recording.packets import physics_control, possible, transform
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from carla_recap.model.lives import ActorLife, BoundingBox
    from carla_recap.model.records import Physics
    from carla_recap.replay import Scene
    from carla_recap.sim.blueprints import BlueprintLibrary
    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.physics.physics_control import PhysicsControl

_NEAR: Final = 15.0  # m: the greatest distance between a recorded light or sign and the town's
_SPECTATOR: Final = "spectator"
_SENSOR: Final = "sensor."
TRAFFIC: Final = "traffic."
"""What the blueprints of lights and signs begin with."""
_WHEELS: Final = "number_of_wheels"
_DEFAULT_BOX: Final = Box(Location(0.0, 0.0, 0.5), Vector(0.5, 0.5, 0.5))


class ActorMapping:
    """Maps recorded actors to actors of the world, the replayed actors.

    A recorded actor is mapped to the actor of the world that has its id and blueprint; if there is none, to the one that has
    stayed of an earlier replay of the same recording; else one is spawned, with the recorded id unless another actor has, or
    had, it. Lights and signs are mapped to the nearest ones of the town, and the spectator to the spectator.

    Attributes:
        replayed: The actors of the world that follow the recording, by the ids of the recording.
        released: Those that have followed it, and go on by themselves, by the same ids.
        substitutes: Blueprints of the recording that are not in the library, and those that replace them.
        changes: The number of times that a replayed actor came or went.
    """

    def __init__(
        self, episode: Episode, *, replay_sensors: bool = False, earlier: Mapping[int, Actor] = MappingProxyType({})
    ) -> None:
        self._episode = episode
        self._earlier = earlier
        self._replay_sensors = replay_sensors
        self._spawned: set[int] = set()
        self._physics: dict[int, Physics | None] = {}
        self.replayed: dict[int, Actor] = {}
        self.released: dict[int, Actor] = {}
        self.substitutes: dict[str, str] = {}
        self.changes = 0

    @property
    def ids(self) -> Mapping[int, int]:
        """The ids of replayed and released actors by the ids of the recording."""
        return MappingProxyType({id: actor.id for id, actor in (self.replayed | self.released).items()})

    def add(self, actors: Iterable[ActorLife], scene: Scene) -> Iterator[None]:
        """Map recorded actors that appear, one in each step; those that are not in the scene are left out."""
        actors = [actor for actor in actors if actor.id in scene.actors]
        signs = [actor for actor in actors if actor.type_id.startswith(TRAFFIC)]
        self.replayed |= self._nearest(signs)
        self.changes += 1
        # an actor whose recorded id is taken shall not get the one of another
        self._episode.ids.reserve(max((actor.id for actor in actors if actor.id <= LARGEST_WANTED), default=0))
        taken = set(self.replayed.values())
        for actor in actors:
            if not actor.type_id.startswith(TRAFFIC) and (replayed := self._counterpart(actor, scene, taken)) is not None:
                self.replayed[actor.id] = replayed
                taken.add(replayed)
                _make_kinematic(replayed)
                self.changes += 1
                yield

    def remove(self, id: int) -> None:
        """Destroy the counterpart of a recorded actor that disappears; lights, signs and the spectator stay."""
        replayed = self.replayed.pop(id, None)
        self._spawned.discard(id)
        if replayed is not None and not replayed.is_of_town:
            replayed.destroy()
        self.changes += 1

    def release(self, id: int) -> None:
        """Release an actor, which is the caller's then: it outlives the replay, and its recorded counterpart."""
        self.released[id] = self.replayed.pop(id)
        self._spawned.discard(id)
        self.changes += 1

    def change_physics(self, actors: Mapping[int, ActorLife]) -> None:
        """Give replayed vehicles the physics that have been recorded since they were spawned."""
        for id, replayed in self.replayed.items():
            recorded = actors[id].physics if id in actors else None
            if recorded is not None and recorded is not self._physics.get(id) and isinstance(replayed, Vehicle):
                self._physics[id] = recorded
                control = _physics(actors[id], replayed.blueprint)
                if control is not None and control is not replayed.blueprint.physics:
                    replayed.physics_control = control

    def forget_dead(self) -> None:
        """Forget replayed actors that have been destroyed."""
        self.released = {id: actor for id, actor in self.released.items() if actor.is_alive}
        dead = [id for id, actor in self.replayed.items() if not actor.is_alive]
        for id in dead:
            del self.replayed[id]
            self._spawned.discard(id)
        self.changes += len(dead)

    def destroy_spawned(self) -> None:
        """Destroy the actors that were spawned for the replay."""
        for id in list(self._spawned):
            self.remove(id)

    def _counterpart(self, actor: ActorLife, scene: Scene, taken: set[Actor]) -> Actor | None:
        if actor.type_id == _SPECTATOR:
            return self._episode.spectator
        if actor.type_id.startswith(_SENSOR) and not self._replay_sensors:
            return None
        for same in (self._episode.actors.get(actor.id), self._earlier.get(actor.id)):
            if same is not None and same.is_alive and same not in taken and same.type_id == actor.type_id:
                return same
        return self._spawn(actor, scene)

    def _spawn(self, actor: ActorLife, scene: Scene) -> Actor | None:
        blueprint, model = blueprint_for(actor, self._episode.blueprints)
        id = actor.parent if actor.attached else None
        parent = None if id is None else self.released.get(id) or self.replayed.get(id)
        pose = scene.pose_of(actor.id) if parent is None else actor.spawn_pose
        if pose is None or not (parent is None or parent.is_alive):  # its parent is left out, or gone meanwhile
            return None
        pose = pose if possible(pose) else actor.spawn_pose
        try:
            spawned = place(self._episode, blueprint, transform(pose), parent, wanted_id=actor.id)
        except SimError as error:
            warnings.warn(f"{actor.name} is left out: {error}", RecapWarning, stacklevel=2)
            return None
        self._spawned.add(actor.id)
        self._physics[actor.id] = actor.physics
        if actor.type_id != model:
            self.substitutes[actor.type_id] = model
            if isinstance(spawned, Prop):
                spawned.set_collisions(False)  # its shape is unknown
        return spawned

    def _nearest(self, signs: Sequence[ActorLife]) -> dict[int, Actor]:
        """Map recorded signs to the nearest ones of the town, the nearest pairs first."""
        taken = set(self.replayed.values())
        free = [actor for actor in self._episode.actors.values() if isinstance(actor, Sign) and actor not in taken]
        if not signs or not free:
            return {}
        recorded = np.array([actor.spawn_pose[:3] for actor in signs]) / CM_PER_M
        positions = np.array([(at.x, at.y, at.z) for at in (actor.transform.location for actor in free)])
        distances = np.linalg.norm(recorded[:, None] - positions, axis=2)
        differ = np.array([[actor.type_id != other.type_id for other in free] for actor in signs])
        distances[differ] = np.inf
        found: dict[int, Actor] = {}
        used: set[int] = set()
        for pair in np.argsort(distances, axis=None, kind="stable").tolist():
            sign, other = divmod(pair, len(free))
            if not distances[sign, other] <= _NEAR:
                break
            if signs[sign].id not in found and other not in used:
                found[signs[sign].id] = free[other]
                used.add(other)
        return found


def _make_kinematic(actor: Actor) -> None:
    """Switch physics, autopilot and navigation of an actor off: only the replay moves it."""
    if isinstance(actor, MovingActor):
        actor.set_simulate_physics(False)
    if isinstance(actor, Vehicle):
        actor.set_autopilot(False)
    if isinstance(actor, Walker):
        actor.destination = None


def blueprint_for(actor: ActorLife, library: BlueprintLibrary) -> tuple[Blueprint, str]:
    """Return the blueprint of a recorded actor, with the id and the attributes that were recorded.

    A vehicle has the physics that were recorded, too.

    If the library does not have it, the rest is that of the blueprint with another name for it, else of the most similar
    one: of the same kind, with as many wheels if possible, with a similar id, and of a similar size if that is recorded; or
    a box, if there is none of its kind.

    The second value is the id of the one in the library that it was made from; "" for a box.
    """
    name = other_names().get(actor.type_id, actor.type_id)
    known = name in library and name == actor.type_id
    model = library.get(name) if name in library else _most_similar(actor, library)
    attributes = {a.key: readable(a.value) for a in actor.spawn.attributes}
    if model is None:
        return Blueprint(actor.type_id, ActorKind.OTHER, attributes, _DEFAULT_BOX), ""
    model = replace(model, physics=_physics(actor, model))
    if known:
        return replace(model, attributes={**model.attributes, **attributes}), model.id
    box = model.box if actor.bounding_box is None else _box(actor.bounding_box)
    return replace(model, id=actor.type_id, attributes=attributes, box=box, uid=0), model.id


def _physics(actor: ActorLife, model: Blueprint) -> PhysicsControl | None:
    """Return the physics that were recorded of a vehicle, else those of the blueprint."""
    if actor.physics is None or model.physics is None:
        return model.physics
    recorded = physics_control(actor.physics, actor.physics_pose or actor.spawn_pose.tolist(), model.physics)
    try:
        expect_physics(f"the recorded physics of {actor.name}", recorded)
    except SimError as error:
        warnings.warn(f"{error}; those of {model.id} are used", RecapWarning, stacklevel=2)
        return model.physics
    return recorded


def _most_similar(actor: ActorLife, library: BlueprintLibrary) -> Blueprint | None:
    wheels = actor.spawn.attribute(_WHEELS)

    def difference(blueprint: Blueprint) -> tuple[bool, float]:
        similarity = SequenceMatcher(None, blueprint.id, actor.type_id, autojunk=False).ratio()
        return blueprint.attributes.get(_WHEELS) != wheels, _size_difference(actor.bounding_box, blueprint.box) - similarity

    kind = _kind(actor)
    return min((b for b in library if b.kind == kind), key=difference, default=None)


def _kind(actor: ActorLife) -> int:
    """Return the kind of an actor by its blueprint: older releases number the kinds differently."""
    family = actor.type_id.partition(".")[0]
    return {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER, "sensor": ActorKind.SENSOR}.get(
        family, actor.spawn.kind
    )


def _size_difference(box: BoundingBox | None, other: Box) -> float:
    """Return the sum of the differences of the extents of two boxes, in m; 0 where one is unknown."""
    if box is None:
        return 0.0
    extent = other.extent
    return abs(box.extent_x - extent.x) + abs(box.extent_y - extent.y) + abs(box.extent_z - extent.z)


def _box(box: BoundingBox) -> Box:
    return Box(Location(box.x, -box.y, box.z), Vector(box.extent_x, box.extent_y, box.extent_z))
