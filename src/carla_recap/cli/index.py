"""The commands that write an index of many recordings, and query it."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, closing
from dataclasses import asdict
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

import click

from carla_recap.cli import options
from carla_recap.cli.output import counted, fail, warn, wrote
from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.cli.sql_output import Form
    from carla_recap.fleet.index.database import RecordingIndex

T = TypeVar("T")

_LONGEST: Final = 200  # characters of the names of maps
_MEMORY: Final = 2 << 30  # bytes, for a query and its answer
_LONGEST_QUERY: Final = 1 << 20  # bytes
FAILED: Final = 2
"""The exit code if a recording cannot be read."""


@click.command()
@click.argument("sources", type=click.Path(allow_dash=True), nargs=-1, required=True, metavar="SOURCE...")
@click.argument("index_file", type=click.Path(), metavar="INDEX")
@options.jobs
@options.dask
@click.option(
    "--measures", is_flag=True, help="Read every frame, for near misses, the measures of heroes and incidents of the road."
)
@options.road_map
@click.option("--prune", is_flag=True, help="Remove recordings from INDEX that no SOURCE means.")
@click.option("--retry", is_flag=True, help="Read recordings again that could not be read, also unchanged ones.")
@click.option("--all", "again", is_flag=True, help="Read all recordings again, also unchanged ones.")
@options.written
def index(
    sources: tuple[str, ...],
    index_file: str,
    jobs: int | None,
    dask: str | None,
    measures: bool,
    road_map: str | None,
    prune: bool,
    retry: bool,
    again: bool,
) -> NoReturn:
    """Write what many recordings contain into INDEX, a DuckDB file such as runs.duckdb.

    Recordings that INDEX has, and that have not changed, are not read again. Without --measures, only their events are read.
    """
    from carla_recap.cli.many import client_of
    from carla_recap.cli.progress import SourcesBar
    from carla_recap.fleet.index.writing import write_index
    from carla_recap.queries.roads import WITHOUT_ROADS
    from carla_recap.util.signals import unwind_on_termination
    from carla_recap.util.text import readable

    bar = SourcesBar("indexing", None)

    def watched(outcomes: Iterable[T], count: int) -> Iterator[T]:
        nonlocal bar
        with SourcesBar("indexing", count) as bar:
            for outcome in outcomes:
                yield outcome
                bar.advance()

    def report(error: str) -> None:
        with bar.aside():
            fail(error)

    with ExitStack() as stack:
        stack.enter_context(unwind_on_termination())
        client = stack.enter_context(closing(client_of(dask))) if dask else None
        summary = write_index(
            sources,
            index_file,
            jobs=jobs,
            client=client,
            measures=measures,
            road_map=road_map,
            prune=prune,
            retry=retry,
            again=again,
            progress=watched,
            report=report,
        )
    counts = [f"{summary.read:,} read", f"{summary.failed:,} failed", f"{summary.unchanged:,} unchanged"]
    if summary.unreadable:
        counts[-1] += f", {summary.unreadable:,} of them with an error"
    if summary.removed:
        counts.append(f"{summary.removed:,} removed")
    things = "recording" if summary.recordings == 1 else "recordings"
    told = [f"{summary.recordings:,} {things} ({', '.join(counts)})"]
    if summary.read > summary.failed and not measures:
        told.append("events alone (--measures adds near misses)")
    wrote(index_file, *told, **asdict(summary))
    if summary.unknown_maps:
        named = readable(", ".join(repr(name) for name in summary.unknown_maps))[:_LONGEST]
        warn(f"unknown maps: {named}; {WITHOUT_ROADS}")
    sys.exit(FAILED if summary.failed else 0)


@click.command()
@click.argument("index_file", type=click.Path(), metavar="INDEX")
@click.argument("query")
@options.json
@options.form("csv", "Print CSV, as in a pipe.")
def sql(index_file: str, query: str, form: Form | None) -> NoReturn:
    """Answer QUERY, in SQL, from the tables of INDEX.

    The tables are recordings, actors, collisions, stationary, incidents and measures. A QUERY of - is read from stdin.
    """
    from carla_recap.cli import INTERRUPTED
    from carla_recap.cli.sql_output import show_rows
    from carla_recap.fleet.index.database import open_index

    text = _read_query() if query == "-" else query
    opened = open_index(index_file)
    _limit_memory()
    try:
        rows = opened.sql(text)
    except (KeyboardInterrupt, SystemExit) as end:
        os._exit(INTERRUPTED if isinstance(end, KeyboardInterrupt) else int(end.code or 0))  # the query may go on
    if _needs_measures(text, found=len(rows)) and (missing := _without_measures(opened)):
        what = "near misses, measures and incidents of the road, which 'carla-recap index --measures' adds"
        warn(f"{index_file}: {counted(missing, 'recording')} without {what}")
    show_rows(rows, form or ("table" if sys.stdout.isatty() else "csv"))
    sys.stdout.flush()
    os._exit(0)  # ending the interpreter takes longer than most queries


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
