"""The ids of the actors of a world, which are never reused."""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

LARGEST_WANTED: Final = 2**24
"""The largest id that can be wanted; larger ones in a recording are damage, and would use up CARLA's 32 bits."""


class ActorIds:
    """Gives each actor of a world, through all its episodes, an id of its own.

    As in CARLA, an actor can have an id that is wanted, if it is free, and later ones get larger ids. Unlike in CARLA, the
    id of a destroyed actor is not free: clients may still ask for that actor.
    """

    def __init__(self) -> None:
        self._next = 1
        self._gaps: list[range] = []  # the ids below the next one that no actor ever had, ascending

    def new(self, wanted: int | None = None) -> int:
        """Return an id that no actor ever had.

        Args:
            wanted: The id to return if it is free, from 1 to `LARGEST_WANTED`; else, and for None, it is the next one.
        """
        if wanted is not None and 0 < wanted <= LARGEST_WANTED:
            self.reserve(wanted)
            index = bisect_right(self._gaps, wanted, key=lambda gap: gap.start) - 1
            if index >= 0 and wanted in (gap := self._gaps[index]):
                rest = range(gap.start, wanted), range(wanted + 1, gap.stop)
                self._gaps[index : index + 1] = [part for part in rest if part]
                return wanted
        self._next += 1
        return self._next - 1

    def reserve(self, largest: int) -> None:
        """Keep the free ids up to one for actors for which they are wanted; it has no effect beyond `LARGEST_WANTED`."""
        if self._next <= largest <= LARGEST_WANTED:
            self._gaps.append(range(self._next, largest + 1))
            self._next = largest + 1
