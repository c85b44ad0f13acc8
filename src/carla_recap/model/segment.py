"""Segments: consecutive frames in which the records of a type have the same ids, as columns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Booleans, Ids, Indices


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """Consecutive frames in which the records of a type have the same ids, in the same order."""

    first: int  # the number of the first frame
    ids: Ids  # the ids of the actors of interest, (actors,)
    columns: Indices  # the positions of their records in each frame, (actors,)
    records: NDArray[np.void]  # all records, (frames, records of each)

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
        return Segment(self.first, self.ids[kept], self.columns[kept], self.records)

    def later(self, frames: int) -> Segment:
        """Return the same segment, whose first frame has a number that is greater by some frames."""
        return Segment(self.first + frames, self.ids, self.columns, self.records)


def segments(records: NDArray[np.void]) -> Iterator[Segment]:
    """Yield the segments of the records of a type.

    For example, frames with the ids 7 8, 7 8, 7 8 9 have a segment of two frames and one of one frame.

    The records are those of consecutive frames, (frames, records of each), as of a batch.
    """
    ids = np.ascontiguousarray(records["id"])
    edges = [0, *(np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1).tolist(), len(ids)]
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


class SegmentBuffer:
    """The segments of a record type in the latest frames of a recording."""

    def __init__(self) -> None:
        self.frames = 0
        self._segments: list[Segment] = []

    def add(self, found: Iterable[Segment], frames: int) -> None:
        """Add segments of the next frames, whose numbers begin at 0, and the number of these frames."""
        self._segments += (each.later(self.frames) for each in found if len(each.ids))
        self.frames += frames

    def drop(self, count: int) -> None:
        """Drop the first frames; the numbers of the others begin at 0 again."""
        self._segments = [each.later(-count) for each in self._within(count, self.frames)]
        self.frames -= count

    def ids(self, start: int = 0, stop: int | None = None) -> Ids:
        """Return the ids in some frames, ascending; without a stop, until the last one."""
        found = self._within(start, self.frames if stop is None else stop)
        parts = {each.ids.tobytes(): each.ids for each in found}
        return np.unique(np.concatenate([np.zeros(0, np.uint32), *parts.values()]))

    def dense(
        self, fields: Sequence[str], ids: Ids, start: int = 0, stop: int | None = None
    ) -> tuple[NDArray[Any], Booleans]:
        """Return fields of the last record of each actor in each of some frames, and where there is such a record.

        For example, if 7 is in both of two frames, and 8 in the second one, x is [[3, 4], [0, 9]], and where it is known
        [[True, True], [False, True]].

        Ids are ascending. Values are (fields, actors, frames), of one type, and whether they are known is (actors, frames).
        """
        stop = self.frames if stop is None else stop
        found = list(self._within(start, stop))
        kind = found[0].records.dtype[fields[0]] if found else np.dtype("f4")
        values = np.zeros((len(fields), len(ids), stop - start), kind)
        known = np.zeros((len(ids), stop - start), np.bool_)
        for segment in found if len(ids) else ():
            row = np.minimum(np.searchsorted(ids, segment.ids), len(ids) - 1)
            wanted = ids[row] == segment.ids
            if not wanted.all():
                segment, row = segment.only(wanted), row[wanted]
            frames = slice(max(segment.first - start, 0), segment.first + len(segment) - start)
            taken = slice(max(start - segment.first, 0), stop - segment.first)
            for number, field in enumerate(fields):
                values[number, row, frames] = segment.field(field)[taken].T
            known[row, frames] = True
        return values, known

    def _within(self, start: int, stop: int) -> Iterator[Segment]:
        return (each for each in self._segments if each.first < stop and each.first + len(each) > start)
