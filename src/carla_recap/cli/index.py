"""The commands that write an index of many recordings, and query it."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, NoReturn

import click

from carla_recap.cli import options
from carla_recap.cli.output import say
from carla_recap.cli.progress import watch_recordings

if TYPE_CHECKING:
    from carla_recap.cli.sql_output import Form

FAILED = 2
"""The exit code if a recording cannot be read."""


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="SOURCES...")
@click.argument("index_folder", type=click.Path(), metavar="INDEX")
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Processes that read; else one per processor.")
@click.option("--prune", is_flag=True, help="Remove recordings from INDEX that SOURCES do not mean.")
@click.option("--retry", is_flag=True, help="Read recordings again that could not be read, also unchanged ones.")
@click.option("--all", "again", is_flag=True, help="Read all recordings again, also unchanged ones.")
def index(sources: tuple[str, ...], index_folder: str, jobs: int | None, prune: bool, retry: bool, again: bool) -> NoReturn:
    """Write what many recordings contain into INDEX, a folder of Parquet tables.

    SOURCES are files, folders and globs. Recordings that INDEX has, and that have not changed, are not read again.
    """
    from carla_recap.fleet.index import write_index

    summary = write_index(
        sources,
        index_folder,
        jobs=jobs,
        prune=prune,
        retry=retry,
        again=again,
        progress=watch_recordings("Indexing"),
        report=lambda error: say(f"carla-recap: {error}"),
    )
    counts = [f"{summary.read:,} read", f"{summary.failed:,} failed", f"{summary.unchanged:,} unchanged"]
    if summary.removed:
        counts.append(f"{summary.removed:,} removed")
    say(f"{index_folder}: {summary.recordings:,} recordings: {', '.join(counts)}")
    sys.exit(FAILED if summary.failed else 0)


@click.command()
@click.argument("index_folder", type=click.Path(), metavar="INDEX")
@click.argument("query")
@options.json
@click.option("--csv", "form", flag_value="csv", help="Print CSV, as in a pipe.")
def sql(index_folder: str, query: str, form: Form | None) -> NoReturn:
    """Answer QUERY, in SQL, from the tables of INDEX.

    The tables are recordings, actors, collisions, stationary, incidents and measures. A QUERY of - is read from stdin.
    """
    from carla_recap.cli.sql_output import show_rows
    from carla_recap.fleet.index import open_index

    text = sys.stdin.read() if query == "-" else query
    show_rows(open_index(index_folder).sql(text), form or ("table" if sys.stdout.isatty() else "csv"))
    sys.stdout.flush()
    os._exit(0)  # ending the interpreter takes longer than most queries
