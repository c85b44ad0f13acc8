"""Whom the camera follows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.queries.actors import actors
from carla_recap.replay.motion import JUMP, TOP_SPEED
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.rows import NO_IDS, Ids, Selection, array, numbers, places

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.queries.actors import Actor

HERO: Final = "hero"
Follow = int | Literal["hero"]

_SAMPLE: Final = 0.5  # s; ways are measured in steps of so much at the most
_SAMPLES: Final = 100  # in a short recording, in at least so many


def find_followed(reader: Reader, follow: Follow, *, ignore_hero: bool = False) -> int:
    """The id of the actor to follow.

    Args:
        reader: The recording.
        follow: An id, or "hero": the first actor with that role name.
        ignore_hero: Whether the hero is left out, so that it cannot be followed.

    Raises:
        RecapError: There is no such actor; the message lists near ids.
    """
    there = actors(reader)
    matching = [actor for actor in there if (actor.is_hero if follow == HERO else actor.id == follow)]
    if matching:
        if ignore_hero and all(actor.is_hero for actor in matching):
            raise RecapError(f"{reader.path}: the hero, actor {matching[0].id}, cannot be followed and ignored")
        return matching[0].id
    if follow == HERO:
        raise RecapError(f"{reader.path}: there is no hero to follow (no actor has the role_name hero)")
    if not isinstance(follow, int):
        raise RecapError(f"{reader.path}: an actor id or 'hero' was expected to follow, found {follow!r}")
    near = sorted({actor.id for actor in there}, key=lambda id: abs(id - follow))[:3]
    raise RecapError(f"{reader.path}: no actor {follow} to follow; near ids are {', '.join(map(str, near)) or 'none'}")


def choose_followed(reader: Reader, *, start: float = 0.0, stop: float = math.inf, ignore_hero: bool = False) -> int | None:
    """Whom to follow when nobody is named: the hero, else the first vehicle or walker that collides, else who goes farthest.

    Vehicles come before walkers, and both before others. The last choice reads all transforms within the time.

    Args:
        reader: The recording.
        start: From when on, in elapsed seconds.
        stop: Until when.
        ignore_hero: Choose somebody else.

    Returns:
        An id; None where nothing moves.
    """
    there = [actor for actor in actors(reader) if _is_there(actor, start, stop)]
    if ignore_hero:
        there = [actor for actor in there if not actor.is_hero]
    hero = next((actor.id for actor in there if actor.is_hero), None)
    if hero is not None:
        return hero
    kinds = {actor.id: actor.kind for actor in there if actor.type_id != "spectator"}
    collided = _first_to_collide(reader, {id for id in kinds if kinds[id] in ("vehicle", "walker")}, start, stop)
    if collided is not None:
        return collided
    ways = _ways(reader, start, stop)
    for wanted in (("vehicle",), ("walker",), ("other",)):
        those = {id: way for id, way in ways.items() if kinds.get(id) in wanted}
        if those and (max(those.values()) > 0 or wanted != ("other",)):
            return max(those, key=those.__getitem__)
    return None


def _is_there(actor: Actor, start: float, stop: float) -> bool:
    return actor.spawned_at <= stop and (actor.destroyed_at is None or actor.destroyed_at > start)


def _first_to_collide(reader: Reader, ids: set[int], start: float, stop: float) -> int | None:
    for frame in reader.frames(("collisions",), sparse=True, start=start):
        if frame.elapsed > stop:
            break
        for _, actor1, actor2, *_ in array(frame["collisions"]).tolist():
            for id in (actor1, actor2):
                if id in ids:
                    return int(id)
    return None


def _ways(reader: Reader, start: float, stop: float) -> dict[int, float]:
    """How far, in cm, each actor goes that has transforms; jumps do not count."""
    span = min(stop, reader.extent().duration) - start
    sample = min(_SAMPLE, span / _SAMPLES)
    ways: dict[int, float] = {}
    selection = Selection()
    ids, locations, way, due, before = NO_IDS, np.zeros((0, 3)), np.zeros(0), -math.inf, 0.0
    for frame in reader.frames(("transforms",), start=start):
        if frame.elapsed > stop:
            break
        if frame.elapsed < due:
            continue
        records = array(frame["transforms"])
        with np.errstate(invalid="ignore"):  # a NaN that signals
            now = numbers(records)[selection.choose(records, NO_IDS), LOCATION].astype(np.float64)
        if selection.ids is not ids:
            _add(ways, ids, way)
            where, found = places(selection.ids, ids)
            locations = np.where(found[:, None], locations[where], now) if len(ids) else now
            ids, way = selection.ids, np.zeros(len(now))
        with np.errstate(invalid="ignore", over="ignore"):
            steps = np.sqrt(((now - locations) ** 2).sum(axis=1))
        possible = max(JUMP, TOP_SPEED * (frame.elapsed - before))
        way += np.where(steps <= possible, steps, 0)
        locations, before, due = now, frame.elapsed, frame.elapsed + sample
    _add(ways, ids, way)
    return ways


def _add(ways: dict[int, float], ids: Ids, way: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    for id, more in zip(ids.tolist(), way.tolist(), strict=True):
        ways[id] = ways.get(id, 0.0) + more
