"""Which rows of a frame's records count: of each actor the last one, in order of ids."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.layout import Records

Ids = np.ndarray[tuple[int], np.dtype[np.uint32]]
NO_IDS: Final = np.zeros(0, np.uint32)
NO_IDS.setflags(write=False)


def array(records: Records) -> NDArray[np.void]:
    """Records of a fixed size, for the type checker."""
    assert isinstance(records, np.ndarray)
    return records


def latest(records: NDArray[np.void]) -> NDArray[np.void]:
    """Of each id the last record, in order of ids."""
    return records[_last(records["id"])]


def _last(ids: NDArray[np.integer]) -> NDArray[np.intp]:
    _, places = np.unique(ids[::-1], return_index=True)
    last: NDArray[np.intp] = len(ids) - 1 - places
    return last


def merged(held: NDArray[np.void], new: NDArray[np.void]) -> NDArray[np.void]:
    """Of each id the newest record, in order of ids."""
    return latest(np.concatenate((held, new.astype(held.dtype, copy=False)))) if len(held) else latest(new)


def places(ids: Ids, among: Ids) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Where ids are among others, which ascend: their places, and whether they are there at all."""
    if not len(among):
        return np.zeros(len(ids), np.intp), np.zeros(len(ids), np.bool_)
    found = np.minimum(np.searchsorted(among, ids), len(among) - 1)
    return found, among[found] == ids


def numbers(records: NDArray[np.void]) -> NDArray[np.floating]:
    """Records of an id and six numbers of one type: the numbers, as rows; no copy."""
    view: NDArray[np.floating] = records.view(_block(records.dtype))["numbers"]
    return view


@cache
def _block(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    return np.dtype([("id", dtype["id"]), ("numbers", dtype["x"], (6,))])


class Selection:
    """The rows of one type of record, frame after frame.

    Most frames hold the same ids in the same order as the one before, so the choice is kept.

    Attributes:
        ids: The ids of the chosen rows, ascending; the same object as long as they do not change.
    """

    __slots__ = ("_hidden", "_order", "_recorded", "ids")

    def __init__(self) -> None:
        self.ids: Ids = NO_IDS
        self._recorded = b""
        self._hidden: Ids = NO_IDS
        self._order: NDArray[np.intp] | slice = slice(0)

    def choose(self, records: NDArray[np.void], hidden: Ids) -> NDArray[np.intp] | slice:
        """The places of the rows that count.

        Args:
            records: A frame's.
            hidden: Ids that are left out; the same object as long as they do not change.
        """
        recorded = records["id"].tobytes()  # the fastest way to compare
        if hidden is not self._hidden or recorded != self._recorded:
            self._hidden, self._recorded = hidden, recorded
            ids = records["id"].astype(np.uint32)
            order = _last(ids)
            if len(hidden):
                order = order[~np.isin(ids[order], hidden)]
            self.ids = ids[order]
            self.ids.setflags(write=False)
            self._order = order if len(order) else slice(0)
            if len(order) and (np.diff(order) == 1).all():
                self._order = slice(order[0], order[-1] + 1)  # a view is faster than a copy
        return self._order

    def take(self, records: NDArray[np.void], hidden: Ids) -> NDArray[np.void]:
        """The rows that count."""
        return records[self.choose(records, hidden)]
