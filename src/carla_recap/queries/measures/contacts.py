"""When actors touch, by the recorded collisions, so that what contacts cause is not measured as driving."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame

    Booleans = NDArray[np.bool_]
    Floats = NDArray[np.float64]

_SAME_CONTACT: Final = 1.0  # s; records of a pair with a shorter interval between them belong to one contact
_BEFORE: Final = 0.4  # s before a contact in which its effect on the motion begins, since motions are means
_AFTERMATH: Final = 0.5  # s after a contact in which it affects the motion


class ContactTimes:
    """The times of contacts, by actor and by pair."""

    def __init__(self) -> None:
        self._of_pair: dict[frozenset[int], list[list[float]]] = defaultdict(list)
        self._of_actor: dict[int, list[list[float]]] = defaultdict(list)

    def add(self, frame: Frame) -> None:
        """Add the collision records of a frame."""
        for _, id1, id2, *_ in frame["collisions"].tolist():
            spans = [self._of_pair[frozenset((id1, id2))], self._of_actor[id1], self._of_actor[id2]]
            for contacts in spans:
                if contacts and abs(frame.elapsed - contacts[-1][1]) < _SAME_CONTACT:
                    contacts[-1][1] = frame.elapsed
                else:
                    contacts.append([frame.elapsed, frame.elapsed])

    def of(self, id1: int, id2: int) -> Iterator[tuple[float, float]]:
        """Yield the first and the last time of each contact of two actors."""
        for contact in self._of_pair.get(frozenset((id1, id2)), ()):
            yield contact[0], contact[1]

    def disturbed(self, id: int, time: Floats) -> Booleans:
        """Return at which times a contact affects the motion of an actor."""
        found = np.zeros(len(time), np.bool_)
        for start, stop in self._of_actor.get(id, ()):
            found |= (time >= start - _BEFORE) & (time <= stop + _AFTERMATH)
        return found
