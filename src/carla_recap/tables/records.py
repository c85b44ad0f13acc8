"""The records of a type as a table: the frame and the time of each, and its fields, as CARLA records them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.records import FLAG, TEXT, Layout, Many
from carla_recap.tables import Tabular
from carla_recap.texts import readable

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pyarrow as pa
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.records import RecordType


@dataclass(frozen=True, eq=False)
class RecordTable(Tabular):
    """All records of a type in a recording, as columns of one length.

    Attributes:
        type: The record type.
        frame: The positions of the frames in the recording, from 0, (n,).
        time: Elapsed seconds, (n,).
        fields: The fields of the records by name: arrays, (n,); lists where the size of a record varies.
    """

    type: RecordType
    frame: NDArray[np.int64]
    time: NDArray[np.float64]
    fields: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, name: str) -> Any:
        return {"frame": self.frame, "time": self.time, **self.fields}[name]

    def _columns(self) -> list[tuple[str, bool, Any]]:
        texts = {name for name, kind in self.type.layout.fields.items() if kind == TEXT}
        columns = {"frame": self.frame, "time": self.time, **self.fields}
        return [(name, name in texts, values) for name, values in columns.items()]

    def to_arrow(self) -> pa.Table:
        """Return an Arrow table, whose columns have their units in the metadata.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        import pyarrow as pa

        table = super().to_arrow()
        units = column_units(self.type)
        schema = [
            field.with_metadata({"unit": units[field.name]}) if field.name in units else field for field in table.schema
        ]
        return table.cast(pa.schema(schema))

    def to_parquet(self, path: Path | str) -> None:
        """Write a Parquet file, whose columns have their units in the metadata.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        try:
            import pyarrow.parquet
        except ImportError:
            raise MissingExtra("to_parquet()", "arrow") from None
        pyarrow.parquet.write_table(self.to_arrow(), path)


def record_table(reader: Reader, name: str) -> RecordTable:
    """Return the records of a type of a recording.

    Raises:
        RecordError: There is no such type.
        FormatError: The file contradicts its format.
    """
    type = reader.header.table.named(name)
    frames: list[NDArray[np.int64]] = []
    times: list[NDArray[np.float64]] = []
    arrays: list[NDArray[np.void]] = []
    objects: list[Any] = []
    for batch in reader.batches((name,)):
        index = np.arange(batch.index, batch.index + len(batch))
        if type.fixed:
            records = batch.records(name)
            count = np.full(len(batch), records.shape[1])
            arrays.append(records.ravel())
        else:
            found = [frame[name] for frame in batch]
            count = np.array([len(records) for records in found])
            objects += [record for records in found for record in records]
        frames.append(np.repeat(index, count))
        times.append(np.repeat(batch.elapsed, count))
    rows = np.concatenate(arrays) if arrays else np.empty(0, type.dtype)
    fields = {
        field: _column(kind, rows[field]) if type.fixed else [_plain(kind, getattr(record, field)) for record in objects]
        for field, kind in type.layout.fields.items()
    }
    frame = np.concatenate(frames) if frames else np.empty(0, np.int64)
    return RecordTable(type, frame, np.concatenate(times) if times else np.empty(0), fields)


def column_units(type: RecordType) -> dict[str, str]:
    """Return the units of the columns of a type's table, by name; columns without a unit are left out."""
    return {"time": "s", **type.units}


def _column(kind: str | Many, values: Any) -> Any:
    return values != 0 if kind == FLAG else np.ascontiguousarray(values)


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
