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

from carla_recap.cli.opening import opened
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
            warned = collect_warnings() if self.shape == "json" else None
            show(query(opened(self.sources[0])), self.form, self.max_rows, warned)
        from carla_recap.fleet.answers import answers

        try:
            with self.reading("reading", partial(answers, query, self.shape)) as (given, messages):
                too_many = _print(given, self.shape, messages, self.max_rows)
        except BrokenPipeError:
            _end_as_by_a_closed_pipe()
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


def _print(given: Iterable[RecordingAnswer], form: str, messages: Messages, max_rows: int | None) -> bool:
    """Print answers and errors; return whether there are more rows than allowed."""
    printer, rows = _PRINTERS[form](messages.bar), 0
    for each in given:
        printer.add(each)
        messages.add(each.source.location, each.warnings, each.error)
        rows += each.rows
    messages.bar.close()
    printer.end()
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


def _end_as_by_a_closed_pipe() -> None:
    number = getattr(signal, "SIGPIPE", None)
    if number is not None:
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)


class _TextPrinter:
    """Prints lines with the name of the recording in front; where each is a row, with a heading above the first."""

    def __init__(self, bar: SourcesBar) -> None:
        self._out = _Output(bar)
        self._is_headed = False
        self._is_terminal = sys.stdout.isatty()

    def add(self, given: RecordingAnswer) -> None:
        for piece in given.pieces:
            self._head(given)
            self._write(str(piece))
        self._head(given)
        self._out.pause()

    def end(self) -> None:
        self._out.flush()

    def _head(self, given: RecordingAnswer) -> None:
        if not self._is_headed and given.kind is not None:
            self._is_headed = True
            self._write(self._heading(given.kind))

    def _heading(self, kind: type[Any]) -> str:
        from carla_recap.output.text import heading

        line = heading(kind.__name__)
        return f"Recording\t{line}" if line else ""

    def _write(self, lines: str) -> None:
        if self._is_terminal:  # where tabs are shown as escape sequences, as all that controls it
            lines = re.sub(r"(?m)^([^\t\n]*)\t", r"\1  ", lines)
        self._out.write(lines)


class _JsonPrinter:
    """Prints one JSON object: the rows of all recordings, then the recordings, whose text waits in a file."""

    def __init__(self, bar: SourcesBar) -> None:
        from tempfile import SpooledTemporaryFile

        self._out = _Output(bar)
        self._out.write('{"rows": [')
        self._separator = "\n"
        self._recordings = SpooledTemporaryFile(_MEGABYTE, "w+")  # noqa: SIM115 - which ends with the process

    def add(self, given: RecordingAnswer) -> None:
        from carla_recap.output.json import encoded, facts

        for piece in given.pieces:
            self._out.write(self._separator + str(piece))
            self._separator = ",\n"
        about = {"recording": given.source.location, "error": given.error, "rows": given.rows}
        more = {**facts(given.header, given.extent), "warnings": list(given.warnings)}
        self._recordings.write((",\n" if self._recordings.tell() else "\n") + encoded({**about, **more}))
        self._out.pause()

    def end(self) -> None:
        self._out.write('\n], "recordings": [')
        self._recordings.seek(0)
        for piece in iter(partial(self._recordings.read, _MEGABYTE), ""):
            self._out.write(piece)
        self._out.write("\n]}\n")
        self._out.flush()


class _CsvPrinter(_TextPrinter):
    """Prints a line with the names of the columns, then one for each row, with the recording in front."""

    def _heading(self, kind: type[Any]) -> str:
        from carla_recap.output.csv import heading

        line: str = heading(kind.row_type, "recording")
        return line

    def _write(self, lines: str) -> None:
        self._out.write(lines)


class _TablePrinter:
    """Prints tables of some rows each, tables of the errors between them, and a line with the numbers of all."""

    def __init__(self, bar: SourcesBar) -> None:
        from rich.console import Console

        self._console = Console()
        self._bar = bar
        self._page: list[tuple[str, ...]] = []
        self._errors: list[tuple[str, ...]] = []
        self._row_type: type[Any] | None = None
        self._due = 0.0
        self._rows = self._recordings = self._failed = 0

    def add(self, given: RecordingAnswer) -> None:
        for piece in given.pieces:
            self._row_type = given.kind.row_type if given.kind else None
            self._add(self._page, tuple(piece))
        if given.error is not None:
            self._failed += 1
            location = given.source.location
            self._add(self._errors, (location, given.error.removeprefix(f"{location}: ")))
        self._rows += given.rows
        self._recordings += 1
        if (self._page or self._errors) and monotonic() > self._due:
            self._print_page()

    def end(self) -> None:
        self._print_page()
        failed = f", {self._failed} failed" if self._failed else ""
        line = f"{counted(self._rows, 'row')}; {counted(self._recordings, 'recording')}{failed}"
        self._console.print(line, highlight=False)

    def _add(self, rows: list[tuple[str, ...]], row: tuple[str, ...]) -> None:
        if not self._page and not self._errors:
            self._due = monotonic() + _INTERVAL
        rows.append(row)
        if len(rows) == _PAGE:
            self._print_page()

    def _print_page(self) -> None:
        from carla_recap.output.table import print_rows
        from carla_recap.output.terminal import TableColumn

        recording = TableColumn("Recording", narrowed="middle")
        with self._bar.aside():
            if self._page:
                print_rows(self._console, self._row_type, self._page, recording)
            if self._errors:
                print_rows(self._console, None, self._errors, recording, TableColumn("Error", narrowed="words"))
        self._page, self._errors = [], []


class _Output:
    """Stdout, written to in large pieces; what waits is written after a while."""

    def __init__(self, bar: SourcesBar) -> None:
        self._bar = bar
        self._pieces: list[str] = []
        self._size = 0
        self._due = 0.0

    def write(self, piece: str) -> None:
        self._pieces.append(piece)
        self._size += len(piece)
        if self._size > _MEGABYTE:
            self.flush()

    def pause(self) -> None:
        """Write what waits if nothing was written for a while."""
        if self._pieces and monotonic() > self._due:
            self.flush()

    def flush(self) -> None:
        with self._bar.aside():
            print_pieces(self._pieces)
        self._pieces, self._size = [], 0
        self._due = monotonic() + _INTERVAL


_PRINTERS: Final[dict[str, Callable[[SourcesBar], Any]]] = {
    "text": _TextPrinter,
    "json": _JsonPrinter,
    "csv": _CsvPrinter,
    "table": _TablePrinter,
}
