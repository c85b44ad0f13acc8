"""Batches of snapshots of a world, and the frames of a recording that they become: later, without the world."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap.editing.author import empty_packets
from carla_recap.model.batch import Batch, ConstantColumn, packed
from carla_recap.model.frame import LAST_FRAME_DURATION, Packet
from carla_recap.model.records import FRAME_END, UE4, UE5

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.batch import Column

    Records = Mapping[int, NDArray[np.void]]


@dataclass(slots=True, eq=False)
class Timestamp:
    """The time of a snapshot, and what had happened by then.

    Attributes:
        elapsed: Seconds since the recording began.
        events: What happened since the last snapshot, as packets by type; types without records are missing.
        duration: Seconds until the next snapshot.
    """

    index: int
    elapsed: float
    events: dict[int, Packet]
    duration: float = LAST_FRAME_DURATION


class SnapshotBatch:
    """Consecutive snapshots of the same actors, up to some number, which is sent to the process that writes the recording.

    Besides their times, these are the records that each frame has, by type, of as many actors as in the first one.
    """

    def __init__(self, first: Records, length: int, *, additional_data: bool, wide: bool) -> None:
        self.timestamps: list[Timestamp] = []
        self._records = {type: np.empty((length, len(rows)), rows.dtype) for type, rows in first.items()}
        self._length = length
        self._additional = additional_data
        self._wide = wide

    def __getstate__(self) -> dict[str, Any]:
        count = len(self.timestamps)
        return self.__dict__ | {"_records": {type: rows[:count] for type, rows in self._records.items()}}

    @property
    def is_full(self) -> bool:
        """Whether no snapshot can be added."""
        return len(self.timestamps) == self._length

    def add(self, timestamp: Timestamp, records: Records) -> None:
        """Add a snapshot."""
        for type, rows in records.items():
            self._records[type][len(self.timestamps)] = rows
        self.timestamps.append(timestamp)

    def batches(self) -> Iterator[Batch]:
        """Yield the snapshots as frames; a frame with events is a batch of its own."""
        count, table = len(self.timestamps), UE5 if self._wide else UE4
        columns: dict[int, Column | None] = {
            type: None if packet is None else ConstantColumn(packet, count)
            for type, packet in empty_packets(table, self._additional).items()
        }
        columns |= {type: packed(table[type], rows[:count]) for type, rows in self._records.items()}
        columns[FRAME_END] = ConstantColumn(Packet(FRAME_END, table[FRAME_END], b""), count)
        for has_events, group in groupby(range(count), key=lambda index: bool(self.timestamps[index].events)):
            indices = list(group)
            for part in [[index] for index in indices] if has_events else [indices]:
                yield self._batch(columns, part[0], part[-1] + 1)

    def _batch(self, columns: Mapping[int, Column | None], start: int, stop: int) -> Batch:
        """Return consecutive frames: one, or several without events."""
        times = self.timestamps[start:stop]
        frames = {type: None if column is None else column.sliced(start, stop) for type, column in columns.items()}
        frames |= {type: ConstantColumn(packet) for type, packet in times[0].events.items()}
        return Batch(
            times[0].index,
            np.array([each.index + 1 for each in times], np.uint64),
            np.array([each.elapsed for each in times]),
            np.array([each.duration for each in times]),
            [column for column in frames.values() if column is not None],
        )
