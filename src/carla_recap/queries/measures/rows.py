"""A row of the answer to the question how close, how hard and how fast an actor drives."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MeasureRow:
    """The extreme value of a measure of an actor in a recording, such as its least time to collision.

    Attributes:
        measure: The name, such as `time_to_collision`.
        actor: The id of the actor.
        type_id: Its blueprint.
        hero: Whether it is the hero.
        other: The id of the actor that the value is in relation to; None if there is none.
        other_type_id: Its blueprint; empty if there is none.
        value: The least or the greatest value, whichever is critical.
        unit: The unit of the value.
        time: When, in elapsed seconds.
    """

    measure: str
    actor: int
    type_id: str
    hero: bool
    other: int | None
    other_type_id: str
    value: float
    unit: str
    time: float
