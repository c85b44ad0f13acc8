"""The actors that are present at a time, and the order in which CARLA iterates over them."""

from __future__ import annotations

from math import isqrt
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

A = TypeVar("A")


class PresentActors(Generic[A]):
    """The actors that are present, by id, in the order of their spawns.

    When an actor is destroyed, CARLA removes the one that was spawned last instead, or id 0 before any spawn; with `compat`,
    this is reproduced.
    """

    def __init__(self, *, compat: bool) -> None:
        self.actors: dict[int, A] = {}
        self._compat = compat
        self._newest = 0

    def spawn(self, id: int, actor: A) -> None:
        """Add an actor."""
        self.actors[id] = actor
        self._newest = id

    def destroy(self, id: int) -> A | None:
        """Remove an actor and return it; None if it is not present."""
        return self.actors.pop(self._newest if self._compat else id, None)


class HashOrder:
    """Ids in the order in which CARLA iterates over its table of actors, an `unordered_map` of libc++.

    The hash of an id is the id itself. All entries form one linked list, in which the entries of a bucket are neighbours: a
    new entry becomes the first of its bucket, and a new bucket is inserted at the front of the list. A full table first
    grows to a prime number of buckets that is at least twice the number before.
    """

    def __init__(self) -> None:
        self._next: dict[int, int | None] = {_FRONT: None}
        self._buckets = 0
        self._before: dict[int, int] = {}  # by bucket, the entry that its first one follows

    def ids(self) -> Iterator[int]:
        """Yield the ids."""
        id = self._next[_FRONT]
        while id is not None:
            yield id
            id = self._next[id]

    def add(self, id: int) -> None:
        """Add an id if it is not present."""
        if id in self._next:
            return
        if len(self._next) > self._buckets:  # of which one is the front
            # The number of buckets is a power of two only in a table of 2, which grows from an empty one.
            self._grow(_next_prime(max(2 * self._buckets + 1, 2)))
        bucket = id % self._buckets
        if bucket in self._before:
            self._put_behind(self._before[bucket], id)
            return
        self._put_behind(_FRONT, id)
        self._before[bucket] = _FRONT
        behind = self._next[id]
        if behind is not None:
            self._before[behind % self._buckets] = id

    def remove(self, id: int) -> None:
        """Remove an id that is present."""
        bucket = id % self._buckets
        before = self._before[bucket]
        while self._next[before] != id:
            before = self._next[before]  # type: ignore[assignment]
        behind = self._next[before] = self._next.pop(id)
        if behind is None or behind % self._buckets != bucket:
            if before == self._before[bucket]:
                del self._before[bucket]
            if behind is not None:
                self._before[behind % self._buckets] = before

    def _put_behind(self, before: int, id: int) -> None:
        self._next[id] = self._next[before]
        self._next[before] = id

    def _grow(self, buckets: int) -> None:
        """Distribute the list over more buckets: each entry goes behind the one before the first entry of its bucket."""
        self._buckets = buckets
        self._before = {}
        last, latest = _FRONT, None
        while (id := self._next[last]) is not None:
            bucket = id % buckets
            if bucket == latest:
                last = id
            elif bucket not in self._before:
                self._before[bucket] = last
                last, latest = id, bucket
            else:
                self._next[last] = self._next[id]
                self._put_behind(self._before[bucket], id)


_FRONT = -1  # the key of the first id


def _next_prime(number: int) -> int:
    while any(number % divisor == 0 for divisor in range(2, isqrt(number) + 1)):
        number += 1
    return number
