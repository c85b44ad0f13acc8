"""Queries of an index: its tables as Arrow tables, and SQL by DuckDB, which can neither change nor read anything else."""

from __future__ import annotations

from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.fleet.index.folder import IndexFolder
from carla_recap.fleet.index.tables import RECORDING, RECORDINGS, RUN, TABLES
from carla_recap.tables import arrow

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

    import duckdb
    import pyarrow as pa

_SETTINGS: Final = (
    "set autoinstall_known_extensions=false",
    "set autoload_known_extensions=false",
    "set enable_external_access=false",
    "set lock_configuration=true",
)
_NEWEST: Final = "internal.newest"
_INTERVAL: Final = 0.1  # s between looks at signals
_GRACE: Final = 1.0  # s for a query to end after a signal


class RecordingIndex:
    """An index of recordings; a context manager.

    SQL answers from what the index had at the first query.

    Args:
        path: The folder.

    Raises:
        MissingExtra: pyarrow is not installed.
        RecapError: The folder is no index, or is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        arrow.require("an index")
        self.path = Path(path)
        self._folder = IndexFolder(path)
        self._folder.check()
        self._database: duckdb.DuckDBPyConnection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"RecordingIndex({str(self.path)!r})"

    def close(self) -> None:
        """Close the database."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def table(self, name: str) -> pa.Table:
        """Return a table of the index, with the units of columns in their metadata.

        Args:
            name: The table: recordings, actors, collisions, stationary, incidents or measures.

        Raises:
            RecapError: There is no such table, or the index is damaged.
        """
        if name not in TABLES:
            raise RecapError(f"{self.path}: no table {name!r}; there are {', '.join(TABLES)}")
        return self._folder.rows(name)

    def sql(self, query: str) -> pa.Table:
        """Return the answer to a query in SQL, which can read the tables of the index and nothing else.

        Raises:
            MissingExtra: DuckDB is not installed.
            RecapError: The query is wrong, or is no query, or the index is damaged.
        """
        duckdb = _duckdb()
        for last in (False, True):
            if self._database is None:
                self._database = self._open()
            try:
                kinds = [statement.type for statement in self._database.extract_statements(query)]
                if kinds not in ([duckdb.StatementType.SELECT], [duckdb.StatementType.MULTI]):  # the latter is a pivot
                    raise RecapError(f"{_shown(query)}: one query that begins with 'select' was expected")
                return _answer(self._database, query)
            except duckdb.IOException as error:
                if last:
                    raise RecapError(_one_line(error)) from None
                self.close()  # another process has merged the parts, perhaps: the index is opened again
            except duckdb.Error as error:
                raise RecapError(_one_line(error)) from None
            except (KeyboardInterrupt, SystemExit):
                self._database = None  # which the query may still use
                raise
        raise AssertionError

    def _open(self) -> duckdb.DuckDBPyConnection:
        """Return a database in memory, with the tables of the index as views."""
        database: duckdb.DuckDBPyConnection = _duckdb().connect(":memory:")
        try:
            database.execute("create schema internal")
            parts = {name: self._folder.parts(name) for name in TABLES}
            newest = _files(parts[RECORDINGS.name].values())
            if newest:
                columns = f"{RECORDING}, max({RUN}) as {RUN}"
                database.execute(f"create table {_NEWEST} as select {columns} from {newest} group by {RECORDING}")
            for name, table in TABLES.items():
                files = _files(parts[name].values())
                if files:
                    rows = f"select * exclude ({RUN}) from {files} semi join {_NEWEST} using ({RECORDING}, {RUN})"
                    database.execute(f"create view {name} as {rows}")
                else:
                    empty = table.schema.remove(table.schema.get_field_index(RUN)).empty_table()
                    database.register("empty", empty)
                    database.execute(f"create table {name} as from empty")
                    database.unregister("empty")
            database.execute(f"set allowed_directories=[{_quoted(self.path.absolute())}]")
            for setting in _SETTINGS:
                database.execute(setting)
        except BaseException:
            database.close()
            raise
        return database


def open_index(path: Path | str) -> RecordingIndex:
    """Open an index of recordings, which `write_index` or `carla-recap index` has made.

    Raises:
        MissingExtra: pyarrow is not installed.
        RecapError: The folder is no index, or one of another version.
    """
    return RecordingIndex(path)


def _answer(database: duckdb.DuckDBPyConnection, query: str) -> pa.Table:
    """Return the answer to a query, which a signal ends: DuckDB itself heeds none."""
    found: list[pa.Table] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            found.append(database.sql(query).to_arrow_table())
        except BaseException as error:
            failed.append(error)

    thread = Thread(target=work, name="carla-recap-sql", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_INTERVAL)
    except BaseException:
        database.interrupt()
        thread.join(_GRACE)
        raise
    if failed:
        raise failed[0]
    return found[0]


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise MissingExtra("SQL", "sql") from None
    return duckdb


def _files(paths: Any) -> str:
    """Return some files as a table of DuckDB; empty without any."""
    names = ", ".join(_quoted(path.absolute()) for path in paths)
    return f"read_parquet([{names}])" if names else ""


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def _shown(query: str) -> str:
    line = " ".join(query.split())
    return repr(line if len(line) <= 60 else f"{line[:57]}...")


def _one_line(error: Exception) -> str:
    """Return DuckDB's error without the quotation of the query, in one line."""
    lines = [line.strip() for line in str(error).partition("\n\nLINE ")[0].splitlines()]
    return "; ".join(line for line in lines if line)
