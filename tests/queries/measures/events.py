"""The actors of a recording, and their contacts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import TYPES, ActorLives

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader


def events_of(reader: Reader) -> tuple[ActorLives, Contacts]:
    """Return the actors and contacts of a recording."""
    lives, contacts = ActorLives(), Contacts()
    for frame in reader.frames((*TYPES, "collisions"), sparse=True):
        contacts.add(frame)
        for packet in frame.packets:
            lives.add(packet, frame.elapsed)
    return lives, contacts
