"""Answers as CSV, for spreadsheets and pandas."""

from __future__ import annotations

import math
from csv import writer
from io import StringIO
from typing import TYPE_CHECKING, Any

from carla_recap.tables import column_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.output.text import AnyAnswer


def csv(answer: AnyAnswer) -> Iterator[str]:
    """Yield an answer as CSV, in pieces: names of fields, then a line for each row; empty where unknown or not finite."""
    yield heading(answer.row_type)
    yield from rows(answer)


def heading(row_type: type[Any], *more: str) -> str:
    """Return the line of names, with more of them in front."""
    return line([*more, *column_names(row_type)])


def rows(answer: AnyAnswer, *more: str) -> Iterator[str]:
    """Yield the line of each row, with more cells in front."""
    names = column_names(answer.row_type)
    for row in answer:
        yield line([*more, *(_cell(getattr(row, name)) for name in names)])


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and not math.isfinite(value)) else value


def line(cells: Iterable[Any]) -> str:
    """Return a line of cells."""
    text = StringIO()
    writer(text, lineterminator="\r\n").writerow(cells)  # so that a lone carriage return is quoted, too
    return text.getvalue().removesuffix("\r\n") + "\n"
