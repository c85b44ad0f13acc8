"""Which actor of one recording is which of another, of the same scenario: ids differ between runs."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence

    from carla_recap.model.lives import ActorLife


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
_CANDIDATES: Final = 16  # actors near a place that are looked at, at most

Place = tuple[float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class Match:
    """An actor of one recording and the same actor of another."""

    a: ActorLife
    b: ActorLife
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
    index = {id(life): number for number, life in enumerate(a)}
    return sorted(matching.found, key=lambda match: index[id(match.a)])


class _Matching:
    """Matches of two recordings, and the actors that are left."""

    def __init__(self, a: Sequence[ActorLife], b: Sequence[ActorLife]) -> None:
        self.found: list[Match] = []
        self._all = a, b
        self._left = {id(life): life for life in a}, {id(life): life for life in b}

    def _add(self, a: ActorLife, b: ActorLife, by: MatchedBy) -> None:
        self.found.append(Match(a, b, by))
        del self._left[0][id(a)], self._left[1][id(b)]

    def by_role(self) -> None:
        def unique(lives: Iterable[ActorLife]) -> dict[tuple[str, str], ActorLife]:
            roles = {(life.kind, life.role_name): life for life in lives if life.role_name}
            counts = Counter((life.kind, life.role_name) for life in lives)
            return {role: life for role, life in roles.items() if counts[role] == 1}

        others = unique(self._all[1])
        for role, life in unique(self._all[0]).items():
            if role in others:
                self._add(life, others[role], "role")

    def by_birth(self) -> None:
        def exact(life: ActorLife) -> Hashable:
            # A place as text, so that a NaN equals itself.
            return *_blueprint(life), str(life.place), life.spawned_at

        self._pair(lambda life: (exact(life), life.id))
        self._pair(exact)
        grid: dict[Hashable, list[ActorLife]] = defaultdict(list)
        for life in self._left[1].values():
            cell = _cell(life.place)
            if cell is not None:
                grid[(*_blueprint(life), *cell)].append(life)
        near: list[tuple[float, float, bool, int, ActorLife, ActorLife]] = []
        for number, life in enumerate(self._left[0].values()):
            for other in _neighbours(grid, life):
                distance, seconds = _apart(life, other)
                if distance <= SAME_PLACE and seconds <= SAME_BIRTH:
                    near.append((distance, seconds, life.id != other.id, number, life, other))
        for *_, life, other in sorted(near, key=lambda row: row[:4]):
            if id(life) in self._left[0] and id(other) in self._left[1]:
                self._add(life, other, _birth(life))

    def by_parent(self) -> None:
        partner = {(match.a.id): match.b.id for match in self.found}
        known = set(partner.values())

        def attached(life: ActorLife, parent: int | None) -> Hashable:
            return None if parent is None else (*_blueprint(life), life.role_name, parent)

        self._pair(
            lambda life: attached(life, partner.get(life.parent) if life.parent is not None else None),
            lambda life: attached(life, life.parent if life.parent in known else None),
            by="parent",
        )

    def by_order(self) -> None:
        groups: dict[tuple[str, str], tuple[list[ActorLife], list[ActorLife]]] = defaultdict(lambda: ([], []))
        for side in (0, 1):
            for life in self._left[side].values():
                if life.kind not in _STATIC:
                    groups[_blueprint(life)][side].append(life)
        for a, b in groups.values():
            if not a or not b:
                continue
            places = np.array([other.place for other in b])
            starts = np.array([other.spawned_at for other in b])
            stops = np.array([other.end for other in b])
            is_free = np.ones(len(b), np.bool_)
            for life in a:
                with np.errstate(invalid="ignore", over="ignore"):
                    is_far = np.linalg.norm(places - life.place, axis=1) > NEAR
                    is_other = (life.end <= starts) | (stops <= life.spawned_at)
                fitting = is_free & ~is_far & ~is_other
                index = int(fitting.argmax())
                if fitting[index]:
                    is_free[index] = False
                    self._add(life, b[index], "order")

    def _pair(
        self,
        key: Callable[[ActorLife], Hashable],
        key_of_b: Callable[[ActorLife], Hashable] | None = None,
        by: MatchedBy | None = None,
    ) -> None:
        """Match actors with the same key, in their order, except for actors whose key is None."""
        groups: dict[Hashable, list[ActorLife]] = defaultdict(list)
        for life in reversed(self._left[1].values()):
            groups[(key_of_b or key)(life)].append(life)
        for life in list(self._left[0].values()):
            group = key(life)
            if group is not None and groups.get(group):
                self._add(life, groups[group].pop(), by or _birth(life))


def _blueprint(life: ActorLife) -> tuple[str, str]:
    return life.kind, life.type_id


def _birth(life: ActorLife) -> MatchedBy:
    return "position" if life.kind in _STATIC else "birth"


def _cell(place: Place) -> tuple[int, int, int] | None:
    """Return the cube of a place; None if it is not finite."""
    x, y, z = place
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        return None
    return math.floor(x / SAME_PLACE), math.floor(y / SAME_PLACE), math.floor(z / SAME_PLACE)


def _neighbours(grid: dict[Hashable, list[ActorLife]], life: ActorLife) -> Iterator[ActorLife]:
    """Yield the actors of the same blueprint that may be near; of many, the first ones."""
    cell = _cell(life.place)
    for step in product((-1, 0, 1), repeat=3) if cell is not None else ():
        x, y, z = (coordinate + change for coordinate, change in zip(cell or (), step, strict=True))
        yield from grid.get((*_blueprint(life), x, y, z), ())[:_CANDIDATES]


def _apart(life: ActorLife, other: ActorLife) -> tuple[float, float]:
    """Return the distance of the spawns of two actors in m, and the seconds between them, which do not count for lights."""
    seconds = 0.0 if life.kind in _STATIC else abs(life.spawned_at - other.spawned_at)
    return math.dist(life.place, other.place), seconds
