"""The latest record of each id, ascending by id."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.segment import last_of_each

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.layout import Records
    from carla_recap.util.arrays import Ids

NO_IDS: Final[Ids] = np.zeros(0, np.uint32)
NO_IDS.setflags(write=False)


def array(records: Records) -> NDArray[np.void]:
    """Return records of a fixed size as what they are, for the type checker."""
    assert isinstance(records, np.ndarray)
    return records


def latest(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return the last record of each id, ascending by id."""
    return records[last_of_each(records["id"])]


def merged(held: NDArray[np.void], new: NDArray[np.void]) -> NDArray[np.void]:
    """Return the newest record of each id, ascending by id."""
    return latest(np.concatenate((held, new.astype(held.dtype, copy=False)))) if len(held) else latest(new)


def find(ids: NDArray[np.integer], among: NDArray[np.integer]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the indices of ids among others, which ascend, and whether they are among them."""
    if not len(among):
        return np.zeros(len(ids), np.intp), np.zeros(len(ids), np.bool_)
    found = np.minimum(np.searchsorted(among, ids), len(among) - 1)
    return found, among[found] == ids


def index_in(among: NDArray[np.integer], id: int) -> int | None:
    """Return the index of an id among others, which ascend; None if it is not among them."""
    index = int(among.searchsorted(id))
    return index if index < len(among) and among[index] == id else None


def numbers(records: NDArray[np.void]) -> NDArray[np.floating]:
    """Return the numbers of records of an id and six numbers of one type, (..., 6); not a copy."""
    view: NDArray[np.floating] = records.view(_id_and_numbers(records.dtype))["numbers"]
    return view


@cache
def _id_and_numbers(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    return np.dtype([("id", dtype["id"]), ("numbers", dtype["x"], (6,))])


class Selection:
    """Selects the rows of one type of record, frame after frame.

    Most frames have the same ids in the same order as the one before, so the selection is kept.

    Attributes:
        ids: The ids of the selected rows, ascending; the same object until they change.
    """

    __slots__ = ("_hidden", "_recorded", "_rows", "ids")

    def __init__(self) -> None:
        self.ids: Ids = NO_IDS
        self._recorded = b""
        self._hidden: Ids = NO_IDS
        self._rows: NDArray[np.intp] | slice = slice(0)

    def choose(self, records: NDArray[np.void], hidden: Ids) -> NDArray[np.intp] | slice:
        """Return the indices of the selected rows.

        Args:
            records: The records of a frame.
            hidden: Ids to leave out; the same object until they change.
        """
        recorded = records["id"].tobytes()  # the fastest way to compare
        if hidden is not self._hidden or recorded != self._recorded:
            self._hidden, self._recorded = hidden, recorded
            ids = records["id"].astype(np.uint32)
            rows = last_of_each(ids)
            if len(hidden):
                rows = rows[~find(ids[rows], hidden)[1]]
            self.ids = ids[rows]
            self.ids.setflags(write=False)
            self._rows = rows if len(rows) else slice(0)
            if len(rows) and rows[-1] - rows[0] == len(rows) - 1 and (rows[1:] > rows[:-1]).all():
                self._rows = slice(rows[0], rows[-1] + 1)  # a view is faster than a copy
        return self._rows
