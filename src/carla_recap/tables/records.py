"""The records of a type as a table: the frame and the time of each, and its fields, as CARLA records them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.layout import EMPTY_LIST
from carla_recap.model.records import FLAG, FRAME_START, REAL, TEXT, Layout, Many
from carla_recap.tables import Tabular
from carla_recap.tables.arrow import nested_types
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.records import RecordType


@dataclass(frozen=True, eq=False)
class RecordTable(Tabular):
    """All records of a type in a recording, as columns of one length.

    Attributes:
        type: The record type.
        frame: CARLA's numbers of the frames, (n,).
        time: Elapsed seconds, (n,).
        fields: The fields of the records by name: arrays, (n,); lists of texts and of nested records.
    """

    type: RecordType
    frame: NDArray[np.uint64]
    time: NDArray[np.float64]
    fields: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, name: str) -> Any:
        """Return a column.

        Raises:
            KeyError: There is none of this name.
        """
        return self.columns()[name]

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        return {"frame": self.frame, "time": self.time, **self.fields}

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return {"time": "s", **self.type.units}

    def _types(self) -> Mapping[str, Any]:
        return nested_types(self.type)


class RecordTableBuilder:
    """The records of a type, gathered from batches.

    Args:
        type: The record type, of the table of the recording's build.

    Attributes:
        rows: The number of records gathered.
        memory: About how many bytes they need.
    """

    def __init__(self, type: RecordType) -> None:
        self._type = type
        self._clear()

    def add(self, batch: Batch) -> None:
        """Add the records of a batch.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        if self._type.id == FRAME_START:
            records = _frame_records(batch, self._type)
        elif self._type.fixed:
            records = batch.records(self._type.name)
        else:
            self._add_objects(batch)
            return
        if records.size:
            self._records.append(records.flatten())
            self.memory += records.nbytes
            self._add_frames(batch, np.full(len(batch), records.shape[1]))

    def take(self) -> RecordTable:
        """Return the table of what was gathered, and begin anew."""
        frames, times, records, objects = self._frames, self._times, self._records, self._objects
        self._clear()
        fields = {
            name: _joined(kind, [piece[name] for piece in records], self._type.dtype[name])
            if self._type.fixed
            else _listed(kind, [getattr(record, name) for record in objects], wide=self._type.wide)
            for name, kind in self._type.layout.fields.items()
        }
        return RecordTable(self._type, np.concatenate([_NO_FRAMES, *frames]), np.concatenate([_NO_TIMES, *times]), fields)

    def _clear(self) -> None:
        self.rows = self.memory = 0
        self._frames: list[NDArray[np.uint64]] = []
        self._times: list[NDArray[np.float64]] = []
        self._records: list[NDArray[np.void]] = []
        self._objects: list[Any] = []

    def _add_objects(self, batch: Batch) -> None:
        columns = [column for column in batch.columns if column.type is not None and column.type.id == self._type.id]
        columns = [column for column in columns if column.size > len(EMPTY_LIST) or len(column.packet(0).records)]
        if not columns:
            return
        self.memory += sum(column.size for column in columns) * PARSED * len(batch)
        found = [[record for column in columns for record in column.packet(row).records] for row in range(len(batch))]
        self._objects += [record for records in found for record in records]
        self._add_frames(batch, np.array([len(records) for records in found]))

    def _add_frames(self, batch: Batch, counts: NDArray[np.int64]) -> None:
        """Add the number and the time of each frame as often as it has records."""
        self._frames.append(np.repeat(batch.id, counts))
        self._times.append(np.repeat(batch.elapsed, counts))
        self.rows += len(self._times[-1])


PARSED: Final = 50
"""How many times the memory of its payload a record needs whose size varies."""
_NO_FRAMES: Final = np.empty(0, np.uint64)
_NO_TIMES: Final = np.empty(0)


def record_table(reader: Reader, name: str) -> RecordTable:
    """Return the records of a type of a recording.

    Raises:
        RecordError: There is no such type.
        FormatError: The file contradicts its format.
    """
    builder = RecordTableBuilder(reader.header.table.named(name))
    for batch in reader.batches((name,)):
        builder.add(batch)
    return builder.take()


def _frame_records(batch: Batch, type: RecordType) -> NDArray[np.void]:
    """Return what the packets that start the frames of a batch hold, (frames, 1)."""
    records = np.empty((0 if batch.preamble else len(batch), 1), type.dtype)
    if len(records):
        records["id"][:, 0], records["duration"][:, 0], records["elapsed"][:, 0] = batch.id, batch.duration, batch.elapsed
    return records


def _joined(kind: str | Many, pieces: list[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    values = np.concatenate([np.empty(0, dtype), *pieces])
    return values != 0 if kind == FLAG else values


def _listed(kind: str | Many, values: list[Any], *, wide: bool) -> Any:
    """Return the values of a field of records that vary in size: an array of numbers, or a list."""
    if isinstance(kind, Many) or kind == TEXT:
        return [_plain(kind, value) for value in values]
    if kind == FLAG:
        return np.array(values, np.uint8) != 0
    return np.array(values, ("f8" if wide else "f4") if kind == REAL else kind)


def plain_record(layout: Layout, record: Any) -> dict[str, Any]:
    """Return a record whose size varies as plain Python: its fields by name."""
    return {name: _plain(kind, getattr(record, name)) for name, kind in layout.fields.items()}


def _plain(kind: str | Many, value: Any) -> Any:
    if isinstance(kind, Many):
        return _items(kind.layouts[0], value)
    if kind == TEXT:
        return readable(value)
    return bool(value) if kind == FLAG else value


def _items(layout: Layout, values: Any) -> list[dict[str, Any]]:
    if isinstance(values, np.ndarray):
        names = values.dtype.names or ()
        return [dict(zip(names, row, strict=True)) for row in values.tolist()]
    return [plain_record(layout, value) for value in values]
