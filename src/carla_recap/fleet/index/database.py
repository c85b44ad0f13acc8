"""An index as a DuckDB file: transactions that replace the rows of recordings, and queries that can read nothing else.

The file is open only during a transaction or a query, so that processes wait for each other for a short time. There is no
write-ahead log: a transaction is in the file when its checkpoint has ended, or not at all. DuckDB checks the checksums of
blocks when it reads them.
"""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.fleet.index.tables import RECORDING, RECORDINGS, TABLES
from carla_recap.util.files import WholeFile, prepare_file, reason_of
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from typing import Self

    import duckdb
    import pyarrow as pa

_READING: Final = "read_only"
_WRITING: Final = "recovery_mode no_wal_writes, storage_version 'v1.5.0', block_size 65536, row_group_size 20480"
"""How the file is opened; a checkpoint puts groups of rows together in memory, which takes 100 MB with the usual size."""
_CONFIG: Final[dict[str, Any]] = {
    "memory_limit": "1GB",
    "threads": 4,  # whose stacks count as memory of the process
    "temp_directory": "",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
}
_CONFINED: Final = ("set enable_external_access=false", "set errors_as_json=true", "set lock_configuration=true")
_NO_INDEX: Final = "is no index of recordings, which 'carla-recap index' makes"
_QUERIES: Final = "select, with, from, values, table, pivot, unpivot, describe, show or summarize"
_NO_DATABASE: Final = "not a valid DuckDB database file"  # in an error of DuckDB, which has no class of its own
_BUSY: Final = re.compile("Could not set lock|file handle conflict|being used by another process")
_PATIENCE: Final = 60.0  # s for which others may have the file open
_PAUSE: Final = 0.02  # s between attempts to open it
_INTERVAL: Final = 0.1  # s between looks at signals, which nothing else does on Windows
_INTERRUPTED: Final = "Query interrupted"  # DuckDB's error in place of what the handler of a signal raises
_OLD_MARKER: Final = "index.json"  # in the folders that indexes were before 0.3


class RecordingIndex:
    """An index of recordings, which `open_index` opens. Each query answers from what it has then.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path | str) -> None:
        _require()
        self.path = Path(path)
        if not _is_file(self.path):
            raise RecapError(f"{str(path)[:200]}: does not exist; 'carla-recap index' makes an index of recordings")
        with self._opened(_READING) as database:
            found = {name for (name,) in database.sql("select table_name from duckdb_tables()").fetchall()}
            if RECORDINGS.name not in found:
                raise RecapError(f"{path}: {_NO_INDEX}")
            tables = found & TABLES.keys()
            schemas = {name: database.sql(f"from {name} limit 0").to_arrow_table().schema for name in tables}
        if any(name not in schemas or not schemas[name].equals(table.schema) for name, table in TABLES.items()):
            raise RecapError(f"{path}: is an index of another version of carla-recap; {_remedy(self.path)}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"RecordingIndex({str(self.path)!r})"

    def close(self) -> None:
        """Do nothing: between two queries, no file is open."""

    def table(self, name: str) -> pa.Table:
        """Return a table of the index, with the units of columns in their metadata.

        Args:
            name: The table: recordings, actors, collisions, stationary, incidents, measures or sensors.

        Raises:
            RecapError: There is no such table, or the index is damaged.
        """
        if name not in TABLES:
            raise RecapError(f"{self.path}: no table {name!r}; there are {', '.join(TABLES)}")
        return self.sql(f"from {name}").cast(TABLES[name].schema)

    def sql(self, query: str) -> pa.Table:
        """Return the answer to a query in SQL, which can read the tables of the index and nothing else.

        Raises:
            RecapError: The query is wrong, or is no query, or needs more than 1 GB of memory, or the index is damaged.
        """
        import duckdb

        try:
            query.encode()
        except UnicodeEncodeError:
            raise RecapError(f"{_shown(query)}: is not UTF-8; a query in SQL was expected") from None
        with self._opened(_READING, query) as database:
            for setting in _CONFINED:
                database.execute(setting)
            kinds = [statement.type for statement in database.extract_statements(query)]
            if kinds not in ([duckdb.StatementType.SELECT], [duckdb.StatementType.MULTI]):  # the latter is a pivot
                raise RecapError(f"{_shown(query)}: one query was expected, which begins with {_QUERIES}")
            with ThreadPoolExecutor(1) as pool:  # in this thread, DuckDB drops what the handler of a signal raises
                answer = pool.submit(_answer, database, query)
                try:
                    while not wait([answer], _INTERVAL).done:
                        pass
                finally:
                    while not wait([answer], _PAUSE).done:
                        database.interrupt()
                return answer.result()

    def replace(self, tables: Mapping[str, pa.Table]) -> None:
        """Replace all rows of the recordings that a table of recordings has by new ones, in one transaction."""
        with self._changing(tables[RECORDINGS.name].select([RECORDING])) as database:
            for name, rows in tables.items():
                database.register("new", rows)
                database.execute(f"insert into {name} from new")

    def remove(self, recordings: Collection[str]) -> None:
        """Remove all rows of recordings, in one transaction."""
        import pyarrow as pa

        with self._changing(pa.table({RECORDING: pa.array(recordings, pa.string())})):
            pass

    def verify(self) -> None:
        """Read all tables; a `RecapError` if the index is damaged."""
        with self._opened(_READING) as database:
            for name in TABLES:
                database.execute(f"select bit_xor(hash(rows)) from {name} as rows")

    @contextmanager
    def _changing(self, keys: pa.Table) -> Iterator[duckdb.DuckDBPyConnection]:
        """Yield the database in a transaction, without the rows of some recordings."""
        with self._opened(_WRITING) as database:
            database.register("keys", keys)
            database.execute("begin")
            for name in TABLES:
                database.execute(f"delete from {name} where {RECORDING} in (from keys)")
            yield database
            database.execute("commit")
            database.execute("checkpoint")

    @contextmanager
    def _opened(self, mode: str, query: str = "") -> Iterator[duckdb.DuckDBPyConnection]:
        """Yield a database in memory to which the file is attached, when no other process hinders that any more."""
        import duckdb

        end = monotonic() + _PATIENCE
        database = duckdb.connect(":memory:", config=_CONFIG)
        try:
            while not _attach(database, self.path, mode):
                if monotonic() > end:
                    raise RecapError(f"{self.path}: another process has been using this index for {_PATIENCE:g} s")
                sleep(_PAUSE)
            yield database
        except duckdb.Error as error:
            raise self._failure(error, query) from None
        except RuntimeError as error:
            if str(error) == _INTERRUPTED:
                raise KeyboardInterrupt from None
            raise
        finally:
            database.close()

    def _failure(self, error: duckdb.Error, query: str) -> RecapError:
        """Return DuckDB's error in one line; of a damaged file, DuckDB's class does not always say so."""
        import duckdb

        if isinstance(error, duckdb.OutOfMemoryException):
            return RecapError(f"{self.path}: there is not enough memory for this query")
        if _NO_DATABASE in str(error):
            return RecapError(f"{self.path}: {_NO_INDEX}")
        damaged = (duckdb.IOException, duckdb.FatalException, duckdb.InternalException, duckdb.SerializationException)
        if isinstance(error, damaged) or type(error) is duckdb.Error:
            return RecapError(f"{self.path}: {_one_line(error)}; if the index is damaged, {_remedy(self.path)}")
        return RecapError(_one_line(error, query))


def open_index(path: Path | str) -> RecordingIndex:
    """Open an index of recordings, which `write_index` or `carla-recap index` has made.

    Raises:
        MissingExtra: DuckDB or pyarrow is not installed.
        RecapError: The file is no index, or one of another version, or damaged.
    """
    return RecordingIndex(path)


def create_index(path: Path | str) -> RecordingIndex:
    """Open an index of recordings as `open_index` does; without a file, make an empty one."""
    _require()
    path = Path(path)
    if not _is_file(path):
        prepare_file(path)
        content = _empty()
        try:
            with WholeFile(path, force=False) as file:
                file.write(content)
        except RecapError:
            if not _is_file(path):  # else another process was faster
                raise
    return RecordingIndex(path)


def _empty() -> bytes:
    """Return an index without recordings; the comments of its columns are their units."""
    import duckdb

    with TemporaryDirectory() as folder, duckdb.connect(":memory:", config=_CONFIG) as database:
        path = Path(folder) / "index"
        _attach(database, path, _WRITING)
        for name, table in TABLES.items():
            database.register("empty", table.schema.empty_table())
            database.execute(f"create table {name} as from empty")
            for column, unit in table.units.items():
                database.execute(f"comment on column {name}.{column} is {_quoted(unit)}")
        database.execute("checkpoint")
        database.execute("use memory")
        database.execute("detach stored")
        return path.read_bytes()


def _attach(database: duckdb.DuckDBPyConnection, path: Path, mode: str) -> bool:
    """Attach a file, whose tables then need no other name; return False while another process or thread hinders that."""
    import duckdb

    try:
        database.execute(f"attach {_quoted(path.absolute())} as stored (type duckdb, {mode})")
    except duckdb.Error as error:
        if _BUSY.search(str(error)):
            return False
        raise
    database.execute("use stored")
    return True


def _answer(database: duckdb.DuckDBPyConnection, query: str) -> pa.Table:
    import duckdb

    try:
        relation = database.sql(query)
    except duckdb.Error:
        database.execute(query)  # which raises the error with its position
        raise
    return relation.to_arrow_table()


def _require() -> None:
    try:
        import duckdb  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError:
        raise MissingExtra("an index", "sql") from None


def _is_file(path: Path) -> bool:
    """Return whether a file exists; a `RecapError` if it cannot be an index."""
    try:
        if (path / _OLD_MARKER).is_file():
            made = f"'carla-recap index SOURCE... {path.with_suffix('.duckdb')}' makes it anew"
            raise RecapError(f"{path}: is an index of an earlier version of carla-recap, a folder; {made}, as a file")
        if not path.exists():
            return False
        if not path.is_file():
            raise RecapError(f"{path}: is {'a folder' if path.is_dir() else 'no regular file'}; an index is a file")
        str(path).encode()
        if not path.stat().st_size:
            raise RecapError(f"{path}: is empty; {_remedy(path)}")
    except (OSError, ValueError) as error:
        raise RecapError(f"{str(path)[:200]}: cannot be an index: {reason_of(error)}") from None
    return True


def _remedy(path: Path) -> str:
    return f"remove it, and 'carla-recap index SOURCE... {path}' makes it anew"


def _quoted(text: Path | str) -> str:
    return "'" + str(text).replace("'", "''") + "'"


def _shown(query: str) -> str:
    line = single_line(query)
    return repr(line if len(line) <= 60 else f"{line[:57]}...")


def _one_line(error: Exception, query: str = "") -> str:
    """Return DuckDB's error in one line, with the words of the query that it is about, and their place from 1."""
    kind, _, text = str(error).partition(": ")
    about = loads(text) if text.startswith('{"exception') else {"exception_message": text}
    lines = [line.strip() for line in f"{kind}: {about['exception_message']}".splitlines()]
    if "position" in about:
        start, length = loads(about.get("location", f"[{about['position']},0]"))  # bytes
        content = query.encode()
        before, words = (part.decode(errors="replace") for part in (content[:start], content[start : start + length]))
        number, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        line = f"line {number}, " if "\n" in query.strip() else ""
        lines.append(f"at {line}character {column}" + (f": {_shown(words)}" if words else ""))
    return "; ".join(line for line in lines if line)
