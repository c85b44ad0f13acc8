"""What CARLA's client raises where it cannot answer, and those actors of which it can."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import carla

UNREADABLE: Final = (ValueError, LookupError, OverflowError)
"""What the client raises where it does not understand what the server tells of an actor, as of a color '256,0,0'.

Boost.Python makes these of the exceptions of C++ that stand for bad values; of all others it makes RuntimeError.
"""
UNANSWERED: Final = (RuntimeError, *UNREADABLE)
"""What the client raises where a question is not answered."""


def readable(listed: carla.ActorList) -> list[carla.Actor]:
    """The actors of a list that the client can make out; where it cannot, iterating over the list ends in an error."""
    found = (_at(listed, place) for place in range(len(listed)))
    return [actor for actor in found if actor is not None]


def parent_of(actor: Any) -> carla.Actor | None:
    """Whom an actor is attached to, if the client can make that one out."""
    try:
        return actor.parent
    except UNREADABLE:
        return None


def _at(listed: carla.ActorList, place: int) -> carla.Actor | None:
    try:
        actor = listed[place]
        _ = actor.attributes  # not all of which need to be text
    except UNREADABLE:
        return None
    return actor
