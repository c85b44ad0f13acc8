"""The poses of all actors, in blocks of frames: of each actor only the rows that say something new."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.rerun.stream import Moment, Times, Transforms
from carla_recap.replay.rows import NO_IDS, Ids

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.replay import Scene

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

ROWS: Final = 1024
"""So many frames are in a block."""

_POSES: Final = 1 << 19  # or fewer, if there are so many poses in them


@dataclass(frozen=True)
class Block:
    """Consecutive frames of all actors: the first axis of arrays is actors, the second one is moments.

    Moment 0 is the last one of the block before; where there is no such block, nobody is there.

    Attributes:
        times: When.
        ids: Which actor, ascending.
        poses: x, y, z in cm and roll, pitch, yaw in degrees, left-handed.
        there: Whether an actor has a pose; it does not if a number of it is none.
        news: Whether a pose has to be told: it differs from the one before, or the next one differs from it.
    """

    times: Times
    ids: Ids
    poses: Floats
    there: Flags
    news: Flags

    def tracks(self, shown: Container[int]) -> Iterator[tuple[int, Times, Transforms]]:
        """Each of the actors that are shown and have news, and these."""
        places, moments = np.nonzero(self.news)
        times, transforms = self.times.take(moments), Transforms.of(self.poses[self.news])
        ends = np.searchsorted(places, np.arange(len(self.ids) + 1)).tolist()
        for id, (start, end) in zip(self.ids.tolist(), pairwise(ends), strict=True):
            if start < end and id in shown:
                yield id, times.take(slice(start, end)), transforms.take(slice(start, end))


class Tracks:
    """Gathers the poses of scenes into blocks."""

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self._poses: list[Floats] = []
        self._segments: list[tuple[int, Ids]] = []  # from which scene on which ids
        self._born: list[tuple[int, int]] = []  # scene, id
        self._count = 0
        self._before: Block | None = None

    @property
    def full(self) -> bool:
        """Whether it is time to take a block."""
        return len(self._moments) >= ROWS or self._count >= _POSES

    def add(self, scene: Scene, moment: Moment, born: Iterable[int]) -> None:
        """Add a scene.

        Args:
            scene: The scene.
            moment: When.
            born: Ids that belong to somebody else from now on.
        """
        place = len(self._moments)
        if not self._segments or self._segments[-1][1] is not scene.ids:
            self._segments.append((place, scene.ids))
        self._born += [(place, id) for id in born]
        self._moments.append(moment)
        self._poses.append(scene.poses)
        self._count += len(scene.ids)

    def take(self) -> Block | None:
        """The scenes since the last block; None if there are none."""
        if not self._moments:
            return None
        before, count = self._before, len(self._moments)
        held = before.ids[before.there[:, -1]] if before else NO_IDS
        ids = np.unique(np.concatenate([held, *(ids for _, ids in self._segments)]))
        poses, there = np.zeros((len(ids), count + 1, 6)), np.zeros((len(ids), count + 1), np.bool_)
        told = np.ones(len(ids), np.bool_)  # whether moment 0 has been told
        if before:
            where, last = np.searchsorted(ids, held), before.there[:, -1]
            poses[where, 0], there[where, 0], told[where] = before.poses[last, -1], True, before.news[last, -1]
        ends = [start for start, _ in self._segments[1:]] + [count]
        for (start, those), end in zip(self._segments, ends, strict=True):
            where = np.searchsorted(ids, those)
            poses[where, start + 1 : end + 1] = np.stack(self._poses[start:end], axis=1)
            there[where, start + 1 : end + 1] = True
        with np.errstate(invalid="ignore", over="ignore"):
            there &= np.isfinite(poses @ np.ones(6))  # of the sum: that is faster
        changed = there[:, 1:] & (~there[:, :-1] | (poses[:, 1:] != poses[:, :-1]).any(axis=2))
        if self._born and len(ids):
            born = np.array(self._born)
            born = born[np.isin(born[:, 1], ids)]
            when, rows = born[:, 0], np.searchsorted(ids, born[:, 1])
            changed[rows, when] |= there[rows, when + 1]
        news = np.zeros_like(there)
        news[:, 1:] = changed
        news[:, :-1] |= changed & there[:, :-1]
        news[:, 0] &= ~told
        first = Moment(int(before.times.frame[-1]), int(before.times.elapsed[-1])) if before else self._moments[0]
        block = self._before = Block(Times.of([first, *self._moments]), ids, poses, there, news)
        self._moments, self._poses, self._segments, self._born, self._count = [], [], [], [], 0
        return block
