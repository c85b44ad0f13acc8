"""What clients are told of actors and blueprints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.records import ActorKind
from carla_recap.server.structs import (
    ActorDefinition,
    ActorDescription,
    ActorRecord,
    Attribute,
    AttributeValue,
    BoundingBox,
)
from carla_recap.sim.blueprints import attribute_type
from carla_recap.sim.geometry import Location

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.streams import Streams
    from carla_recap.sim.actors import Actor
    from carla_recap.sim.blueprints import Blueprint

_TYPES_FROM: Final = 1  # the wire numbers the types of attributes from 1, recordings from 0
_STREAM: Final = 1 << 24  # streams of sensors are numbered from here, those of clients below
_TAGS: Final = {"car": 14, "van": 14, "truck": 15, "motorcycle": 18, "bicycle": 19}
_WALKER_TAG, _SIGN_TAG, _LIGHT_TAG, _PROP_TAG = 12, 8, 7, 20
_STREAMING: Final = "sensor."
_CLIENT_SIDE: Final = ("sensor.other.lane_invasion",)


def definition(blueprint: Blueprint) -> ActorDefinition:
    """A blueprint, as clients see it."""
    attributes = [
        Attribute(
            key,
            attribute_type(key) + _TYPES_FROM,
            value,
            list(blueprint.choices.get(key, ())),
            key not in _FIXED,
            restrict_to_recommended=False,
        )
        for key, value in blueprint.attributes.items()
    ]
    return ActorDefinition(blueprint.uid, blueprint.id, ",".join(blueprint.id.split(".")), attributes)


_FIXED: Final = frozenset(
    (
        "number_of_wheels",
        "generation",
        "base_type",
        "special_type",
        "object_type",
        "has_lights",
        "has_dynamic_doors",
        "gender",
        "age",
        "size",
    )
)


def record(actor: Actor, streams: Streams) -> ActorRecord:
    """An actor, as clients see it."""
    values = [AttributeValue(key, attribute_type(key) + _TYPES_FROM, value) for key, value in actor.attributes.items()]
    return ActorRecord(
        actor.id,
        actor.parent.id if actor.parent else 0,
        ActorDescription(actor.blueprint.uid, actor.type_id, values),
        box(actor),
        bytes(_tags(actor)),
        streams.token(stream_of(actor)) if streams_data(actor) else b"",
    )


def box(actor: Actor) -> BoundingBox:
    """The box around an actor, in its own axes."""
    centre = actor.box.location
    return BoundingBox(Location(centre.x, centre.y, centre.z), actor.box.extent, actor_id=actor.id)


def stream_of(actor: Actor) -> int:
    """The number of the stream of a sensor."""
    return _STREAM + actor.id


def streams_data(actor: Actor) -> bool:
    """Whether an actor has a stream; lane invasions are found by the client."""
    return actor.type_id.startswith(_STREAMING) and actor.type_id not in _CLIENT_SIDE


def _tags(actor: Actor) -> Iterable[int]:
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
