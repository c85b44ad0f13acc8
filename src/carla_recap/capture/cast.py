"""The actors of a server's world: who comes and goes, and the records of what they do, snapshot by snapshot."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.capture.asking import parent_of, readable
from carla_recap.capture.describing import CM_PER_M, attribute_types, kind_of, spawn
from carla_recap.errors import RecapWarning
from carla_recap.records import UE4, ActorKind
from carla_recap.replay.pose import detach

if TYPE_CHECKING:
    from collections.abc import Mapping

    import carla

    from carla_recap.capture.describing import Pose

    Rows = list[tuple[float, ...]]
    Found = Mapping[int, carla.ActorSnapshot]

OWN: Final = "carla-recap"
"""The role of sensors that watch for this package; they are left out."""

_WITH_PLACE: Final = (ActorKind.OTHER, ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds of actors whose transforms are told in each frame, as by CARLA 0.9.13 and later."""
_HERO: Final = "hero"


class Cast:
    """Follows who is in a world. What it holds is replaced, and never changed: another thread may be looking at it.

    Args:
        world: The world.
        additional_data: Tell of velocities, too.

    Attributes:
        actors: Those who are there, by id, in the order in which they came.
        heroes: The ids of all who are or were heroes.
        seen: The ids of all who are or were there.
    """

    def __init__(self, world: carla.World, *, additional_data: bool) -> None:
        self.actors: dict[int, carla.Actor] = {}
        self.heroes: frozenset[int] = frozenset()
        self.seen: frozenset[int] = frozenset()
        self._world = world
        self._additional = additional_data
        self._types = attribute_types(world.get_blueprint_library())
        self._ids: set[int] = set()  # of all in the last snapshot, those who are left out, too
        self._of: dict[ActorKind, dict[int, Any]] = {kind: {} for kind in ActorKind}

    def follow(self, found: Found) -> tuple[list[carla.Actor], list[int]]:
        """Take in who is in a snapshot; the server is asked about those who are new.

        Returns:
            Who came, and the ids of those who went.

        Warns:
            RecapWarning: Of somebody new the server tells what the client does not understand; that one is left out.
        """
        if found.keys() == self._ids:
            return [], []
        new = sorted(found.keys() - self._ids)
        self._ids = set(found)
        gone = [id for id in reversed(self.actors) if id not in found]  # children before their parents
        came = [actor for actor in self._told_of(new) if not _is_own(actor)] if new else []
        stay = {id: actor for id, actor in self.actors.items() if id in found}
        self.actors = stay | {actor.id: actor for actor in came}
        self.seen |= {actor.id for actor in came}
        self.heroes |= {actor.id for actor in came if actor.attributes.get("role_name") == _HERO}
        of: dict[ActorKind, dict[int, Any]] = {kind: {} for kind in ActorKind}
        for id, actor in self.actors.items():
            of[kind_of(actor.type_id)][id] = actor
        self._of = of
        return came, gone

    def of(self, kind: ActorKind) -> Mapping[int, Any]:
        """The actors of a kind, by id; the same object as long as nobody comes or goes."""
        return self._of[kind]

    def introduced(self, came: list[carla.Actor], found: Found, *, attached: bool) -> dict[str, Any]:
        """What is told of actors that come: their spawns, and their parents.

        Args:
            came: Who.
            found: Where they are.
            attached: Whether those with parents are placed upon these, as those are who come while it is recorded.
        """
        poses = {actor.id: _pose(found[actor.id]) for actor in came}
        parents = {actor.id: parent.id for actor in came if (parent := parent_of(actor)) is not None}
        if attached:
            for id, parent in parents.items():
                if parent in found:
                    x, y, z, roll, pitch, yaw = detach(np.array(_pose(found[parent])), np.array(poses[id])).tolist()
                    poses[id] = x, y, z, roll, pitch, yaw
        return {
            "spawned": [spawn(actor, poses[actor.id], self._types) for actor in came],
            "parented": list(parents.items()),
        }

    def records(self, found: Found, vehicle_lights: Mapping[int, int]) -> dict[str, Any]:
        """What a recording tells in each frame.

        Args:
            found: A snapshot of just these actors, the client's latest one.
            vehicle_lights: The lights of vehicles, as last known.
        """
        vehicles, walkers, lights = (self._of[kind] for kind in _EACH_FRAME)
        placed = [id for kind in _WITH_PLACE for id in self._of[kind]]
        rows: dict[str, Rows] = {
            "transforms": [(id, *_pose(found[id])) for id in sorted(placed)],
            "light_states": [
                (id, light.is_frozen(), light.get_elapsed_time(), int(light.get_state())) for id, light in lights.items()
            ],
            "vehicle_controls": [_control(id, vehicle.get_control()) for id, vehicle in vehicles.items()],
            "walker_controls": [(id, walker.get_control().speed * CM_PER_M) for id, walker in walkers.items()],
            "vehicle_lights": [(id, vehicle_lights.get(id, 0)) for id in vehicles],
        }
        if self._additional and (vehicles or walkers):
            rows["velocities"] = [_velocity(id, found[id]) for id in (*vehicles, *walkers)]
        return {name: np.array(told, UE4.named(name).dtype) for name, told in rows.items()}

    def _told_of(self, ids: list[int]) -> list[carla.Actor]:
        """Those of some ids whom the client can make out."""
        listed = self._world.get_actors(ids)
        actors = readable(listed)
        if len(actors) < len(listed):
            odd = ", ".join(map(str, sorted(set(ids) - {actor.id for actor in actors})))
            told = f"actors that CARLA's client cannot make out are left out: {odd}"
            warnings.warn(told, RecapWarning, stacklevel=2)
        return actors


_EACH_FRAME: Final = (ActorKind.VEHICLE, ActorKind.WALKER, ActorKind.TRAFFIC_LIGHT)


def _is_own(actor: carla.Actor) -> bool:
    return bool(actor.type_id.startswith("sensor.") and actor.attributes.get("role_name") == OWN)


def _pose(seen: carla.ActorSnapshot) -> Pose:
    transform = seen.get_transform()
    place, turn = transform.location, transform.rotation
    return place.x * CM_PER_M, place.y * CM_PER_M, place.z * CM_PER_M, turn.roll, turn.pitch, turn.yaw


def _velocity(id: int, seen: carla.ActorSnapshot) -> tuple[float, ...]:
    linear, angular = seen.get_velocity(), seen.get_angular_velocity()
    return id, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z


def _control(id: int, control: carla.VehicleControl) -> tuple[float, ...]:
    gear = -1 if control.reverse else control.gear
    return id, control.steer, control.throttle, control.brake, control.hand_brake, gear
