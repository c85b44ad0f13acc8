"""Blueprints for the actors of recordings, those included that no library has."""

from __future__ import annotations

from dataclasses import replace
from difflib import SequenceMatcher
from typing import TYPE_CHECKING, Final

from carla_recap.records import ActorKind
from carla_recap.sim.actors.blueprints import Blueprint
from carla_recap.sim.geometry import Box, Location, Vector
from carla_recap.texts import readable

if TYPE_CHECKING:
    from carla_recap.queries.actors import BoundingBox
    from carla_recap.replay.events import Present
    from carla_recap.sim.actors.blueprints import BlueprintLibrary

_WHEELS: Final = "number_of_wheels"
_GENERIC: Final = Box(Location(0.0, 0.0, 0.5), Vector(0.5, 0.5, 0.5))


def blueprint_for(actor: Present, library: BlueprintLibrary) -> tuple[Blueprint, str]:
    """The blueprint of a recorded actor, under the name and with the attributes that it had.

    Of one that the library does not have, the rest is that of the nearest one: of its kind, with as many wheels if
    possible, with a name like its name, and of about its size if that is recorded; or a box, if there is none.

    Returns:
        The blueprint, and the name of the one in the library that it was made from, "" for a box.
    """
    known = actor.type_id in library
    model = library.get(actor.type_id) if known else _nearest(actor, library)
    attributes = {a.key: readable(a.value) for a in actor.spawn.attributes}
    if model is None:
        return Blueprint(actor.type_id, ActorKind.OTHER, attributes, _GENERIC), ""
    if known:
        return replace(model, attributes={**model.attributes, **attributes}), model.id
    box = model.box if actor.box is None else _box(actor.box)
    return replace(model, id=actor.type_id, attributes=attributes, box=box, uid=0), model.id


def _nearest(actor: Present, library: BlueprintLibrary) -> Blueprint | None:
    wheels = actor.spawn.attribute(_WHEELS)

    def strangeness(blueprint: Blueprint) -> tuple[bool, float]:
        likeness = SequenceMatcher(None, blueprint.id, actor.type_id, autojunk=False).ratio()
        return blueprint.attributes.get(_WHEELS) != wheels, _difference(actor.box, blueprint.box) - likeness

    kind = _kind(actor)
    return min((b for b in library if b.kind == kind), key=strangeness, default=None)


def _kind(actor: Present) -> int:
    """The kind of an actor by its name: older releases number the kinds otherwise."""
    family = actor.type_id.partition(".")[0]
    return {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER, "sensor": ActorKind.SENSOR}.get(family, actor.kind)


def _difference(box: BoundingBox | None, other: Box) -> float:
    """By how much two boxes differ in size, in m; 0 where one is not known."""
    if box is None:
        return 0.0
    extent = other.extent
    return abs(box.extent_x - extent.x) + abs(box.extent_y - extent.y) + abs(box.extent_z - extent.z)


def _box(box: BoundingBox) -> Box:
    return Box(Location(box.x, -box.y, box.z), Vector(box.extent_x, box.extent_y, box.extent_z))
