"""The records of each actor over a whole recording, in the order of frames."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ActorRows:
    """The records of one actor, a row for each frame that has one.

    Attributes:
        frame: The positions of the frames in the recording, from 0, (n,).
        time: Their elapsed seconds, (n,).
        records: The records, (n,).
    """

    frame: Integers
    time: Floats
    records: NDArray[np.void]


@dataclass(frozen=True, eq=False)
class _Block:
    """Frames that list the same actors: their positions and times, and the records, (frames, actors)."""

    ids: NDArray[np.uint32]
    frame: Integers
    time: Floats
    records: NDArray[np.void]


def actor_rows(
    reader: Reader, names: Collection[str], actors: Collection[int] | None = None
) -> dict[str, dict[int, ActorRows]]:
    """Return the records of some types by type and actor, in one pass over a recording.

    Where a frame has several records of an actor, as some builds write, the last one counts.

    Args:
        reader: The recording.
        names: Record types whose records have one size, and an id.
        actors: The ids of the actors; None for all.

    Raises:
        FormatError: The file contradicts its format.
    """
    wanted = None if actors is None else np.array(sorted(actors), np.uint32)
    blocks: dict[str, list[_Block]] = {name: [] for name in names}
    for batch in reader.batches(tuple(names)):
        for name in names:
            blocks[name].extend(_blocks(batch, name, wanted))
    return {name: _by_actor(blocks.pop(name)) for name in names}


def _blocks(batch: Batch, name: str, wanted: NDArray[np.uint32] | None) -> Iterator[_Block]:
    """Yield the records of a type in a batch, those of frames together that list the same actors."""
    records = batch.records(name)
    if not records.shape[1]:
        return
    ids = records["id"]
    frame = np.arange(batch.index, batch.index + len(batch))
    changes = np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1 if len(ids) > 1 else ids[:0, 0]
    edges = [0, *changes.tolist(), len(ids)]
    for start, stop in pairwise(edges):
        listed = np.ascontiguousarray(ids[start])
        kept = np.arange(len(listed)) if wanted is None else np.flatnonzero(_among(listed, wanted))
        if not len(kept):
            continue
        if len(kept) > 1:
            _, behind = np.unique(listed[kept][::-1], return_index=True)
            if len(behind) < len(kept):  # the last record of each actor counts
                kept = kept[np.sort(len(kept) - 1 - behind)]
        part = records[start:stop] if len(kept) == len(listed) else records[start:stop, kept]
        yield _Block(listed[kept], frame[start:stop], batch.elapsed[start:stop].copy(), part.copy())


def _among(ids: NDArray[np.uint32], wanted: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return which ids are among others, which ascend."""
    if not len(wanted):
        return np.zeros(len(ids), np.bool_)
    found: NDArray[np.bool_] = wanted[np.minimum(np.searchsorted(wanted, ids), len(wanted) - 1)] == ids
    return found


def _by_actor(blocks: list[_Block]) -> dict[int, ActorRows]:
    """Return the rows of blocks by actor, in the order in which the actors first appear; the list of blocks is emptied."""
    pieces: dict[int, list[tuple[int, int]]] = {}
    merged = list(_merged(blocks))
    for number, block in enumerate(merged):
        for row, id in enumerate(block.ids.tolist()):
            pieces.setdefault(id, []).append((number, row))
    return {
        id: ActorRows(
            np.concatenate([merged[number].frame for number, _ in mine]),
            np.concatenate([merged[number].time for number, _ in mine]),
            np.concatenate([merged[number].records[row] for number, row in mine]),
        )
        for id, mine in pieces.items()
    }


def _merged(blocks: list[_Block]) -> Iterator[_Block]:
    """Yield blocks of the same actors together, with records by actor, (actors, frames); the list is emptied."""
    blocks.reverse()
    while blocks:
        same = [blocks.pop()]
        while blocks and np.array_equal(blocks[-1].ids, same[0].ids):
            same.append(blocks.pop())
        frame, time = (np.concatenate([getattr(block, name) for block in same]) for name in ("frame", "time"))
        records = np.empty((len(same[0].ids), len(frame)), same[0].records.dtype)
        at = 0
        for block in same:
            records[:, at : at + len(block.frame)] = block.records.T
            at += len(block.frame)
        yield _Block(same[0].ids, frame, time, records)
