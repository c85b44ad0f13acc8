"""The actors of a recording: when each appears and disappears, and its properties."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from carla_recap.model.actors import TYPES, ActorLife, ActorLives
from carla_recap.queries import Answer

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader


class RecordedActors(Answer[ActorLife]):
    """The actors of a recording, in order of appearance."""

    row_type = ActorLife
    row_units: ClassVar = {"spawned_at": "s", "destroyed_at": "s"}


def actors(source: Reader) -> RecordedActors:
    """Return the actors of a recording; on MCAP, they are read from the events alone.

    Raises:
        FormatError: The file contradicts its format.
    """
    lives = ActorLives()
    for frame in source.frames(TYPES, sparse=True):
        for packet in frame.packets:
            lives.add(packet, frame.elapsed)
    return RecordedActors(lives, source, compat=False)
