"""The actors of a server's world as its client sees them: which come and go, and their records, snapshot by snapshot."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Final

import carla
import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.lives import HERO
from carla_recap.model.packets import WITH_POSE, box_row, physics_record, pose, wheel_row
from carla_recap.model.records import CM_PER_M, UE4, ActorKind, Attribute, Spawn
from carla_recap.replay.pose import detach
from carla_recap.sim.attributes import attribute_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.model.packets import Pose, Row
    from carla_recap.model.records import Physics

    Types = dict[str, dict[str, int]]
    Rows = list[tuple[float, ...]]
    Snapshots = Mapping[int, carla.ActorSnapshot]

UNREADABLE: Final = (ValueError, LookupError, OverflowError)
"""What CARLA's client raises for data of an actor that it cannot read, such as a color '256,0,0'.

Boost.Python makes these of the C++ exceptions for bad values, and RuntimeError of all others.
"""
UNANSWERED: Final = (RuntimeError, *UNREADABLE)
"""What CARLA's client raises if a request is not answered."""
OWN: Final = "carla-recap"
"""The role of this package's own sensors, which are left out."""
_FIRST_TYPE: Final = int(carla.ActorAttributeType.Bool)  # releases number types from 0 or 1, recordings from 0
_KINDS: Final = {
    "vehicle.": ActorKind.VEHICLE,
    "walker.": ActorKind.WALKER,
    "traffic.traffic_light": ActorKind.TRAFFIC_LIGHT,
    "traffic.": ActorKind.TRAFFIC_SIGN,
    "sensor.": ActorKind.SENSOR,
}
_EACH_FRAME: Final = (ActorKind.VEHICLE, ActorKind.WALKER, ActorKind.TRAFFIC_LIGHT)


class ActorTracker:
    """Tracks the actors of a world. Its attributes are replaced, never changed: another thread may be reading them.

    Attributes:
        actors: The present actors, by id, in the order in which they came.
        heroes: The ids of all actors that are or were heroes.
        seen: The ids of all actors that are or were present.
        present: The ids of the present actors, including those that are left out.
    """

    def __init__(self, world: carla.World, *, additional_data: bool) -> None:
        self.actors: dict[int, carla.Actor] = {}
        self.heroes: frozenset[int] = frozenset()
        self.seen: frozenset[int] = frozenset()
        self.present: frozenset[int] = frozenset()
        self._world = world
        self._additional = additional_data
        self._types = attribute_types(world.get_blueprint_library())
        self._of: dict[ActorKind, dict[int, Any]] = {kind: {} for kind in ActorKind}

    def update(self, snapshots: Snapshots) -> tuple[list[carla.Actor], list[int]]:
        """Take in the actors of a snapshot; return the actors that came, and the ids of those that went.

        The server is asked about new ones; a `RecapWarning` says which the client cannot read: they are left out.
        """
        if snapshots.keys() == self.present:
            return [], []
        new = sorted(snapshots.keys() - self.present)
        self.present = frozenset(snapshots)
        gone = [id for id in reversed(self.actors) if id not in snapshots]  # children before their parents
        came = [actor for actor in self._asked(new) if not _is_own(actor)] if new else []
        stay = {id: actor for id, actor in self.actors.items() if id in snapshots}
        self.actors = stay | {actor.id: actor for actor in came}
        self.seen |= {actor.id for actor in came}
        self.heroes |= {actor.id for actor in came if actor.attributes.get("role_name") == HERO}
        of: dict[ActorKind, dict[int, Any]] = {kind: {} for kind in ActorKind}
        for id, actor in self.actors.items():
            of[kind_of(actor.type_id)][id] = actor
        self._of = of
        return came, gone

    def of(self, kind: ActorKind) -> Mapping[int, Any]:
        """Return the actors of a kind, by id; the same object as long as no actor comes or goes."""
        return self._of[kind]

    def introduction(self, came: list[carla.Actor], snapshots: Snapshots, *, attached: bool) -> dict[str, Any]:
        """Return the spawns and the parents of actors that come.

        If they are `attached`, those with parents have poses relative to these, as recorders write them after the beginning.
        """
        poses = {actor.id: pose(snapshots[actor.id].get_transform()) for actor in came}
        parents = {actor.id: parent.id for actor in came if (parent := parent_of(actor)) is not None}
        if attached:
            for id, parent in parents.items():
                if parent in snapshots:
                    place = np.array(pose(snapshots[parent].get_transform()))
                    x, y, z, roll, pitch, yaw = detach(place, np.array(poses[id])).tolist()
                    poses[id] = x, y, z, roll, pitch, yaw
        return {
            "spawned": [spawn(actor, poses[actor.id], self._types) for actor in came],
            "parented": list(parents.items()),
        }

    def records(self, snapshots: Snapshots, vehicle_lights: Mapping[int, int]) -> dict[str, Any]:
        """Return the records of a frame out of a snapshot of just these actors; lights of vehicles are those last known."""
        vehicles, walkers, lights = (self._of[kind] for kind in _EACH_FRAME)
        with_pose = [id for kind in WITH_POSE for id in self._of[kind]]
        rows: dict[str, Rows] = {
            "transforms": [(id, *pose(snapshots[id].get_transform())) for id in sorted(with_pose)],
            "light_states": [
                (id, light.is_frozen(), light.get_elapsed_time(), int(light.get_state())) for id, light in lights.items()
            ],
            "vehicle_controls": [_control(id, vehicle.get_control()) for id, vehicle in vehicles.items()],
            "walker_controls": [(id, walker.get_control().speed * CM_PER_M) for id, walker in walkers.items()],
            "vehicle_lights": [(id, vehicle_lights.get(id, 0)) for id in vehicles],
        }
        if self._additional and (vehicles or walkers):
            rows["velocities"] = [_velocity(id, snapshots[id]) for id in (*vehicles, *walkers)]
        return {name: np.array(values, UE4.named(name).dtype) for name, values in rows.items()}

    def _asked(self, ids: list[int]) -> list[carla.Actor]:
        """Return the actors of some ids that the client can read."""
        listed = self._world.get_actors(ids)
        actors = readable(listed)
        if len(actors) < len(listed):
            unreadable = ", ".join(map(str, sorted(set(ids) - {actor.id for actor in actors})))
            text = f"actors that CARLA's client cannot make out are left out: {unreadable}"
            warnings.warn(text, RecapWarning, stacklevel=2)
        return actors


def readable(listed: carla.ActorList) -> list[carla.Actor]:
    """Return the actors of a list that the client can read; iterating raises an error at the first unreadable one."""
    found = (_actor_at(listed, index) for index in range(len(listed)))
    return [actor for actor in found if actor is not None]


def parent_of(actor: Any) -> carla.Actor | None:
    """Return the parent of an actor, if it has one that the client can read."""
    try:
        return actor.parent
    except UNREADABLE:
        return None


def _actor_at(listed: carla.ActorList, index: int) -> carla.Actor | None:
    try:
        actor = listed[index]
        _ = actor.attributes  # not all of which need to be text
    except UNREADABLE:
        return None
    return actor


def _is_own(actor: carla.Actor) -> bool:
    return bool(actor.type_id.startswith("sensor.") and actor.attributes.get("role_name") == OWN)


# --- the records of single actors, as far as a client gets their data ------------------------------------


def kind_of(type_id: str) -> ActorKind:
    """Return the kind of an actor, by its blueprint."""
    return next((kind for begin, kind in _KINDS.items() if type_id.startswith(begin)), ActorKind.OTHER)


def attribute_types(library: carla.BlueprintLibrary) -> Types:
    """Return the types of the attributes of each blueprint, as recordings number them."""
    return {blueprint.id: {each.id: int(each.type) - _FIRST_TYPE for each in blueprint} for blueprint in library}


def spawn(actor: carla.Actor, pose: Pose, types: Types) -> Spawn:
    """Return the spawn of an actor, at a pose in cm and degrees; clients do not get the number of its blueprint."""
    known, given = types.get(actor.type_id, {}), actor.attributes.items()
    attributes = [Attribute(known.get(key, attribute_type(key)), key, value) for key, value in given if key]
    return Spawn(actor.id, kind_of(actor.type_id), *pose, type_id=actor.type_id, attributes=attributes)


def bounding_box(actor: carla.Actor) -> list[Row]:
    """Return the box of an actor, in its own axes, if it has one; asks the server."""
    volume = actor.bounding_box
    return [box_row(actor.id, volume.location, volume.extent)] if volume.extent.length() > 0 else []


def trigger_volume(sign: carla.TrafficSign) -> list[Row]:
    """Return the trigger volume of a light or sign, if it has one."""
    volume = sign.trigger_volume
    if not volume.extent.length():
        return []
    return [box_row(sign.id, sign.get_transform().transform(volume.location), volume.extent)]


def light_times(light: carla.TrafficLight) -> Row:
    """Return the times of a traffic light, in s."""
    return light.id, light.get_green_time(), light.get_yellow_time(), light.get_red_time()


def physics(vehicle: carla.Vehicle) -> list[Physics]:
    """Return the physics of a vehicle, if they are described as in 0.9; asks the server."""
    control = vehicle.get_physics_control()
    if not hasattr(control, "moi"):  # 0.10's, for which there is no record
        return []
    torque_curve, steering_curve = (((at.x, at.y) for at in each) for each in (control.torque_curve, control.steering_curve))
    wheels = (wheel_row(wheel, (wheel.position.x, wheel.position.y, wheel.position.z)) for wheel in control.wheels)
    return [physics_record(vehicle.id, control, torque_curve, steering_curve, wheels)]


def _velocity(id: int, snapshot: carla.ActorSnapshot) -> tuple[float, ...]:
    linear, angular = snapshot.get_velocity(), snapshot.get_angular_velocity()
    return id, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z


def _control(id: int, control: carla.VehicleControl) -> tuple[float, ...]:
    gear = -1 if control.reverse else control.gear
    return id, control.steer, control.throttle, control.brake, control.hand_brake, gear
