"""The records of actors and blueprints that clients get, and a cache of destroyed actors, for which clients still ask.

The official client cannot read an actor with an attribute whose value is of the wrong type. It reads all attributes of all
actors as soon as it lists them, so that a single bad value costs every client its list (`ActorAttributeValue` in LibCarla).
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cache
from math import cos, radians, sin
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.records import ActorKind
from carla_recap.scene.appearance import BASE_TYPES
from carla_recap.scene.materials import Tag
from carla_recap.sensors.kinds import LARGEST_SIDE
from carla_recap.server.protocol.releases import DEFAULT, RELEASES, AttributeCode, Labels
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.registry import CallError
from carla_recap.server.rpc.structs import (
    ActorDefinition,
    ActorDescription,
    ActorRecord,
    AttributeDefinition,
    AttributeValue,
    BoxStruct,
)
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.attributes import ATTRIBUTE_TYPES, attribute_type, is_restricted
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.streams import Streams
    from carla_recap.sim.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Box, Transform


_FIRST_SENSOR_STREAM: Final = 1 << 24  # streams of sensors are numbered from here, those of snapshots below
_RELEASE: Final = 28  # bits before the number of a release in that of a stream
_BEFORE: Final = 2.0  # m, from the stop line back to the middle of the trigger volume, so that it is not in the junction
_TRIGGER_HEIGHT: Final = 1.0  # m: half the height of a trigger volume
_STREAMING: Final = "sensor."
_CLIENT_SIDE: Final = ("sensor.other.lane_invasion",)
_MOST_DESTROYED: Final = 10_000  # actors in the cache
_SHOWN: Final = 60  # characters of a value in a message
_SIDES: Final = ("image_size_x", "image_size_y")


@dataclass(frozen=True, slots=True)
class DestroyedActor:
    """What is kept of a destroyed actor: `changes` are the attributes that differ from the blueprint's."""

    id: int
    blueprint: Blueprint
    changes: tuple[tuple[str, str], ...]
    transform: Transform

    @property
    def type_id(self) -> str:
        """The id of its blueprint."""
        return self.blueprint.id

    @property
    def kind(self) -> ActorKind:
        """The kind of actor, as recordings number it."""
        return self.blueprint.kind

    @property
    def box(self) -> Box:
        """The box around it, in its own axes."""
        return self.blueprint.box

    @property
    def attributes(self) -> dict[str, str]:
        """Its attributes."""
        return {**self.blueprint.attributes, **dict(self.changes)}


class ActorCache:
    """The actors of a world, and the latest of the destroyed ones."""

    def __init__(self) -> None:
        self._alive: dict[int, Actor] = {}
        self._destroyed: OrderedDict[int, DestroyedActor] = OrderedDict()

    def add(self, actor: Actor) -> None:
        """Add an actor."""
        self._alive[actor.id] = actor

    def evict(self, id: int) -> None:
        """Replace an actor that has been destroyed by the little that is kept of it."""
        actor = self._alive.pop(id, None)
        if actor is not None:
            self._destroyed[id] = _destroyed(actor)
            if len(self._destroyed) > _MOST_DESTROYED:
                self._destroyed.popitem(last=False)

    def evict_destroyed(self) -> None:
        """Evict all actors that have been destroyed."""
        for actor in tuple(self._alive.values()):
            if not actor.is_alive:
                self.evict(actor.id)

    def find(self, id: int) -> Actor | DestroyedActor | None:
        """Return the actor of an id; None if it is unknown."""
        return self._alive.get(id) or self._destroyed.get(id)


def definition(blueprint: Blueprint) -> ActorDefinition:
    """Return the record of a blueprint."""
    attributes = [
        AttributeDefinition(
            key,
            AttributeCode(attribute_type(key)),
            value,
            list(blueprint.choices.get(key, ())),
            key in blueprint.choices,
            is_restricted(key),
        )
        for key, value in blueprint.attributes.items()
    ]
    return ActorDefinition(blueprint.uid, blueprint.id, ",".join(blueprint.id.split(".")), attributes)


@cache
def encoded_definitions(library: BlueprintLibrary, release: Release) -> Any:
    """Return the encoded records of all blueprints of a release: the same for each of its clients."""
    return encoder(list[ActorDefinition], release)([definition(blueprint) for blueprint in release.blueprints(library)])


def record(actor: Actor | DestroyedActor, streams: Streams, release: Release) -> ActorRecord:
    """Return the record of an actor, or of a destroyed one, for a client of a release."""
    if isinstance(actor, DestroyedActor):
        attributes, parent = actor.attributes, None
    else:
        attributes = readable_attributes(actor.blueprint, actor.attributes, actor.episode.blueprints)
        parent = actor.parent
    values = [AttributeValue(key, AttributeCode(attribute_type(key)), value) for key, value in attributes.items()]
    return ActorRecord(
        actor.id,
        parent.id if parent else 0,
        ActorDescription(actor.blueprint.uid, actor.type_id, values),
        box(actor),
        Labels(bytes(_tags(actor))),
        streams.token(stream_of(actor, release)) if streams_data(actor) else b"",
    )


def box(actor: Actor | DestroyedActor) -> BoxStruct:
    """Return the box around an actor, in its own axes; for a light or sign, the trigger volume, as in CARLA."""
    if isinstance(actor, Sign) and actor.signal.stops:
        return _trigger_volume(actor)
    centre = actor.box.location
    return BoxStruct(Location(centre.x, centre.y, centre.z), actor.box.extent, actor_id=actor.id)


def _trigger_volume(sign: Sign) -> BoxStruct:
    """Return the box before the stop lines, across all lanes concerned; it is as long as a lane is wide."""
    town, transform = sign.episode.town, sign.transform
    lanes, s = zip(*sign.signal.stops, strict=True)
    halves = np.array([town.lanes[lane].width / 2 for lane in lanes])[:, None]
    location = transform.location
    offsets = town.index.at(lanes, np.maximum(np.array(s) - _BEFORE, 0.0))[0] - (location.x, location.y, location.z)
    yaw = radians(transform.rotation.yaw)
    local = offsets[:, :2] @ ((cos(yaw), -sin(yaw)), (sin(yaw), cos(yaw)))
    least, most = (local - halves).min(axis=0), (local + halves).max(axis=0)
    (x, y), (width, depth) = ((least + most) / 2).tolist(), ((most - least) / 2).tolist()
    centre = Location(x, y, float(offsets[:, 2].mean()) + _TRIGGER_HEIGHT)
    return BoxStruct(centre, Vector(width, depth, _TRIGGER_HEIGHT), actor_id=sign.id)


def stream_of(actor: Actor | DestroyedActor, release: Release = DEFAULT) -> int:
    """Return the number of the stream of a sensor for clients of a release."""
    return (RELEASES.index(release) << _RELEASE) + _FIRST_SENSOR_STREAM + actor.id


def sensor_of(stream: int) -> int:
    """Return the id of the sensor of a stream; it is below 0 for a stream of snapshots."""
    return stream % (1 << _RELEASE) - _FIRST_SENSOR_STREAM


def release_of(stream: int) -> Release:
    """Return the release of the clients that a stream of a sensor is for; a client could subscribe to any number."""
    return RELEASES[min(stream >> _RELEASE, len(RELEASES) - 1)]


def tag(actor: Actor) -> int:
    """Return the semantic class of an actor; 0 if it has none."""
    return next(iter(_tags(actor)), 0)


def streams_data(actor: Actor | DestroyedActor) -> bool:
    """Return whether an actor has a stream; the client detects lane invasions itself."""
    return actor.type_id.startswith(_STREAMING) and actor.type_id not in _CLIENT_SIDE


def _tags(actor: Actor | DestroyedActor) -> Iterable[int]:
    match actor.kind:
        case ActorKind.VEHICLE:
            yield BASE_TYPES.get(actor.attributes.get("base_type", ""), Tag.CAR)
        case ActorKind.WALKER:
            yield Tag.PEDESTRIANS
        case ActorKind.TRAFFIC_LIGHT:
            yield Tag.TRAFFIC_LIGHT
        case ActorKind.TRAFFIC_SIGN:
            yield Tag.TRAFFIC_SIGNS
        case _ if actor.type_id.startswith("static.prop."):
            yield Tag.STATIC


def _destroyed(actor: Actor) -> DestroyedActor:
    attributes = readable_attributes(actor.blueprint, actor.attributes, actor.episode.blueprints)
    changes = tuple((key, value) for key, value in attributes.items() if actor.blueprint.attributes.get(key) != value)
    return DestroyedActor(actor.id, actor.blueprint, changes, actor.transform)


def check_attributes(blueprint: Blueprint, attributes: Mapping[str, str]) -> None:
    """Make sure that clients can read the attributes of an actor.

    A `CallError` is raised if one has a value that is not of its type, or images would have no pixels, or too many.
    """
    for key, value in attributes.items():
        if value == blueprint.attributes.get(key):
            continue
        type = ATTRIBUTE_TYPES[attribute_type(key)]
        expected = type.expected if not type.accepts(value) else ""
        if not expected and key in _SIDES and not 1 <= float(value) <= LARGEST_SIDE:
            expected = f"1 to {LARGEST_SIDE} pixels"
        if expected:
            raise CallError(f"{blueprint.id}: {key} of {value[:_SHOWN]!r}: expected {expected}")


def readable_attributes(blueprint: Blueprint, attributes: Mapping[str, str], library: BlueprintLibrary) -> dict[str, str]:
    """Return the attributes of an actor, with the defaults instead of values that clients could not read.

    The defaults are those of the library: the blueprint of an actor of a recording has the recording's values.
    """
    readable = dict(attributes)
    for key, value in attributes.items():
        type = ATTRIBUTE_TYPES[attribute_type(key)]
        if not type.accepts(value):
            defaults = library.get(blueprint.id).attributes if blueprint.id in library else {}
            readable[key] = defaults.get(key, type.neutral)
    return readable
