"""The files of an index: parts of tables, which appear one by one, and a lock for the process that writes them.

A part is a Parquet file `TABLE/part-RUN.parquet`; the parts of all tables with one number are one commit, and that of the
recordings is renamed last. Without it, the others do not count. If several parts have a recording, the one with the highest
number counts, in all tables. So a process may end at any moment, and readers need no lock.
"""

from __future__ import annotations

import os
import re
from contextlib import contextmanager, suppress
from json import dumps, loads
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.index.tables import RECORDING, RECORDINGS, RUN, TABLES
from carla_recap.util.files import WholeFile

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping
    from typing import IO

    import pyarrow as pa

MARKER: Final = "index.json"
"""The file that makes a folder an index."""
_LOCK: Final = ".lock"
_PARTIAL: Final = ".partial"
_PART: Final = re.compile(r"part-([0-9]{8,18})\.parquet")
_ROWS: Final = 1 << 16  # of a row group of merged parts


class IndexFolder:
    """The files of an index.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    def check(self) -> None:
        """Refuse a folder that is no index, or one of other tables than those of this version.

        Raises:
            RecapError: It is such a folder.
        """
        marker = self.path / MARKER
        try:
            content = loads(marker.read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            damaged = f"{MARKER} is damaged; index again into a new folder"
            reason = _reason(error) if isinstance(error, OSError) else damaged
            if not marker.exists():
                reason = "is no index of recordings, which 'carla-recap index' makes"
            raise RecapError(f"{str(self.path)[:200]}: {reason}") from None
        if content != _tables():
            raise RecapError(f"{self.path}: is an index of another version of carla-recap; index again into a new folder")

    def create(self) -> None:
        """Make the folder an index, if it is none and empty.

        Raises:
            RecapError: It has other files, or cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if (self.path / MARKER).exists():
                return
            if any(not item.name.startswith(".") for item in self.path.iterdir()):
                raise RecapError(f"{self.path}: is neither an index of recordings nor an empty folder")
        except (OSError, ValueError) as error:
            raise RecapError(f"{str(self.path)[:200]}: cannot be written: {_reason(error)}") from None
        with WholeFile(self.path / MARKER) as file:
            file.write((dumps(_tables(), indent=1) + "\n").encode())

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing; the system ends this when the process ends, however it does.

        Raises:
            RecapError: Another process is writing.
        """
        if self.path.is_file():
            raise RecapError(f"{self.path}: is a file; an index is a folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            file = (self.path / _LOCK).open("ab")
        except (OSError, ValueError) as error:
            raise RecapError(f"{str(self.path)[:200]}: cannot be written: {_reason(error)}") from None
        with file:
            try:
                _lock(file)
            except OSError:
                raise RecapError(f"{self.path}: another process is writing this index") from None
            yield

    def runs(self) -> list[int]:
        """Return the numbers of the commits, ascending."""
        return sorted(self._parts(RECORDINGS.name))

    def parts(self, table: str) -> dict[int, Path]:
        """Return the parts of a table that count, by number, ascending.

        Raises:
            RecapError: One of them is damaged, or has other columns than the table.
        """
        found = self._parts(table)
        counting = {run: found[run] for run in self.runs() if run in found}
        for path in counting.values():
            self._check_part(table, path)
        return counting

    def newest(self) -> dict[str, int]:
        """Return the number of the newest part of each recording."""
        newest: dict[str, int] = {}
        for run, rows in zip(self.runs(), self.columns(RECORDINGS.name, [RECORDING]), strict=True):
            newest.update(dict.fromkeys(rows[RECORDING].to_pylist(), run))
        return newest

    def columns(self, table: str, names: list[str]) -> Iterator[pa.Table]:
        """Yield columns of the parts of a table that count, also of their rows that do not."""
        from pyarrow import parquet

        for path in self.parts(table).values():
            yield parquet.read_table(path, columns=names, partitioning=None)

    def rows(self, table: str) -> pa.Table:
        """Return the rows of a table that count, without their last column."""
        import pyarrow as pa

        schema = TABLES[table].schema
        empty = schema.remove(schema.get_field_index(RUN)).empty_table()
        return pa.concat_tables([empty, *_counting(self.parts(table), self._members())])

    def clean(self) -> None:
        """Remove what a process left that ended early: unfinished files and parts without their commit."""
        runs = set(self.runs())
        for name in TABLES:
            for item in self._items(name):
                if item.name.endswith(_PARTIAL) or self._run(item) not in (None, *runs):
                    item.unlink(missing_ok=True)

    def commit(self, tables: Mapping[str, pa.Table], run: int) -> None:
        """Write the parts of a commit; empty ones of other tables than the recordings are left out.

        Args:
            tables: The rows by table, without their last column.
            run: The number of the commit.

        Raises:
            RecapError: They cannot be written.
        """
        self._write({name: [rows] for name, rows in tables.items() if len(rows)}, run)

    def merge(self, run: int, removed: Collection[str] = ()) -> None:
        """Write all rows that count into one part for each table, as a commit, and remove all other parts.

        Args:
            run: The number of the commit.
            removed: The recordings to leave out.

        Raises:
            RecapError: A part is damaged, or the new ones cannot be written.
        """
        counting = {newest: members.difference(removed) for newest, members in self._members().items()}
        old = {name: self.parts(name) for name in TABLES}
        self._write({name: _counting(parts, counting) for name, parts in old.items()}, run)
        # In this order, so that at no time a recording has lost rows.
        for path in (*old[RECORDINGS.name].values(), *(path for parts in old.values() for path in parts.values())):
            path.unlink(missing_ok=True)

    def _write(self, tables: Mapping[str, Iterable[pa.Table]], run: int) -> None:
        import pyarrow as pa

        from carla_recap.tables.arrow import ParquetFile

        written: list[tuple[Path, Path]] = []
        try:
            for name, pieces in tables.items():
                schema = TABLES[name].schema
                path = self.path / name / f"part-{run:08}.parquet"
                path.parent.mkdir(exist_ok=True)
                partial = path.with_name(path.name + _PARTIAL)
                written.append((partial, path))
                with ParquetFile(partial, schema) as file:
                    for piece in pieces:
                        numbered = piece.append_column(schema.field(RUN), pa.repeat(pa.scalar(run, pa.int64()), len(piece)))
                        file.write(numbered)
                with partial.open("rb+") as written_file:
                    os.fsync(written_file.fileno())
            for partial, path in written:  # that of the recordings is the last
                partial.replace(path)
        except OSError as error:
            raise RecapError(f"{self.path}: cannot be written: {_reason(error)}") from None
        finally:
            for partial, _ in written:
                with suppress(OSError):
                    partial.unlink(missing_ok=True)

    def _members(self) -> dict[int, set[str]]:
        """Return the recordings whose newest part has a number, by number."""
        members: dict[int, set[str]] = {}
        for recording, run in self.newest().items():
            members.setdefault(run, set()).add(recording)
        return members

    def _parts(self, table: str) -> dict[int, Path]:
        return {run: item for item in self._items(table) if (run := self._run(item)) is not None}

    def _items(self, table: str) -> list[Path]:
        try:
            return list((self.path / table).iterdir())
        except FileNotFoundError:
            return []
        except OSError as error:
            raise RecapError(f"{self.path / table}: cannot be read: {_reason(error)}") from None

    @staticmethod
    def _run(item: Path) -> int | None:
        match = _PART.fullmatch(item.name)
        return int(match[1]) if match else None

    @staticmethod
    def _check_part(table: str, path: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        try:
            fits = parquet.read_schema(path).equals(TABLES[table].schema)
        except (OSError, pa.ArrowException) as error:
            raise RecapError(f"{path}: is damaged ({_line(error)}); remove it and its like, and index again") from None
        if not fits:
            raise RecapError(f"{path}: does not have the columns of this index's table {table}")


def _counting(parts: Mapping[int, Path], recordings: Mapping[int, set[str]]) -> Iterator[pa.Table]:
    """Yield the rows of parts that count, without their last column.

    Args:
        parts: The parts by number.
        recordings: The recordings whose newest part has a number, by number.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import parquet

    for run, path in parts.items():
        if run not in recordings:
            continue
        members = pa.array(sorted(recordings[run]), pa.string())
        with parquet.ParquetFile(path) as file:
            for batch in file.iter_batches(_ROWS):
                rows = pa.table(batch).drop_columns([RUN])
                yield rows.filter(pc.is_in(rows[RECORDING], members))


def _tables() -> dict[str, dict[str, str]]:
    """Return what the marker has: the columns of all tables, with their types."""
    return {name: {field.name: str(field.type) for field in table.schema} for name, table in TABLES.items()}


def _lock(file: IO[bytes]) -> None:
    try:
        import fcntl
    except ImportError:  # on Windows
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or _line(error)


def _line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
