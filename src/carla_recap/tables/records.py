"""The records of a type as a table: the frame and the time of each record, and its fields in CARLA's units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.layout import EMPTY_LIST, FLAG, TEXT, Layout, Many
from carla_recap.model.records import FRAME_START
from carla_recap.tables import Tabular
from carla_recap.tables.variable import Fields, Lists, joined, record_fields
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.records import RecordType


class RecordTable(Tabular):
    """All records of a type in a recording, as columns of one length.

    Attributes:
        type: The record type.
        frame: CARLA's numbers of the frames, (n,).
        time: Elapsed seconds, (n,).
    """

    def __init__(
        self, type: RecordType, frame: NDArray[np.uint64], time: NDArray[np.float64], fields: Mapping[str, Any]
    ) -> None:
        self.type = type
        self.frame = frame
        self.time = time
        self._fields = fields

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, name: str) -> Any:
        """Return a column.

        Raises:
            KeyError: There is no column of this name.
        """
        if name in ("frame", "time"):
            return self.frame if name == "frame" else self.time
        return _plain_column(self._fields[name])

    @property
    def fields(self) -> Mapping[str, Any]:
        """The fields of the records by name: arrays, (n,); lists of texts and of nested records."""
        return {name: _plain_column(values) for name, values in self._fields.items()}

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        return {"frame": self.frame, "time": self.time, **self.fields}

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return {"time": "s", **self.type.units}

    def _types(self) -> Mapping[str, Any]:
        return {name: str for name, kind in self.type.layout.fields.items() if kind == TEXT}

    def _arrow_columns(self) -> dict[str, Any]:
        return {"frame": self.frame, "time": self.time, **self._fields}


def _plain_column(values: Any) -> Any:
    if isinstance(values, Lists):
        return values.to_list()
    return values.tolist() if values.dtype == object else values


class RecordTableBuilder:
    """Collects the records of a type, of the table of the recording's build, from batches."""

    def __init__(self, type: RecordType) -> None:
        self._type = type
        self._clear()

    def add(self, batch: Batch) -> None:
        """Add the records of a batch."""
        if self._type.id == FRAME_START:
            records = _frame_records(batch, self._type)
        elif self._type.opaque:
            return
        elif self._type.fixed:
            records = batch.records(self._type.name)
        else:
            self._add_variable(batch)
            return
        if records.size:
            flat = records.flatten()
            self.memory += records.nbytes
            self._add(batch, len(batch), records.shape[1], {name: flat[name] for name in self._type.layout.fields})

    def take(self) -> RecordTable:
        """Return the table of the collected records, and forget them."""
        fields = joined(self._type, self._pieces)
        flags = {name: fields[name] != 0 for name, kind in self._type.layout.fields.items() if kind == FLAG}
        frames, times = np.concatenate([_NO_FRAMES, *self._frames]), np.concatenate([_NO_TIMES, *self._times])
        self._clear()
        return RecordTable(self._type, frames, times, fields | flags)

    def _clear(self) -> None:
        self.rows = self.memory = 0  # the number of collected records, and their size in bytes, roughly
        self._frames: list[NDArray[np.uint64]] = []
        self._times: list[NDArray[np.float64]] = []
        self._pieces: list[Fields] = []

    def _add_variable(self, batch: Batch) -> None:
        """Add the records of a batch whose size varies."""
        columns = [column for column in batch.columns if column.type is not None and column.type.id == self._type.id]
        columns = [column for column in columns if column.size > len(EMPTY_LIST) or len(column.packet(0).records)]
        if len(columns) > 1 and len(batch) > 1:  # the records of a frame follow each other
            for row in range(len(batch)):
                self._add_variable(batch[row : row + 1])
            return
        for column in columns:
            start = 0
            for frames, number, fields in record_fields(column, len(batch)):
                self._add(batch[start : start + frames], frames, number, fields)
                start += frames
            self.memory += column.size * PARSED * len(batch)

    def _add(self, batch: Batch, frames: int, number: int, fields: Fields) -> None:
        """Add the fields of records of frames that have the same number of records."""
        self._frames.append(np.repeat(batch.id, number))
        self._times.append(np.repeat(batch.elapsed, number))
        self._pieces.append(fields)
        self.rows += frames * number


PARSED: Final = 4
"""The memory that records of variable size need, as a multiple of the size of their payload."""
_NO_FRAMES: Final = np.empty(0, np.uint64)
_NO_TIMES: Final = np.empty(0)


def record_table(reader: Reader, name: str) -> RecordTable:
    """Return the records of a type of a recording; a `RecordError` if there is no such type."""
    builder = RecordTableBuilder(reader.header.table.named(name))
    for batch in reader.batches((name,)):
        builder.add(batch)
    return builder.take()


def _frame_records(batch: Batch, type: RecordType) -> NDArray[np.void]:
    """Return the records of the packets that start the frames of a batch, (frames, 1)."""
    records = np.empty((0 if batch.preamble else len(batch), 1), type.dtype)
    if len(records):
        records["id"][:, 0], records["duration"][:, 0], records["elapsed"][:, 0] = batch.id, batch.duration, batch.elapsed
    return records


def plain_record(layout: Layout, record: Any) -> dict[str, Any]:
    """Return the fields of a record of variable size by name, as plain Python values."""
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
