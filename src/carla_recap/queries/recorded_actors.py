"""The actors of a recording: when each appears and disappears, and its properties."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from carla_recap.model.contacts import Contacts
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ROAD_USERS, TYPES, ActorLife, ActorLives
from carla_recap.model.presence import RoadHeights
from carla_recap.queries import Answer

if TYPE_CHECKING:
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


def never_there(source: Reader, lives: ActorLives) -> set[tuple[int, float]]:
    """Return the keys of vehicles and walkers that are away from the roads in all frames that have them.

    Frames are read until each vehicle and walker has been there.
    """
    heights, listed, there = RoadHeights(list(lives)), set[tuple[int, float]](), set[tuple[int, float]]()
    users = {actor.key for actor in lives if actor.kind in ROAD_USERS}
    spawns = np.sort([time for times in lives.reuses().values() for time in times])
    latest, known = -1, (set[int](), set[int]())  # the number of spawns before, and the ids that were listed and there since
    for batch in source.batches(("transforms",)):
        if users <= there:
            break
        transforms = batch.records("transforms")
        away, ids = heights.away_in(transforms), transforms["id"]
        number = np.searchsorted(spawns, batch.elapsed + SAME_TIME, "right")
        for each in np.unique(number).tolist():
            if each != latest:
                latest, known = each, (set[int](), set[int]())
            rows = number == each
            time = float(batch.elapsed[rows][0]) + SAME_TIME
            for keys, before, found in zip((listed, there), known, (ids[rows], ids[rows][~away[rows]]), strict=True):
                new = set(np.unique(found).tolist()) - before
                before |= new
                keys |= {life.key for id in new if (life := lives.at(id, time))}
    return (users - there) & listed


def lives_and_contacts(source: Reader, *, stop: float = math.inf) -> tuple[ActorLives, Contacts]:
    """Return the actors of a recording and their contacts until a time in elapsed seconds, read in one pass."""
    lives, contacts = ActorLives(), Contacts()
    for frame in source.frames((*TYPES, "collisions"), sparse=True, stop=stop):
        contacts.add(frame)
        lives.add(frame.packets, frame.elapsed)
    for contact in contacts:
        contact.actors = tuple(lives.at(id, contact.start + SAME_TIME) for id in contact.ids)
    return lives, contacts
