"""Queries of one recording or of many: how the recordings are named, and how answers are printed as they come."""

from __future__ import annotations

import os
import re
import signal
import sys
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

from carla_recap.cli.output import (
    PYTHON_HINT,
    collect_warnings,
    counted,
    end,
    fail,
    form_of,
    is_too_many,
    print_pieces,
    show,
    warn,
)
from carla_recap.cli.progress import SourcesBar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

    from distributed import Client

    from carla_recap.fleet.answers import Form, Query, RecordingAnswer
    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")

_PAGE: Final = 200  # rows of a table
_INTERVAL: Final = 0.5  # s after which what is known is printed
_MEGABYTE: Final = 1 << 20
_LONGEST: Final = 300  # characters of the names of maps


@dataclass(frozen=True, slots=True, kw_only=True)
class SourcesRequest:
    """The recordings of a command, and which processes read them if there are many."""

    sources: tuple[str, ...]  # recordings, folders, globs and URLs
    jobs: int | None  # the number of processes; None: as many as are worthwhile
    dask: str | None  # the address of a Dask scheduler; None: processes of this machine read them

    @contextmanager
    def reading(self, title: str, read: Callable[..., Generator[T]]) -> Iterator[tuple[Iterator[T], Messages]]:
        """Yield what a function of `fleet` makes of the recordings and of which processes read them, and what prints errors.

        A progress bar counts what is made. Signals end the `with` block. A source that means no recording is read, too, as
        an error.
        """
        from carla_recap.fleet.sources import find_sources

        with cluster(self.dask) as client:
            found: Iterable[SourceFile] = find_sources(self.sources, errors="yield")
            if SourcesBar.is_shown():
                found = list(found)  # whose number the bar needs
            with (
                SourcesBar(title, len(found) if isinstance(found, list) else None) as bar,
                closing(read(found, jobs=self.jobs, client=client)) as outcomes,
            ):
                yield bar.counted(outcomes), Messages(bar)


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryRequest(SourcesRequest):
    """A query of one recording or of many."""

    form: str | None  # see `show`
    compat: bool = False  # whether the answer has the mistakes of CARLA 0.9.16
    max_rows: int | None = None  # the number of rows that are allowed

    @property
    def shape(self) -> Form:
        """The form in which the answer is printed."""
        return form_of(self.form, compat=self.compat)

    def answer(self, query: Query) -> NoReturn:
        """Print the answer to the query, and end the program.

        The exit code is 2 if a recording cannot be read, else 1 if all have more rows together than allowed.
        """
        if len(self.sources) == 1 and is_one(self.sources[0]):
            from carla_recap.formats import open_reader

            warned = collect_warnings() if self.shape == "json" else None
            with closing(open_reader(self.sources[0])) as reader:
                show(query(reader), self.shape, self.max_rows, warned)
        from carla_recap.fleet.answers import answers

        try:
            with self.reading("reading", partial(answers, query, self.shape)) as (given, messages):
                too_many = _print(given, self.shape, messages, self.max_rows)
        except BrokenPipeError:  # as without a handler, the pipe's end is that of this process
            if (number := getattr(signal, "SIGPIPE", None)) is not None:
                signal.signal(number, signal.SIG_DFL)
                signal.raise_signal(number)
            raise
        end(failed=messages.failed, unmet=too_many)


def is_one(source: str) -> bool:
    """Return whether a source means one recording by its form, so that it is answered as such."""
    if os.path.isfile(source):  # noqa: PTH113 - which is enough for most, and imports nothing
        return True
    from carla_recap.fleet.sources import means_one

    return means_one(source)


@contextmanager
def cluster(address: str | None) -> Iterator[Client | None]:
    """Yield a client of the Dask cluster at an address, if there is one; signals end the `with` block."""
    from carla_recap.util.signals import unwind_on_termination

    with unwind_on_termination():
        if address is None:
            yield None
            return
        from carla_recap.fleet.cluster import connect

        with closing(connect(address)) as client:
            yield client


def _print(given: Iterable[RecordingAnswer], form: Form, messages: Messages, max_rows: int | None) -> bool:
    """Print answers and errors; return whether there are more rows than allowed."""
    rows = 0

    def counted_ones() -> Iterator[RecordingAnswer]:
        nonlocal rows
        for each in given:
            yield each
            messages.add(each.source.location, each.warnings, each.error)
            rows += each.rows

    if form == "table":
        _print_tables(counted_ones(), messages)
    else:
        _print_text({"text": _text, "json": _json, "csv": _csv}[form](counted_ones()), messages.bar)
    messages.end()
    return is_too_many(rows, max_rows)


class Messages:
    """Prints errors and warnings about recordings, a line each; that maps are unknown, once for all recordings.

    Attributes:
        bar: The progress bar, beside which they are printed.
        failed: The number of errors.
    """

    def __init__(self, bar: SourcesBar) -> None:
        self.bar = bar
        self.failed = 0
        self._without_map: dict[str, list[str]] = {}

    def add(self, location: str, warnings: Iterable[str], error: str | None = None) -> None:
        """Print the warnings about a recording, and its error."""
        from carla_recap.queries.roads import unknown_map

        for message in warnings:
            said = _with_location(message, location)
            if name := unknown_map(message):
                self._without_map.setdefault(name, []).append(said)
            else:
                with self.bar.aside():
                    warn(said)
        if error is not None:
            self.failed += 1
            with self.bar.aside():
                fail(_with_location(re.sub(PYTHON_HINT, "", error), location))

    def end(self) -> None:
        """Warn of unknown maps."""
        from carla_recap.queries.roads import WITHOUT_ROADS

        messages = list(chain.from_iterable(self._without_map.values()))
        if len(messages) == 1:
            warn(messages[0])
        elif messages:
            names = ", ".join("(no name)" if name == "''" else name for name in self._without_map)
            maps = "an unknown map" if len(self._without_map) == 1 else "unknown maps"
            warn(f"{len(messages)} recordings are of {maps}: {names[:_LONGEST]}; {WITHOUT_ROADS}")


def _with_location(message: str, location: str) -> str:
    return message if location in message else f"{location}: {message}"


def _text(given: Iterable[RecordingAnswer]) -> Iterator[str]:
    """Yield lines with the name of the recording in front; where each is a row, with a heading above the first."""
    from carla_recap.output.text import heading

    def headed(kind: type[Any]) -> str:
        line = heading(kind.__name__)
        return f"Recording\t{line}" if line else ""

    lines = _headed(given, headed)
    if sys.stdout.isatty():  # where tabs are shown as escape sequences, as all that controls it
        return (re.sub(r"(?m)^([^\t\n]*)\t", r"\1  ", line) for line in lines)
    return lines


def _csv(given: Iterable[RecordingAnswer]) -> Iterator[str]:
    """Yield a line with the names of the columns, then one for each row, with the recording in front."""
    from carla_recap.output.csv import heading

    return _headed(given, lambda kind: heading(kind.row_type, "recording"))


def _headed(given: Iterable[RecordingAnswer], heading: Callable[[type[Any]], str]) -> Iterator[str]:
    """Yield the heading of a kind of answers, and the lines of all."""
    is_headed = False
    for each in given:
        for piece in chain(each.pieces, [""]):  # with the first of which, or behind them, the kind is known
            if not is_headed and each.kind is not None:
                is_headed = True
                yield heading(each.kind)
            yield str(piece)


def _json(given: Iterable[RecordingAnswer]) -> Iterator[str]:
    """Yield one JSON object: the rows of all recordings, then the recordings, whose text waits in a file."""
    from tempfile import SpooledTemporaryFile

    from carla_recap.output.json import array_of, encoded, facts

    with SpooledTemporaryFile(_MEGABYTE, "w+") as recordings:

        def rows() -> Iterator[str]:
            for each in given:
                yield from map(str, each.pieces)
                about = {"recording": each.source.location, "error": each.error, "rows": each.rows}
                more = {**facts(each.header, each.extent), "warnings": list(each.warnings)}
                recordings.write(encoded({**about, **more}) + "\n")

        yield '{"rows": '
        yield from array_of(rows())
        recordings.seek(0)
        yield ', "recordings": '
        yield from array_of(line.removesuffix("\n") for line in recordings)
        yield "}\n"


def _print_text(pieces: Iterable[str], bar: SourcesBar) -> None:
    """Print pieces of a text, many together; what is known is printed after a while."""
    waiting, size, due = list[str](), 0, 0.0
    for piece in pieces:
        waiting.append(piece)
        size += len(piece)
        if size > _MEGABYTE or monotonic() > due:
            with bar.aside():
                print_pieces(waiting)
            waiting, size, due = [], 0, monotonic() + _INTERVAL
    bar.close()
    print_pieces(waiting)


def _print_tables(given: Iterable[RecordingAnswer], messages: Messages) -> None:
    """Print tables of some rows each, tables of the errors between them, and a line with the numbers of all."""
    from rich.console import Console

    from carla_recap.output.table import print_rows
    from carla_recap.output.terminal import TableColumn

    console, recording = Console(), TableColumn("Recording", narrowed="middle")
    page, errors = list[Any](), list[tuple[str, str]]()
    kind: type[Any] | None = None
    rows = recordings = 0
    since = 0.0

    def print_page() -> None:
        with messages.bar.aside():
            if page:
                print_rows(console, kind and kind.row_type, page, recording)
            if errors:
                print_rows(console, None, errors, recording, TableColumn("Error", narrowed="words"))
        page.clear()
        errors.clear()

    for each in given:
        if not page and not errors:
            since = monotonic()
        for piece in each.pieces:
            kind = each.kind
            page.append(piece)
            if len(page) == _PAGE:
                print_page()
        if each.error is not None:
            location = each.source.location
            errors.append((location, each.error.removeprefix(f"{location}: ")))
        rows += each.rows
        recordings += 1
        if monotonic() > since + _INTERVAL:
            print_page()
    messages.bar.close()
    print_page()
    failed = f", {messages.failed} failed" if messages.failed else ""
    console.print(f"{counted(rows, 'row')}; {counted(recordings, 'recording')}{failed}", highlight=False)
