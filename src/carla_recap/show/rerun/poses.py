"""The poses of all actors in blocks of frames: of each actor only the rows that differ from the ones before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.selection import NO_IDS
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable

    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.replay.selection import Ids
    from carla_recap.show.rerun.stream import Stream

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

ROWS: Final = 1024
"""The number of frames in a block, more or less."""

_MAX_POSES: Final = 1 << 19
"""The number of poses in a block of many actors, more or less."""


@dataclass(frozen=True)
class PoseBlock:
    """The poses of consecutive frames: the first axis of arrays is the frames, the second one the actors.

    Row 0 is the last frame of the block before; in the first block, no actor is present in it.

    Attributes:
        times: The times of the frames.
        ids: The actors, ascending.
        poses: x, y, z in cm and roll, pitch, yaw in degrees, left-handed.
        present: Whether an actor has a pose of finite numbers, and is not away.
        written: Whether a pose has to be written: it differs from the one before, or the next one differs from it.
    """

    times: TimeColumns
    ids: Ids
    poses: Floats
    present: Flags
    written: Flags

    def write(self, stream: Stream, shown: Container[int], path: Callable[[int], str] = paths.actor) -> None:
        """Write the transforms of the actors that are shown, at the paths that a function returns for their ids."""
        actors, rows = np.nonzero(self.written.T)
        ends = np.searchsorted(actors, np.arange(len(self.ids) + 1)).tolist()
        tracks = (
            (path(id), start, end)
            for id, (start, end) in zip(self.ids.tolist(), pairwise(ends), strict=True)
            if start < end and id in shown
        )
        stream.tracks(tracks, self.times.take(rows), self.poses[rows, actors])


class PoseBuffer:
    """Gathers the poses of scenes into blocks."""

    def __init__(self) -> None:
        self._times: list[TimeColumns] = []
        self._pieces: list[tuple[Ids, Floats, Flags]] = []
        self._spawned: list[tuple[int, int]] = []  # row, id
        self._rows = self._count = 0
        self._before: PoseBlock | None = None

    @property
    def is_full(self) -> bool:
        """Whether it is time to take a block."""
        return self._rows >= ROWS or self._count >= _MAX_POSES

    def add(self, batch: SceneBatch, times: TimeColumns, spawned: Iterable[int]) -> None:
        """Add scenes.

        Args:
            batch: The scenes.
            times: Their times.
            spawned: The ids that belong to new actors from the first scene on.
        """
        self._spawned += [(self._rows, id) for id in spawned]
        self._times.append(times)
        self._pieces.append((batch.ids, batch.poses, batch.away))
        self._rows += len(batch)
        self._count += len(batch) * len(batch.ids)

    def take(self) -> PoseBlock | None:
        """Return the block of the scenes since the last one; None if there are none."""
        if not self._rows:
            return None
        before = self._before
        first = before.times.take(slice(-1, None)) if before else self._times[0].take(slice(1))
        ids, poses, present, was_written = self._joined()
        with np.errstate(invalid="ignore", over="ignore"):
            present &= np.isfinite(poses @ np.ones(6))  # of the sum: that is faster
        different = reduce(np.logical_or, np.moveaxis(poses[1:] != poses[:-1], -1, 0))
        changed = present[1:] & (~present[:-1] | different)
        if self._spawned and len(ids):
            spawned = np.array(self._spawned)
            rows, those = spawned[np.isin(spawned[:, 1], ids)].T
            where = np.searchsorted(ids, those)
            changed[rows, where] |= present[rows + 1, where]
        written = np.zeros_like(present)
        written[1:] = changed
        written[:-1] |= changed & present[:-1]
        written[0] &= ~was_written
        block = self._before = PoseBlock(TimeColumns.joined([first, *self._times]), ids, poses, present, written)
        self._times, self._pieces, self._spawned, self._rows, self._count = [], [], [], 0, 0
        return block

    def _joined(self) -> tuple[Ids, Floats, Flags, Flags]:
        """Return the ids, poses and presence of a block, and whether the poses of row 0 have been written."""
        before = self._before
        held = before.ids[before.present[-1]] if before else NO_IDS
        runs = [list(run) for _, run in groupby(self._pieces, key=lambda piece: id(piece[0]))]
        ids = np.unique(np.concatenate([held, *(run[0][0] for run in runs)]))
        poses = np.zeros((self._rows + 1, len(ids), 6))
        present, was_written = np.zeros(poses.shape[:2], np.bool_), np.ones(len(ids), np.bool_)
        if before:
            where, last = np.searchsorted(ids, held), before.present[-1]
            poses[0, where], present[0, where], was_written[where] = before.poses[-1, last], True, before.written[-1, last]
        row = 1
        for run in runs:
            those = run[0][0]
            columns: slice | NDArray[np.intp] = slice(None) if len(those) == len(ids) else np.searchsorted(ids, those)
            for _, piece, away in run:
                rows = slice(row, row + len(piece))
                poses[rows, columns], present[rows, columns] = piece, ~away
                row += len(piece)
        return ids, poses, present, was_written
