"""Tables for people, at a prompt and in a notebook: the first and the last rows, with rounded numbers."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

ENDS: Final = 5
"""The number of rows that are shown at the beginning, and at the end, of a longer table."""

_WIDTH: Final = 120  # characters of a line of text
_CELL: Final = 40  # characters of a cell
_DECIMALS: Final = 3
_LONGEST_NUMBER: Final = 1e15  # a greater one is written with an exponent

_STYLE: Final = "text-align: {}; white-space: nowrap"


class Preview(NamedTuple):
    """What is shown of a table."""

    name: str  # what it is a table of
    columns: Mapping[str, Sequence[Any]]  # the columns of the rows that are shown, by name
    units: Mapping[str, str]  # the units of columns
    length: int  # the number of rows of the whole table


def first_and_last(values: Any) -> Any:
    """Return the first and the last values of a column; all of a short one."""
    if len(values) <= 2 * ENDS:
        return values
    ends = (values[:ENDS], values[-ENDS:])
    return np.concatenate(ends) if isinstance(values, np.ndarray) else [*ends[0], *ends[1]]


def as_text(preview: Preview) -> str:
    """Return a table as lines of at most 120 characters; columns without room are named below it."""
    columns = {name: _cells(values) for name, values in _headed(preview).items()}
    shown: list[tuple[str, list[str]]] = []
    width = 0
    for name, (cells, at_right) in columns.items():
        size = max(map(len, (name, *cells)))
        if width + size > _WIDTH:
            break
        shown.append((name, [cell.rjust(size) if at_right else cell.ljust(size) for cell in (name, *cells)]))
        width += size + 2
    lines = [f"{preview.name}: {_rows(preview.length)}"]
    if preview.length:
        lines += ["  ".join(cells).rstrip() for cells in zip(*(cells for _, cells in shown), strict=True)]
        if preview.length > 2 * ENDS:
            lines.insert(2 + ENDS, "…")
        left_out = list(columns)[len(shown) :]
        if left_out:
            lines.append(f"and the columns {', '.join(left_out)}")
    return "\n".join(lines)


def as_html(preview: Preview) -> str:
    """Return a table as HTML."""
    columns = {name: _cells(values) for name, values in _headed(preview).items()}
    heads = "".join(f"<th>{escape(name)}</th>" for name in columns)
    sides = ["right" if at_right else "left" for _, at_right in columns.values()]
    rows = [
        "".join(f'<td style="{_STYLE.format(side)}">{escape(cell)}</td>' for cell, side in zip(cells, sides, strict=True))
        for cells in zip(*(cells for cells, _ in columns.values()), strict=True)
    ]
    if preview.length > 2 * ENDS:
        rows.insert(ENDS, f'<td colspan="{len(columns)}" style="text-align: center">…</td>')
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>" if rows else ""
    return f"{table}<p>{escape(preview.name)}: {_rows(preview.length)}</p>"


def cell(value: Any) -> str:
    """Return a value for people: a number with at most three decimals, a text without control characters."""
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, tuple | list):
        value = ", ".join(map(cell, value))
    text = "" if value is None else visible(str(value))
    return text if len(text) <= _CELL else f"{text[: _CELL - 1]}…"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return str(value)
    if value and (abs(value) < 10**-_DECIMALS or abs(value) >= _LONGEST_NUMBER):
        return f"{value:.3g}"
    return f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")


def _headed(preview: Preview) -> dict[str, Sequence[Any]]:
    """Return the columns by their headings, which name the units."""
    return {
        f"{name} ({preview.units[name]})" if preview.units.get(name) else name: values
        for name, values in preview.columns.items()
    }


def _cells(values: Sequence[Any]) -> tuple[list[str], bool]:
    """Return the cells of a column, and whether they are numbers, which are at the right."""
    numbers = all(isinstance(value, int | float | np.number) and not isinstance(value, bool) for value in values)
    return [cell(value) for value in values], numbers


def _rows(count: int) -> str:
    return f"{count:,} row{'s' if count != 1 else ''}"
