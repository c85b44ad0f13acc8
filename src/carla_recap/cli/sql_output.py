"""The rows that SQL returns, as a table, as JSON or as CSV."""

from __future__ import annotations

import csv
import io
import math
import sys
from datetime import date, datetime, time
from decimal import Decimal
from itertools import chain, islice
from json import JSONEncoder
from typing import TYPE_CHECKING, Any, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import pyarrow as pa
    from rich.table import Table

Form = Literal["table", "json", "csv"]

_PAGE: Final = 500  # rows of a table whose columns are as wide as needed for all of them
_BATCH: Final = 4096  # rows that are Python objects at a time
_LEAST: Final = 5  # characters of each column beside what it needs at least, with which a table is readable


def show_rows(rows: pa.Table, form: Form) -> None:
    """Print the rows of an answer on stdout.

    Args:
        rows: The rows.
        form: "table" for a terminal, "json" or "csv".
    """
    names = _different(rows.schema.names)
    batches = rows.to_batches(max_chunksize=_BATCH)
    values = chain.from_iterable(zip(*map(_values, batch.columns), strict=True) for batch in batches)
    if form == "table":
        _print_table(names, values)
        return
    for piece in _json(names, values) if form == "json" else _csv(names, values):
        sys.stdout.buffer.write(piece.encode("utf-8", "surrogateescape"))
    sys.stdout.buffer.flush()


def _values(column: pa.Array) -> list[Any]:
    import pyarrow as pa

    try:
        values: list[Any] = column.to_pylist()
    except OverflowError:
        raise RecapError("a date that is not between the years 1 and 9999 cannot be printed; cast it to varchar") from None
    return [value and dict(value) for value in values] if pa.types.is_map(column.type) else values


def _different(names: list[str]) -> list[str]:
    """Return names of columns with a number behind those that are repeated."""
    found: dict[str, None] = {}
    for name in names:
        unique, count = name, 0
        while unique in found:
            count += 1
            unique = f"{name}_{count}"
        found[unique] = None
    return list(found)


def _json(names: list[str], rows: Iterable[tuple[Any, ...]]) -> Iterator[str]:
    yield '{"rows": ['
    separator = "\n"
    for row in rows:
        yield separator + _ENCODER.encode(dict(zip(names, map(_plain, row), strict=True)))
        separator = ",\n"
    yield "\n]}\n"


def _csv(names: list[str], rows: Iterable[tuple[Any, ...]]) -> Iterator[str]:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in chain([tuple(names)], rows):
        writer.writerow([_text(value) for value in row])
        yield text.getvalue()
        text.seek(0)
        text.truncate()


def _print_table(names: list[str], rows: Iterator[tuple[Any, ...]]) -> None:
    """Print rows as a table; if it is too wide for the terminal, each row as a list of its values."""
    from rich.console import Console
    from rich.text import Text

    console = Console()
    count = 0
    while page := list(islice(rows, _PAGE)):
        table = _table_of(names, page, headed=not count)
        if len(names) > 1 and console.measure(table).minimum + _LEAST * len(names) > console.width:
            for row in page:
                console.print(_list_of(names, row))
        else:
            console.print(table)
        count += len(page)
    console.print(Text(f"{count} row{'' if count == 1 else 's'}"))


def _table_of(names: list[str], rows: list[tuple[Any, ...]], *, headed: bool) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, show_header=headed)
    for column, name in enumerate(names):
        is_number = all(row[column] is None or _is_number(row[column]) for row in rows)
        table.add_column(Text(visible(name)), justify="right" if is_number else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(visible(_shown(value))) for value in row))
    return table


def _list_of(names: list[str], row: tuple[Any, ...]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, value in zip(names, row, strict=True):
        table.add_row(Text(visible(name), style="bold"), Text(visible(_shown(value))))
    table.add_row()
    return table


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | Decimal) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    """Return a value as a table shows it: real numbers with six digits."""
    return number(value) if isinstance(value, float) else _text(value)


def _text(value: Any) -> str:
    value = _plain(value)
    if value is None:
        return ""
    return value if isinstance(value, str) else _ENCODER.encode(value)


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: times as text, numbers that are not finite as null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return [_plain(item) for item in value]
    if isinstance(value, datetime):
        return value.isoformat(" ")
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, str | int | None) else str(value)


_ENCODER: Final = JSONEncoder(ensure_ascii=False)
