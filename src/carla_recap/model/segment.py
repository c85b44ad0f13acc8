"""Segments: consecutive frames in which the records of a type have the same ids, as columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Booleans = NDArray[np.bool_]
    Ids = NDArray[np.integer[Any]]
    Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """Consecutive frames in which the records of a type have the same ids, in the same order.

    Attributes:
        first: The number of the first frame.
        ids: The ids of the actors of interest, (actors,).
        columns: The positions of their records in each frame, (actors,).
        records: All records, (frames, records of each).
    """

    first: int
    ids: Ids
    columns: Indices
    records: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.records)

    @property
    def frames(self) -> slice:
        """The numbers of the frames."""
        return slice(self.first, self.first + len(self.records))

    def field(self, name: str) -> NDArray[Any]:
        """Return a field of the records of the actors, (frames, actors)."""
        values: NDArray[Any] = self.records[name]
        return values if len(self.columns) == values.shape[1] else values[:, self.columns]

    def only(self, kept: Booleans | Indices) -> Segment:
        """Return the segment of some of its actors."""
        return replace(self, ids=self.ids[kept], columns=self.columns[kept])


def segments(records: NDArray[np.void], *, cuts: Booleans | None = None) -> Iterator[Segment]:
    """Yield the segments of the records of a type.

    For example, frames with the ids 7 8, 7 8, 7 8 9 have a segment of two frames and one of one frame.

    Args:
        records: The records of consecutive frames, (frames, records of each), as those of a batch.
        cuts: Whether a segment begins with a frame anyway, for all frames but the first.
    """
    ids = np.ascontiguousarray(records["id"])
    edges = [0, len(ids)]
    if len(ids) > 1:
        changes = (ids[1:] != ids[:-1]).any(axis=1)
        edges[1:1] = (np.flatnonzero(changes if cuts is None else changes | cuts) + 1).tolist()
    columns = np.arange(ids.shape[1])
    for start, stop in pairwise(edges):
        if stop > start:
            yield Segment(start, ids[start], columns, records[start:stop])


def last_of_each(ids: Ids) -> Indices:
    """Return the position of the last record of each id, by id: where a frame lists an actor twice, that one counts."""
    if (ids[1:] > ids[:-1]).all():
        return np.arange(len(ids))
    _, behind = np.unique(ids[::-1], return_index=True)
    last: Indices = len(ids) - 1 - behind
    return last
