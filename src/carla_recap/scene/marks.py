"""Marks on the ground where actors have collided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import NO_ACTOR
from carla_recap.replay.events import Collided, Spawned
from carla_recap.replay.pose import LOCATION, right_handed
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.falls import is_new

if TYPE_CHECKING:
    from carla_recap.replay import SceneBatch
    from carla_recap.util.arrays import Floats


MARKED: Final = 5.0
"""The time in s for which a collision is marked after the last contact."""

MARK_RADIUS: Final = 1.1
"""The radius of a mark in m."""

MOST_MARKS: Final = 50
"""The number of marks at a time, the latest ones."""

_MARK_HEIGHT: Final = 0.03  # m above the ground
_SLACK: Final = 1e-6  # s


@dataclass
class _Mark:
    """A mark: its location in m, right-handed, and the elapsed seconds until which it is shown."""

    location: Floats
    until: float


class CollisionMarks:
    """The marks where actors have collided: from the first contact of two actors until some seconds after the last one."""

    def __init__(self) -> None:
        self._marks: dict[tuple[int, ...], _Mark] = {}  # by the two actors; with a third number, of an earlier life of one
        self._before: SceneBatch | None = None

    @property
    def locations(self) -> Floats:
        """Where the marks are after the latest batch, (marks, 3) in m, right-handed, a little above the ground."""
        return np.array([self._marks[pair].location for pair in self._shown()], np.float64).reshape(-1, 3)

    def changes(self, batch: SceneBatch, *, keep: bool = False) -> list[tuple[int, Floats]]:
        """Return the rows at which marks appear or disappear, and `locations` from then on.

        Each batch has to be given, in order; with `keep`, marks are kept in one that does not follow the one before.
        """
        shown = self._shown()
        if not keep and is_new(batch, self._before):
            self._marks.clear()
        self._before = batch
        self._remove(float(batch.time[0]))
        for event in batch.events:
            if isinstance(event, Collided):
                self._mark(event, batch)
            elif isinstance(event, Spawned) and not batch.fresh:
                own = event.actor.id
                self._marks = {(*pair, 0) if own in pair[:2] else pair: mark for pair, mark in self._marks.items()}
        found = [(0, self.locations)] if self._shown() != shown else []
        while self._marks:
            rows = np.flatnonzero(batch.time >= min(mark.until for mark in self._marks.values()))
            if not len(rows):
                break
            shown = self._shown()
            self._remove(float(batch.time[rows[0]]))
            if self._shown() != shown:
                found.append((int(rows[0]), self.locations))
        return found

    def shift(self, seconds: float) -> None:
        """Let elapsed times begin later, as those of a clip do."""
        for mark in self._marks.values():
            mark.until -= seconds

    def _shown(self) -> list[tuple[int, ...]]:
        """Return the pairs of actors whose marks are shown: the latest ones."""
        return list(self._marks)[-MOST_MARKS:]

    def _remove(self, time: float) -> None:
        """Remove the marks that are over."""
        self._marks = {pair: mark for pair, mark in self._marks.items() if not mark.until <= time}

    def _mark(self, contact: Collided, batch: SceneBatch) -> None:
        """Mark a contact: below the walker, if one was hit, else in the middle of both actors."""
        pair = min(contact.actor1, contact.actor2), max(contact.actor1, contact.actor2)
        until = float(batch.time[0]) + MARKED - _SLACK
        if pair in self._marks:
            self._marks[pair].until = until
            return
        feet = {id: foot for id in pair if id != NO_ACTOR and (foot := _foot(id, batch)) is not None}
        walkers = [foot for id, foot in feet.items() if id in batch.actors and batch.actors[id].kind == "walker"]
        if not feet:
            return
        location = np.mean(walkers or list(feet.values()), axis=0)
        location[2] += _MARK_HEIGHT
        self._marks[pair] = _Mark(location, until)


def _foot(id: int, batch: SceneBatch) -> Floats | None:
    """Return the location of an actor on the ground in m, right-handed; None if it is unknown."""
    pose = batch.pose_of(id, 0)
    if pose is None or not np.isfinite(pose).all():
        return None
    actor = batch.actors.get(id)
    look = None if actor is None else look_of_present(actor)
    bottom = 0.0 if look is None else look.center[2] - look.half_extents[2]
    return np.asarray(right_handed(pose)[LOCATION] + np.array((0.0, 0.0, bottom)))
