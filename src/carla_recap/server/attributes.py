"""The values of attributes on the wire: the official client cannot read an actor with a value of the wrong type.

It reads all attributes of all actors as soon as it lists them, so that a single bad value costs every client its list
of actors (`ActorAttributeValue` in LibCarla).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.sensors.kinds import LARGEST_SIDE
from carla_recap.server.rpc.registry import CallError
from carla_recap.sim.actors.attributes import ATTRIBUTE_TYPES, attribute_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary

_SHOWN: Final = 60  # characters of a value in a message
_SIDES: Final = ("image_size_x", "image_size_y")


def check_attributes(blueprint: Blueprint, attributes: Mapping[str, str]) -> None:
    """Make sure that clients can read the attributes of an actor.

    Args:
        blueprint: The blueprint of the actor.
        attributes: The attributes that are set.

    Raises:
        CallError: An attribute has a value that is not of its type, or images would have no pixels, or too many.
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

    Args:
        blueprint: The blueprint of the actor; that of an actor of a recording has the recording's values.
        attributes: The attributes of the actor.
        library: The blueprints with the defaults.
    """
    readable = dict(attributes)
    for key, value in attributes.items():
        type = ATTRIBUTE_TYPES[attribute_type(key)]
        if not type.accepts(value):
            defaults = library.get(blueprint.id).attributes if blueprint.id in library else {}
            readable[key] = defaults.get(key, type.neutral)
    return readable
