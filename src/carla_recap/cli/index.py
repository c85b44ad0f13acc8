"""The commands that write an index of many recordings, and query it: rows of SQL as a table, as JSON or as CSV."""

from __future__ import annotations

import sys
from dataclasses import asdict
from itertools import chain, islice
from json import JSONEncoder, loads
from types import NoneType
from typing import TYPE_CHECKING, Any, Final, Literal, NoReturn

from carla_recap.cli import options
from carla_recap.cli.options import argument, command, flag, together
from carla_recap.cli.output import counted, emit, end, fail, warn, wrote
from carla_recap.cli.progress import SourcesBar
from carla_recap.errors import RecapError
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import pyarrow as pa
    from rich.table import Table

    from carla_recap.fleet.index.database import RecordingIndex

_LONGEST: Final = 200  # characters of the names of maps
_MEMORY: Final = 2 << 30  # bytes, for a query and its answer
_LONGEST_QUERY: Final = 1 << 20  # bytes
Form = Literal["table", "json", "csv"]
_PAGE: Final = 500  # rows of a table whose columns are as wide as needed for all of them
_encoded: Final = JSONEncoder(ensure_ascii=False).encode


@command(
    options.sources,
    argument("index_file", "INDEX"),
    options.jobs,
    options.dask,
    flag("--measures", help="Read every frame, for near misses, the measures of heroes and incidents of the road."),
    options.road_map,
    options.path("--route", help="Score recordings by this Leaderboard route file."),
    flag("--prune", help="Remove recordings from INDEX that no SOURCE means."),
    flag("--retry", help="Read recordings again that could not be read, also unchanged ones."),
    flag("--all", "again", help="Read all recordings again, also unchanged ones."),
    options.written,
)
def index(sources: tuple[str, ...], index_file: str, dask: str | None, **how: Any) -> NoReturn:
    """Write what many recordings contain into INDEX, a DuckDB file such as runs.duckdb.

    Recordings that INDEX has, and that have not changed, are not read again. Without --measures, only their events are read.
    """
    from carla_recap.cli.many import cluster
    from carla_recap.fleet.index.writing import write_index
    from carla_recap.queries.roads import WITHOUT_ROADS
    from carla_recap.util.text import readable

    with cluster(dask) as client, SourcesBar("indexing", None) as bar:

        def report(error: str) -> None:
            with bar.aside():
                fail(error)

        summary = write_index(sources, index_file, client=client, progress=bar.counted, report=report, **how)
    counts = [f"{summary.read:,} read", f"{summary.failed:,} failed", f"{summary.unchanged:,} unchanged"]
    if summary.unreadable:
        counts[-1] += f", {summary.unreadable:,} of them with an error"
    if summary.removed:
        counts.append(f"{summary.removed:,} removed")
    things = "recording" if summary.recordings == 1 else "recordings"
    facts = [f"{summary.recordings:,} {things} ({', '.join(counts)})"]
    if summary.read > summary.failed and not how["measures"]:
        facts.append("events alone (--measures adds near misses)")
    wrote(index_file, *facts, **asdict(summary))
    if summary.unknown_maps:
        named = readable(", ".join(repr(name) for name in summary.unknown_maps))[:_LONGEST]
        warn(f"unknown maps: {named}; {WITHOUT_ROADS}")
    end(failed=summary.failed)


@command()
def sql(
    index_file: str = argument("index_file", "INDEX"),
    query: str = argument("query", "QUERY", type=str),
    form: Form | None = together(options.json, options.form("csv", "Print CSV, as in a pipe.")),
) -> None:
    """Answer QUERY, in SQL, from the tables of INDEX.

    The tables are recordings, actors, collisions, stationary, incidents and measures. A QUERY of - is read from stdin.
    """
    from carla_recap.fleet.index.database import open_index

    text = _read_query() if query == "-" else query
    opened = open_index(index_file)
    _limit_memory()
    rows = opened.sql(text)
    if _needs_measures(text, found=len(rows)) and (missing := _without_measures(opened)):
        what = "near misses, measures and incidents of the road, which 'carla-recap index --measures' adds"
        warn(f"{index_file}: {counted(missing, 'recording')} without {what}")
    show_rows(rows, form or ("table" if sys.stdout.isatty() else "csv"))


def _read_query() -> str:
    text = sys.stdin.buffer.read(_LONGEST_QUERY + 1)
    if len(text) > _LONGEST_QUERY:
        raise RecapError(f"stdin: a query of at most {_LONGEST_QUERY:,} bytes was expected")
    return text.decode("utf-8", "surrogateescape")


def _limit_memory() -> None:
    """Limit the memory of this process, since DuckDB's own limit does not count answers and long texts."""
    try:
        import resource
    except ImportError:  # on Windows
        return
    _, allowed = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _MEMORY if allowed == resource.RLIM_INFINITY else min(_MEMORY, allowed)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, allowed))


def _needs_measures(query: str, *, found: int) -> bool:
    from carla_recap.queries.kinds import KINDS

    words = query.lower()
    names = ("measures", *(name for name, kind in KINDS.items() if kind.every_frame))
    return any(name in words for name in names) or ("incidents" in words and not found)


def _without_measures(opened: RecordingIndex) -> int:
    """Return the number of recordings that were read without --measures."""
    rows = opened.table("recordings").select(["measured", "error"]).to_pylist()
    return sum(not row["measured"] and row["error"] is None for row in rows)


def show_rows(rows: pa.Table, form: Form) -> None:
    """Print the rows of an answer on stdout, with values as DuckDB has them in JSON; those that are not finite are null."""
    import duckdb

    database = duckdb.connect(config={"threads": 1})
    answer = database.from_arrow(rows)
    names = answer.columns  # with numbers behind those that are repeated
    database.register("answer", answer)
    database.execute("select to_json(struct_pack(*columns(*)))::varchar from answer")
    texts = iter(database.fetchone, None)
    found = (loads(text, parse_constant=lambda _: None) for (text,) in texts)
    write = {"table": _print_table, "json": _json, "csv": _csv}[form]
    emit(form, **{form: lambda: write(names, found)})


def _json(_: list[str], rows: Iterable[dict[str, Any]]) -> Iterator[str]:
    from carla_recap.output.json import array_of

    yield '{"rows": '
    yield from array_of(map(_encoded, rows))
    yield "}\n"


def _csv(names: list[str], rows: Iterable[dict[str, Any]]) -> Iterator[str]:
    from carla_recap.output.csv import line

    return (line(map(_text, cells)) for cells in chain([names], (row.values() for row in rows)))


def _print_table(names: list[str], rows: Iterator[dict[str, Any]]) -> None:
    """Print rows as a table; if it is too wide for the terminal, each row as a list of its values."""
    from rich.console import Console
    from rich.text import Text

    from carla_recap.output.terminal import TableColumn, fits, print_table

    console = Console()
    count = 0
    while page := list(islice(rows, _PAGE)):
        columns = []
        for name in names:
            is_number = all(type(row[name]) in (int, float, NoneType) for row in page)
            columns.append(TableColumn(name, is_number=is_number, narrowed="never" if is_number else "words", least=1))
        cells = [list(map(_shown, row.values())) for row in page]
        if len(names) == 1 or fits(columns, cells, console.width):
            print_table(columns, cells, console, headed=not count)
        else:
            for row in page:
                console.print(_list_of(row))
        count += len(page)
    console.print(Text(counted(count, "row")))


def _list_of(row: dict[str, Any]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, value in row.items():
        table.add_row(Text(visible(name), style="bold"), Text(visible(_shown(value))))
    table.add_row()
    return table


def _shown(value: Any) -> str:
    """Return a value as a table shows it: real numbers with six digits."""
    return number(value) if isinstance(value, float) else _text(value)


def _text(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else _encoded(value)
