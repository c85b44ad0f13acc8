"""The actors of a recording: when each appears and disappears, and its properties."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import ROAD_USERS, TYPES, ActorLife, ActorLives
from carla_recap.model.presence import RoadHeights
from carla_recap.queries import Answer

if TYPE_CHECKING:
    from collections.abc import Collection

    from carla_recap.formats.base import Reader


class RecordedActors(Answer[ActorLife]):
    """The actors of a recording, in order of appearance."""

    row_type = ActorLife
    row_units: ClassVar = {"spawned_at": "s", "destroyed_at": "s"}


def actors(source: Reader) -> RecordedActors:
    """Return the actors of a recording; on MCAP, they are read from the events alone."""
    lives = ActorLives()
    for frame in source.frames(TYPES, sparse=True):
        lives.add(frame.packets, frame.elapsed)
    return RecordedActors(lives, source, compat=False)


def never_there(source: Reader, lives: Collection[ActorLife]) -> set[int]:
    """Return the ids of vehicles and walkers, of all actors, that are away from the roads in all frames that have them.

    Frames are read until each vehicle and walker has been there.
    """
    heights, listed = RoadHeights(lives), set[int]()
    unseen = {actor.id for actor in lives if actor.kind in ROAD_USERS}
    for batch in source.batches(("transforms",)):
        if not unseen:
            break
        transforms = batch.records("transforms")
        away, ids = heights.away_in(transforms), transforms["id"]
        listed.update(np.unique(ids).tolist())
        unseen.difference_update(np.unique(ids[~away]).tolist())
    return unseen & listed


def lives_and_contacts(source: Reader, *, stop: float = math.inf) -> tuple[ActorLives, Contacts]:
    """Return the actors of a recording and their contacts until a time in elapsed seconds, read in one pass."""
    lives, contacts = ActorLives(), Contacts()
    for frame in source.frames((*TYPES, "collisions"), sparse=True, stop=stop):
        contacts.add(frame)
        lives.add(frame.packets, frame.elapsed)
    return lives, contacts
