"""The actor that the camera follows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.lives import HERO, ROAD_USERS, ActorName, find_actor, heroes_of
from carla_recap.model.motion import FAULTY_SPEED, MOTION, possible_step
from carla_recap.model.records import CM
from carla_recap.queries.recorded_actors import actors
from carla_recap.replay.motion import numbers_of
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.selection import NO_IDS, Selection, array, latest, numbers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife
    from carla_recap.replay.scene import Scene

__all__ = ["HERO", "Follow", "LiveChoice", "choose_followed", "find_followed"]

Follow = ActorName

_MAX_STEP: Final = 0.5  # s; the longest step in which distances are measured
_PATIENCE: Final = 3.0  # s after which an actor is followed that does not move, in a running simulation
_MOVED: Final = 1.0  # cm from one frame to the next
_MIN_STEPS: Final = 100  # the number of steps in a short recording


def find_followed(reader: Reader, follow: Follow, *, ignore_hero: bool = False) -> int:
    """Return the id of the actor to follow.

    Raises:
        RecapError: The actor does not exist; the message names some that do.
    """
    known = actors(reader)
    found = find_actor(reader.location, known, follow, purpose="to follow")
    if ignore_hero and found.is_hero:
        others = [actor for actor in known if actor.id == found.id and not actor.is_hero]
        if follow == HERO or not others:
            raise RecapError(f"{reader.location}: the hero, actor {found.id}, cannot be followed and ignored")
    return found.id


def choose_followed(reader: Reader, *, start: float = 0.0, stop: float = math.inf, ignore_hero: bool = False) -> int | None:
    """Return the actor to follow by default: the hero, or the first one to collide, or the one that moves farthest.

    Only vehicles and walkers count as the first to collide; of those that move, vehicles come first, then walkers. To find
    the farthest, all transforms within the time are read. The actors count that are present between two moments, in elapsed
    seconds; None if nothing moves.
    """
    present = [actor for actor in actors(reader) if _is_present(actor, start, stop)]
    if ignore_hero:
        present = [actor for actor in present if not actor.is_hero]
    heroes = heroes_of(present)
    if heroes:
        return heroes[0].id
    kinds = {actor.id: actor.kind for actor in present if actor.type_id != "spectator"}
    collided = _first_to_collide(reader, {id for id in kinds if kinds[id] in ROAD_USERS}, start, stop)
    if collided is not None:
        return collided
    distances = _distances(reader, start, stop)
    for kind in (*ROAD_USERS, "other"):
        those = {id: distance for id, distance in distances.items() if kinds.get(id) == kind}
        if those and (max(those.values()) > 0 or kind != "other"):
            return max(those, key=those.__getitem__)
    return None


def _is_present(actor: ActorLife, start: float, stop: float) -> bool:
    return actor.spawned_at <= stop and actor.end > start


def _first_to_collide(reader: Reader, ids: set[int], start: float, stop: float) -> int | None:
    for frame in reader.frames(("collisions",), sparse=True, start=start):
        if frame.elapsed > stop:
            break
        for _, actor1, actor2, *_ in array(frame["collisions"]).tolist():
            for id in (actor1, actor2):
                if id in ids:
                    return int(id)
    return None


def _distances(reader: Reader, start: float, stop: float) -> dict[int, float]:
    """Return the distance, in cm, that each actor with transforms moves; jumps do not count."""
    step = min(_MAX_STEP, (min(stop, reader.extent().duration) - start) / _MIN_STEPS)
    selection, ids, here, rows = Selection(), NO_IDS, NO_IDS, np.zeros(0, np.intp)
    before, distance = np.zeros((0, 5)), np.zeros(0)  # x, y, z, the time and the speed of each where it was last
    for elapsed, transforms, velocities in _samples(reader, start, stop, step):
        chosen = selection.choose(transforms, NO_IDS)
        if selection.ids is not here:
            here, every = selection.ids, np.union1d(ids, selection.ids)
            added = np.searchsorted(ids, np.setdiff1d(every, ids))
            ids, before, distance = every, np.insert(before, added, np.nan, axis=0), np.insert(distance, added, 0.0)
            rows = np.searchsorted(ids, here)
        with np.errstate(invalid="ignore", over="ignore"):
            places, speeds = numbers(transforms)[chosen, LOCATION].astype(np.float64), np.full(len(here), np.nan)
            if velocities.size:
                speeds = np.sqrt((numbers_of(here, latest(velocities))[:, LOCATION] ** 2).sum(axis=1))
                speeds[~(speeds < FAULTY_SPEED)] = np.nan
            steps = np.sqrt(((places - before[rows, :3]) ** 2).sum(axis=1))
            possible = possible_step(elapsed - before[rows, 3], np.fmax(speeds, before[rows, 4]))
            distance[rows] += np.where(steps * CM <= possible, steps, 0.0)
        before[rows] = np.column_stack((places, np.full(len(here), elapsed), speeds))
    return dict(zip(ids.tolist(), distance.tolist(), strict=True))


def _samples(
    reader: Reader, start: float, stop: float, step: float
) -> Iterator[tuple[float, NDArray[np.void], NDArray[np.void]]]:
    """Yield the elapsed seconds, the transforms and the velocities of frames that are at least a step, in s, apart."""
    due = -math.inf
    for batch in reader.batches(MOTION, start=start):
        transforms, velocities = batch.records("transforms"), batch.records("velocities")
        row = int(np.searchsorted(batch.elapsed, due))
        while row < len(batch):
            elapsed = float(batch.elapsed[row])
            if elapsed > stop:
                return
            yield elapsed, transforms[row], velocities[row]
            due = elapsed + step
            row += 1 + int(np.searchsorted(batch.elapsed[row + 1 :], due))


class LiveChoice:
    """Chooses the actor that the camera follows while nothing is known of what comes.

    Args:
        follow: An id, or "hero": the hero as soon as there is one; until then, a vehicle that moves, else a walker that
            does; and if nothing has moved for some seconds, the first vehicle or walker.
    """

    def __init__(self, follow: Follow) -> None:
        self._follow = follow
        self._chosen: int | None = None
        self._since: float | None = None  # the time since which no actor is followed
        self._before: dict[int, NDArray[np.float64]] = {}

    def choose(self, scene: Scene) -> int | None:
        """Return the actor to follow from the next scene on; None if there is none."""
        if self._follow != HERO:
            return self._follow if self._follow in scene.actors else None
        if heroes := heroes_of(scene.actors.values()):
            self._chosen = heroes[0].id
        elif self._chosen not in scene.actors:
            self._chosen = self._other(scene)
        return self._chosen

    def _other(self, scene: Scene) -> int | None:
        if self._since is None:
            self._since = scene.time
        away = set(scene.ids[scene.batch.away[scene.row]].tolist())
        there = {id: actor.kind for id, actor in scene.actors.items() if id not in away}
        movers = {kind: [id for id in there if there[id] == kind] for kind in ROAD_USERS}
        here = {id: pose[LOCATION] for those in movers.values() for id in those if (pose := scene.pose_of(id)) is not None}
        before, self._before = self._before, here
        with np.errstate(invalid="ignore"):
            moved = {id for id in here if id in before and (np.abs(here[id] - before[id]) > _MOVED).any()}
        patient = scene.time - self._since < _PATIENCE
        for those in movers.values():
            found = next((id for id in those if id in moved), None)
            if found is not None:
                break
        else:
            found = None if patient else next((id for those in movers.values() for id in those if id in here), None)
        if found is not None:
            self._since, self._before = None, {}
        return found
