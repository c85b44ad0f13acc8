"""Export to Parquet files, for DuckDB, Polars, Spark and other tools."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.model.records import FRAME_END
from carla_recap.tables import arrow
from carla_recap.tables.records import PARSED, RecordTableBuilder
from carla_recap.util.files import check_folder, new_folder

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.editing.convert import Progress
    from carla_recap.model.batch import Batch
    from carla_recap.model.records import RecordType
    from carla_recap.recording import Recording

ROWS: Final = 1 << 18
MEMORY: Final = 64 << 20
"""The limits of a row group, in rows and in bytes."""
_PIECE: Final = 4 << 20  # bytes of a type that are handled at once

RENAMED: Final = {"collisions": "collision_records"}
"""The names of the files of record types whose own name is that of a query."""


def export_parquet(
    recording: Recording, folder: Path | str, *, force: bool = False, progress: Progress | None = None
) -> list[Path]:
    """Write the tables of a recording into a folder, as Parquet files; see `export`.

    Each record type of the recording gets a file, such as `transforms.parquet`, with the columns of `Recording.table`;
    `actors.parquet`, `collisions.parquet` and `incidents.parquet` contain the results of the queries (the records of
    collisions are in `collision_records.parquet`). The metadata of columns contain their units.

    With `force`, files of the same names are written over. Return the files.
    """
    arrow.require("an export to Parquet")
    check_folder(folder, force=force)
    answers = {"actors": recording.actors, "collisions": recording.collisions(), "incidents": recording.incidents()}
    with new_folder(folder) as partial:
        for name, answer in answers.items():
            answer.to_parquet(partial / f"{name}.parquet")
        reader = recording.reader
        batches: Iterable[Batch] = reader.batches()
        _write_records(progress(batches, reader) if progress else batches, reader.header.table.named("frame"), partial)
        names = sorted(file.name for file in partial.iterdir())
    return [Path(folder) / name for name in names]


def _write_records(batches: Iterable[Batch], frame: RecordType, folder: Path) -> None:
    """Write a file for each record type of a recording."""
    with ExitStack() as stack:
        tables: dict[str, _RecordFile] = {}
        for batch in batches:
            types = {frame.name: frame} | {column.type.name: column.type for column in batch.columns if column.type}
            for part in _pieces(batch):
                for name, type in types.items():
                    if type.id == FRAME_END or type.opaque:
                        continue
                    if name not in tables:
                        tables[name] = _RecordFile(type, folder / f"{RENAMED.get(name, name)}.parquet", stack)
                    tables[name].add(part)
        for table in tables.values():
            table.flush()


def _pieces(batch: Batch) -> Iterable[Batch]:
    """Yield a batch in parts whose records need little memory."""
    of_frame = (column.size * (1 if column.type is None or column.type.fixed else PARSED) for column in batch.columns)
    largest = max(of_frame, default=0)
    count = max(_PIECE // max(largest, 1), 1)
    if count >= len(batch):
        yield batch
        return
    for start in range(0, len(batch), count):
        yield batch[start : start + count]


class _RecordFile:
    """The file of a record type, created with its first records, which a stack closes."""

    def __init__(self, type: RecordType, path: Path, stack: ExitStack) -> None:
        self._builder = RecordTableBuilder(type)
        self._path = path
        self._stack = stack
        self._file: arrow.ParquetFile | None = None

    def add(self, batch: Batch) -> None:
        """Add the records of a batch."""
        self._builder.add(batch)
        if self._builder.rows >= ROWS or self._builder.memory >= MEMORY:
            self.flush()

    def flush(self) -> None:
        """Write the collected records as a row group."""
        if not self._builder.rows:
            return
        table = self._builder.take().to_arrow()
        if self._file is None:
            self._file = self._stack.enter_context(arrow.ParquetFile(self._path, table.schema))
        self._file.write(table)
