"""One query of many recordings: the answers as they are printed, one after another."""

from __future__ import annotations

import warnings
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

from carla_recap.errors import NotSetUp
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.outcomes import one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from typing import Unpack

    from carla_recap.fleet.engine import Processes
    from carla_recap.fleet.sources import SourceFile
    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Extent, Header

    Query = Callable[[Reader], Any]
    Form = Literal["text", "json", "csv", "table"]
    Piece = str | tuple[str, ...]

_MOST: Final = 1 << 20  # characters of records, which info reads as it prints them, that a worker process returns


@dataclass(slots=True)
class RecordingAnswer:
    """The answer for one of many recordings."""

    source: SourceFile
    # for each row, the cells of a table, a JSON object or a line of CSV; or lines of text: what is below is known after them
    pieces: Iterable[Piece] = ()
    kind: type[Any] | None = None  # the class of the answer; None if the recording cannot be read
    header: Header | None = None  # None if it cannot be read
    extent: Extent | None = None  # None after an error
    rows: int = 0  # the number of pieces
    error: str | None = None  # the error, in one line; None if there was none
    warnings: tuple[str, ...] = ()  # a line each


def answers(
    query: Query, form: Form, sources: Iterable[SourceFile], **processes: Unpack[Processes]
) -> Generator[RecordingAnswer]:
    """Yield the answers to a query for many recordings, in their order, as soon as they are known.

    The query is a function of a module, or a partial of one. See `map_sources`, too.
    """
    function = partial(_answer, query, form)
    for outcome in map_sources(function, sources, **processes):
        answer = outcome.value
        if answer is None:
            yield RecordingAnswer(outcome.source, error=outcome.error, warnings=outcome.warnings)
        elif answer.pieces is None:
            answer = RecordingAnswer(outcome.source)
            answer.pieces = _warned(_pieces(answer, query, form), answer)
            yield answer
        else:
            answer.warnings = outcome.warnings
            yield answer


def _answer(query: Query, form: Form, source: SourceFile) -> RecordingAnswer:
    """Return the answer for a recording, with a list of pieces; None instead of that if it is long, and not in memory."""
    answer = RecordingAnswer(source)
    pieces: list[Piece] = []
    size = 0
    for piece in _pieces(answer, query, form):
        pieces.append(piece)
        size += len(piece) if isinstance(piece, str) else sum(map(len, piece))
        if size > _MOST and answer.kind and not issubclass(answer.kind, list):
            return RecordingAnswer(source, pieces=None)  # type: ignore[arg-type]
    answer.pieces = pieces
    return answer


def _warned(pieces: Iterator[Piece], answer: RecordingAnswer) -> Iterator[Piece]:
    """Yield pieces, and add the warnings that come with them to the answer."""
    piece: Piece | None = ""
    while piece is not None:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            piece = next(pieces, None)
        answer.warnings += tuple(answer.source.as_given(str(warning.message)) for warning in caught)
        if piece is not None:
            yield piece


def _pieces(answer: RecordingAnswer, query: Query, form: Form) -> Iterator[Piece]:
    """Yield the pieces of the answer for a recording, and set its other attributes."""
    from carla_recap.formats import open_reader

    location = answer.source.location
    try:
        with closing(open_reader(answer.source.address)) as reader:
            answer.header = reader.header
            found = query(reader)
            answer.kind = type(found)
            for piece in _rendered(found, form, location):
                answer.rows += 1
                yield piece
            answer.extent = found.extent
    except NotSetUp:
        raise
    except Exception as error:  # the other recordings are answered
        answer.error = one_line(error, answer.source)


def _rendered(found: Any, form: Form, location: str) -> Iterator[Piece]:
    if form == "json":
        from carla_recap.output.json import rows

        return rows(found, recording=location)
    if form == "csv":
        from carla_recap.output import csv

        return csv.rows(found, location)
    if form == "table":
        from carla_recap.output.table import cells

        return ((location, *row) for row in cells(found))
    from carla_recap.output.text import lines

    return (_with_name(text, location) for text in lines(found) if text)


def _with_name(text: str, location: str) -> str:
    """Return lines of text with a recording's name and a tab in front of each; empty lines are left out."""
    name = location.translate(_ESCAPES)
    return "".join(f"{name}\t{line}\n" for line in text.split("\n") if line)


_ESCAPES: Final = str.maketrans({"\n": r"\n", "\r": r"\r", "\t": r"\t"})
