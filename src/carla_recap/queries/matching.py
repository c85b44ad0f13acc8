"""Which actor of one recording is which of another, of the same scenario: ids differ between runs."""

from __future__ import annotations

from collections import Counter, defaultdict
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator, Sequence

    from carla_recap.model.lives import ActorLife
    from carla_recap.util.arrays import Floats

MatchedBy = Literal["role", "birth", "position", "parent", "order", "id"]
"""How two actors were recognized as the same.

role: their role_name, which no other actor of the kind has. birth: blueprint, place and time of their spawn. position: that
of a traffic light or sign. parent: what they are attached to, and their blueprint. order: they are the n-th of a blueprint
to appear, not far from each other. id: their id, if nothing else is known.
"""

SAME_PLACE: Final = 0.5
"""The distance between spawns of the same actor, in m, at most."""
SAME_BIRTH: Final = 1.0
"""The seconds between spawns of the same actor, at most."""
NEAR: Final = 10.0
"""The distance between spawns of two actors that are matched by their order, in m, at most; also if it is unknown."""

_STATIC: Final = ("traffic_light", "traffic_sign")


class Match(NamedTuple):
    """The numbers of an actor among those of one recording and of another, and how it was recognized."""

    a: int
    b: int
    by: MatchedBy


def match(a: Sequence[ActorLife], b: Sequence[ActorLife]) -> list[Match]:
    """Return the actors that are in both of two recordings, in the order of the first one.

    The rules, each for the actors that the ones before have left: a role_name that is unique in both recordings; blueprint,
    place (0.5 m) and time (1 s) of the spawn, the nearest first, and the same id among equals; of lights and signs, the
    position alone; of what is attached to something, its blueprint and what it is attached to; blueprint and order of
    appearance, of actors that appear within 10 m and exist at the same time.
    """
    matching = _Matching(a, b)
    matching.by_role()
    matching.by_birth()
    matching.by_parent()
    matching.by_order()
    return sorted(matching.found)


class _Matching:
    """Matches of two recordings, and the actors that are left, by number."""

    def __init__(self, a: Sequence[ActorLife], b: Sequence[ActorLife]) -> None:
        self.found: list[Match] = []
        self._all = a, b
        self._left = dict(enumerate(a)), dict(enumerate(b))

    def _add(self, a: int, b: int, by: MatchedBy) -> None:
        self.found.append(Match(a, b, by))
        del self._left[0][a], self._left[1][b]

    def by_role(self) -> None:
        def unique(lives: Sequence[ActorLife]) -> dict[tuple[str, str], int]:
            counts = Counter((life.kind, life.role_name) for life in lives)
            roles = ((number, (life.kind, life.role_name)) for number, life in enumerate(lives) if life.role_name)
            return {role: number for number, role in roles if counts[role] == 1}

        others = unique(self._all[1])
        for role, number in unique(self._all[0]).items():
            if role in others:
                self._add(number, others[role], "role")

    def by_birth(self) -> None:
        def exact(life: ActorLife) -> Hashable:
            # A place as text, so that a NaN equals itself.
            return *_blueprint(life), str(life.place), life.spawned_at

        self._pair(lambda life: (exact(life), life.id))
        self._pair(exact)
        for a, b in self._groups():
            self._match_nearest(a, b)

    def _match_nearest(self, a: list[int], b: list[int]) -> None:
        """Match actors of one blueprint whose spawns are near in place and time, the nearest of all first."""
        theirs = [self._left[1][number] for number in b]
        places, births = _places(theirs), np.array([life.spawned_at for life in theirs])
        ids, is_free = np.array([life.id for life in theirs]), np.ones(len(b), np.bool_)

        def nearest(number: int) -> tuple[float, float, bool, int, int] | None:
            life = self._left[0][number]
            seconds = np.zeros(len(b)) if life.kind in _STATIC else np.abs(births - life.spawned_at)
            distance = _distances(places, life)
            near = np.flatnonzero(is_free & (distance <= SAME_PLACE) & (seconds <= SAME_BIRTH))
            if not len(near):
                return None
            best = near[np.lexsort((ids[near] != life.id, seconds[near], distance[near]))[0]]
            return float(distance[best]), float(seconds[best]), bool(ids[best] != life.id), number, int(best)

        heap = [found for number in a if (found := nearest(number)) is not None]
        heapify(heap)
        while heap:
            *_, number, best = heappop(heap)
            if is_free[best]:
                is_free[best] = False
                self._add(number, b[best], _birth(theirs[best]))
            elif (found := nearest(number)) is not None:
                heappush(heap, found)

    def by_parent(self) -> None:
        partner = {self._all[0][match.a].id: self._all[1][match.b].id for match in self.found}
        known = set(partner.values())

        def attached(life: ActorLife, parent: int | None) -> Hashable:
            return None if parent is None else (*_blueprint(life), life.role_name, parent)

        self._pair(
            lambda life: attached(life, partner.get(life.parent) if life.parent is not None else None),
            lambda life: attached(life, life.parent if life.parent in known else None),
            by="parent",
        )

    def by_order(self) -> None:
        for a, b in self._groups():
            theirs = [self._left[1][number] for number in b]
            if theirs[0].kind in _STATIC:
                continue
            places, is_free = _places(theirs), np.ones(len(b), np.bool_)
            starts, stops = (np.array([getattr(life, name) for life in theirs]) for name in ("spawned_at", "end"))
            for number in a:
                life = self._left[0][number]
                is_other = (life.end <= starts) | (stops <= life.spawned_at)
                fitting = np.flatnonzero(is_free & ~(_distances(places, life) > NEAR) & ~is_other)
                if len(fitting):
                    is_free[fitting[0]] = False
                    self._add(number, b[fitting[0]], "order")

    def _groups(self) -> Iterator[tuple[list[int], list[int]]]:
        """Yield the numbers of the actors that are left of each blueprint that is left in both recordings."""
        groups: dict[tuple[str, str], tuple[list[int], list[int]]] = defaultdict(lambda: ([], []))
        for side, left in enumerate(self._left):
            for number, life in left.items():
                groups[_blueprint(life)][side].append(number)
        yield from ((a, b) for a, b in groups.values() if a and b)

    def _pair(
        self,
        key: Callable[[ActorLife], Hashable],
        key_of_b: Callable[[ActorLife], Hashable] | None = None,
        by: MatchedBy | None = None,
    ) -> None:
        """Match actors with the same key, in their order, except for actors whose key is None."""
        groups: dict[Hashable, list[int]] = defaultdict(list)
        for number, life in reversed(self._left[1].items()):
            groups[(key_of_b or key)(life)].append(number)
        for number, life in list(self._left[0].items()):
            group = key(life)
            if group is not None and groups.get(group):
                self._add(number, groups[group].pop(), by or _birth(life))


def _blueprint(life: ActorLife) -> tuple[str, str]:
    return life.kind, life.type_id


def _birth(life: ActorLife) -> MatchedBy:
    return "position" if life.kind in _STATIC else "birth"


def _places(lives: Sequence[ActorLife]) -> Floats:
    return np.array([life.place for life in lives], np.float64)


def _distances(places: Floats, life: ActorLife) -> Floats:
    """Return the distances of places from that of an actor, in m."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.linalg.norm(places - life.place, axis=1))
