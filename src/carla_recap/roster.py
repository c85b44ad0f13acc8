"""Which actors are there, as spawns and destructions tell."""

from __future__ import annotations

from typing import Generic, TypeVar

A = TypeVar("A")


class Roster(Generic[A]):
    """The actors by id, in the order in which they came.

    CARLA, told that an actor is destroyed, forgets the one that was spawned last instead; so does `compat`.
    """

    def __init__(self, *, compat: bool) -> None:
        self.actors: dict[int, A] = {}
        self._compat = compat
        self._newest = -1

    def spawn(self, id: int, actor: A) -> None:
        """Take up an actor."""
        self.actors[id] = actor
        self._newest = id

    def destroy(self, id: int) -> A | None:
        """Forget an actor; None where there is no such."""
        return self.actors.pop(self._newest if self._compat else id, None)
