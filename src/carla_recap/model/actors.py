"""The actors that are there, as spawns and destructions say, and the order in which CARLA goes through them."""

from __future__ import annotations

from math import isqrt
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

A = TypeVar("A")


class PresentActors(Generic[A]):
    """The actors by id, in the order in which they came.

    Of a destroyed actor, CARLA forgets the one that was spawned last instead, or id 0 before any spawn; so does `compat`.
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
        """Forget an actor and return it; None where there is no such."""
        return self.actors.pop(self._newest if self._compat else id, None)


class HashOrder:
    """Ids in the order in which CARLA goes through its table of actors, an `unordered_map` of libc++.

    The hash of an id is the id itself. All entries are one linked list, in which those of a bucket are neighbours: a
    bucket's new entry becomes its first one, and a new bucket comes to the front of the list. A full table first gets a
    prime number of buckets, at least twice as many as it had.
    """

    def __init__(self) -> None:
        self._next: dict[int, int | None] = {_FRONT: None}
        self._buckets = 0
        self._before: dict[int, int] = {}  # by bucket, the entry that its first one follows

    def ids(self) -> Iterator[int]:
        """Yield the ids."""
        at = self._next[_FRONT]
        while at is not None:
            yield at
            at = self._next[at]

    def add(self, id: int) -> None:
        """Add an id; nothing happens to one that is there."""
        if id in self._next:
            return
        if len(self._next) > self._buckets:  # one of them is the front
            # A power of two only ever comes of an empty table, as 2 buckets.
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
        """Remove an id that is there."""
        bucket = id % self._buckets
        before = self._before[bucket]
        while self._next[before] != id:
            before = self._next[before]  # type: ignore[assignment]
        behind = self._next[before] = self._next.pop(id)
        goes_on = behind is not None and behind % self._buckets == bucket
        if not goes_on:
            if before == self._before[bucket]:
                del self._before[bucket]
            if behind is not None:
                self._before[behind % self._buckets] = before

    def _put_behind(self, before: int, id: int) -> None:
        self._next[id] = self._next[before]
        self._next[before] = id

    def _grow(self, buckets: int) -> None:
        """Sort the list into more buckets: each entry goes behind the one that its bucket's first entry follows."""
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


_FRONT = -1  # stands before the first id


def _next_prime(number: int) -> int:
    while any(number % divisor == 0 for divisor in range(2, isqrt(number) + 1)):
        number += 1
    return number
