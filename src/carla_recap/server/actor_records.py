"""What clients are told of actors and blueprints."""

from __future__ import annotations

from functools import lru_cache
from math import cos, radians, sin
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.records import ActorKind
from carla_recap.server.attributes import readable_attributes
from carla_recap.server.ghosts import Ghost
from carla_recap.server.structs import (
    ActorDefinition,
    ActorDescription,
    ActorRecord,
    Attribute,
    AttributeValue,
    BoundingBox,
)
from carla_recap.server.wire import encoder
from carla_recap.sim.actors.actors import Sign
from carla_recap.sim.actors.attributes import attribute_type, is_restricted
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.streams import Streams
    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary

_TYPES_FROM: Final = 1  # the wire numbers the types of attributes from 1, recordings from 0
_STREAM: Final = 1 << 24  # streams of sensors are numbered from here, those of clients below
_TAGS: Final = {"car": 14, "van": 14, "truck": 15, "bus": 16, "motorcycle": 18, "bicycle": 19}
_WALKER_TAG, _SIGN_TAG, _LIGHT_TAG, _PROP_TAG = 12, 8, 7, 20
_BEFORE: Final = 2.0  # m: before the place where one stops is the middle of the box, so that it is not in the junction
_TRIGGER_HEIGHT: Final = 1.0  # m: half the height of the box where a light or sign is in force
_STREAMING: Final = "sensor."
_CLIENT_SIDE: Final = ("sensor.other.lane_invasion",)


def definition(blueprint: Blueprint) -> ActorDefinition:
    """Return a blueprint, as clients see it."""
    attributes = [
        Attribute(
            key,
            attribute_type(key) + _TYPES_FROM,
            value,
            list(blueprint.choices.get(key, ())),
            key in blueprint.choices,
            is_restricted(key),
        )
        for key, value in blueprint.attributes.items()
    ]
    return ActorDefinition(blueprint.uid, blueprint.id, ",".join(blueprint.id.split(".")), attributes)


@lru_cache(maxsize=1)
def encoded_definitions(library: BlueprintLibrary) -> Any:
    """Return all blueprints as they go over the wire: the same for every client, and asked for again and again."""
    return encoder(list[ActorDefinition])([definition(blueprint) for blueprint in library])


def record(actor: Actor | Ghost, streams: Streams) -> ActorRecord:
    """An actor, as clients see it; also one that has been destroyed."""
    if isinstance(actor, Ghost):
        attributes, parent = actor.attributes, None
    else:
        attributes = readable_attributes(actor.blueprint, actor.attributes, actor.context.blueprints)
        parent = actor.parent
    values = [AttributeValue(key, attribute_type(key) + _TYPES_FROM, value) for key, value in attributes.items()]
    return ActorRecord(
        actor.id,
        parent.id if parent else 0,
        ActorDescription(actor.blueprint.uid, actor.type_id, values),
        box(actor),
        bytes(_tags(actor)),
        streams.token(stream_of(actor)) if streams_data(actor) else b"",
    )


def box(actor: Actor | Ghost) -> BoundingBox:
    """The box around an actor, in its own axes; of a light or sign, where it is in force, as CARLA has it."""
    if isinstance(actor, Sign) and actor.signal.stops:
        return _trigger_volume(actor)
    centre = actor.box.location
    return BoundingBox(Location(centre.x, centre.y, centre.z), actor.box.extent, actor_id=actor.id)


def _trigger_volume(sign: Sign) -> BoundingBox:
    """The box before the places where one stops, on all lanes that are concerned; it is as long as a lane is wide."""
    town, there = sign.context.town, sign.transform
    lanes, s = zip(*sign.signal.stops, strict=True)
    halves = np.array([town.lanes[lane].width / 2 for lane in lanes])[:, None]
    away = town.index.at(lanes, np.maximum(np.array(s) - _BEFORE, 0.0))[0] - (
        there.location.x,
        there.location.y,
        there.location.z,
    )
    yaw = radians(there.rotation.yaw)
    places = away[:, :2] @ ((cos(yaw), -sin(yaw)), (sin(yaw), cos(yaw)))
    least, most = (places - halves).min(axis=0), (places + halves).max(axis=0)
    (x, y), (width, depth) = ((least + most) / 2).tolist(), ((most - least) / 2).tolist()
    centre = Location(x, y, float(away[:, 2].mean()) + _TRIGGER_HEIGHT)
    return BoundingBox(centre, Vector(width, depth, _TRIGGER_HEIGHT), actor_id=sign.id)


def stream_of(actor: Actor | Ghost) -> int:
    """The number of the stream of a sensor."""
    return _STREAM + actor.id


def sensor_of(stream: int) -> int:
    """The id of the sensor that a stream is of; below 0, if it is that of a client."""
    return stream - _STREAM


def tag(actor: Actor) -> int:
    """The semantic class of an actor; 0 where it has none."""
    return next(iter(_tags(actor)), 0)


def streams_data(actor: Actor | Ghost) -> bool:
    """Whether an actor has a stream; lane invasions are found by the client."""
    return actor.type_id.startswith(_STREAMING) and actor.type_id not in _CLIENT_SIDE


def _tags(actor: Actor | Ghost) -> Iterable[int]:
    match actor.kind:
        case ActorKind.VEHICLE:
            yield _TAGS.get(actor.attributes.get("base_type", ""), _TAGS["car"])
        case ActorKind.WALKER:
            yield _WALKER_TAG
        case ActorKind.TRAFFIC_LIGHT:
            yield _LIGHT_TAG
        case ActorKind.TRAFFIC_SIGN:
            yield _SIGN_TAG
        case _ if actor.type_id.startswith("static.prop."):
            yield _PROP_TAG
