"""Blueprints for recorded actors, including those that are not in the library."""

from __future__ import annotations

from dataclasses import replace
from difflib import SequenceMatcher
from typing import TYPE_CHECKING, Final

from carla_recap.model.records import ActorKind
from carla_recap.sim.actors.blueprints import Blueprint
from carla_recap.sim.geometry import Box, Location, Vector
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.model.actors import ActorLife, BoundingBox
    from carla_recap.sim.actors.blueprints import BlueprintLibrary

_WHEELS: Final = "number_of_wheels"
_DEFAULT_BOX: Final = Box(Location(0.0, 0.0, 0.5), Vector(0.5, 0.5, 0.5))


def blueprint_for(actor: ActorLife, library: BlueprintLibrary) -> tuple[Blueprint, str]:
    """Return the blueprint of a recorded actor, with the id and the attributes that were recorded.

    If the library does not have it, the rest is that of the most similar one: of the same kind, with as many wheels if
    possible, with a similar id, and of a similar size if that is recorded; or a box, if there is none of its kind.

    Returns:
        The blueprint, and the id of the one in the library that it was made from; "" for a box.
    """
    known = actor.type_id in library
    model = library.get(actor.type_id) if known else _most_similar(actor, library)
    attributes = {a.key: readable(a.value) for a in actor.spawn.attributes}
    if model is None:
        return Blueprint(actor.type_id, ActorKind.OTHER, attributes, _DEFAULT_BOX), ""
    if known:
        return replace(model, attributes={**model.attributes, **attributes}), model.id
    box = model.box if actor.bounding_box is None else _box(actor.bounding_box)
    return replace(model, id=actor.type_id, attributes=attributes, box=box, uid=0), model.id


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
