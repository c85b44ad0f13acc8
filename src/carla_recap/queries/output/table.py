"""Answers as tables for a terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from carla_recap.model.records import NO_ACTOR
from carla_recap.queries.actors import Actor
from carla_recap.queries.blocked import BlockedRow
from carla_recap.queries.collisions import CollisionRow
from carla_recap.queries.incidents import Incident
from carla_recap.queries.info import Info, InfoRow
from carla_recap.queries.measures.rows import MeasureRow
from carla_recap.queries.output.text import local_date
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rich.console import Console

    from carla_recap.queries.output.text import AnyAnswer


@dataclass(frozen=True)
class _Column:
    heading: str
    cell: Callable[[Any], str]
    width: int | None = None  # of a table that is printed in pages
    is_number: bool = False
    least: int | None = None  # width


def table(answer: AnyAnswer, console: Console | None = None) -> None:
    """Print an answer as a table; characters that could control the terminal are shown as escape sequences.

    Args:
        answer: The answer.
        console: The console to print to; None for the standard output.
    """
    from rich.console import Console
    from rich.text import Text

    console = console or Console()
    header = answer.header
    console.print(Text(f"{visible(header.map_name)}, {local_date(header.date)}, version {header.version}"))
    count = 0
    rows = iter(answer)
    while page := list(islice(rows, _PAGE if isinstance(answer, Info) else None)):
        _print_page(console, _COLUMNS[answer.row_type], page, headed=not count)
        count += len(page)
    extent = answer.extent
    things = "row" if count == 1 else "rows"
    console.print(Text(f"{count} {things}; {extent.frames} frames, {number(extent.duration)} seconds"))


_PAGE: Final = 500


def cells(answer: AnyAnswer) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each row of an answer."""
    columns = _COLUMNS[answer.row_type]
    return (tuple(column.cell(row) for column in columns) for row in answer)


def print_rows(console: Console, row_type: type | None, rows: Sequence[Sequence[str]], *first: str) -> None:
    """Print a table of the rows of several answers, whose cells are known.

    Args:
        console: The console to print to.
        row_type: The class of the rows; None if there are no cells of rows.
        rows: The cells of each row: those of further columns at the left, then those of `cells`.
        first: The headings of the columns at the left.
    """
    columns = [*(_Column(heading, str, least=len(heading)) for heading in first), *(_COLUMNS[row_type] if row_type else ())]
    _print_cells(console, columns, rows, headed=True)


def _print_page(console: Console, columns: Sequence[_Column], rows: list[Any], *, headed: bool) -> None:
    _print_cells(console, columns, ([column.cell(row) for column in columns] for row in rows), headed=headed)


def _print_cells(console: Console, columns: Iterable[_Column], rows: Iterable[Iterable[str]], *, headed: bool) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    page = Table(box=box.SIMPLE_HEAD, show_edge=False, show_header=headed)
    for column in columns:
        justify: Any = "right" if column.is_number else "left"
        page.add_column(column.heading, justify=justify, width=column.width, min_width=column.least, overflow="fold")
    for row in rows:
        page.add_row(*(Text(visible(cell)) for cell in row))
    console.print(page)


def _seconds(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 1e9 else number(value)


def _speed(value: float) -> str:
    return "" if math.isnan(value) else _seconds(value)


def _actor(id: int, type_id: str, hero: bool = False) -> str:
    name = type_id or ("no actor" if id == NO_ACTOR else "unknown")
    return f"{name} (hero)" if hero else name


def _details(record: dict[str, Any]) -> str:
    return " ".join(f"{name}={_brief(value)}" for name, value in record.items())


def _brief(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return f"{value['key']}={value['value']}" if "key" in value else _details(value)
    return f"[{', '.join(map(_brief, value))}]" if isinstance(value, list) else str(value)


_COLUMNS: Final[dict[type, tuple[_Column, ...]]] = {
    InfoRow: (
        _Column("Time", lambda row: _seconds(row.elapsed), 10, is_number=True),
        _Column("Frame", lambda row: str(row.frame), 8, is_number=True),
        _Column("Record", lambda row: row.type, 16),
        _Column("Details", lambda row: _details(row.record)),
    ),
    CollisionRow: (
        _Column("Time", lambda row: _seconds(row.elapsed), is_number=True),
        _Column("Frame", lambda row: str(row.frame), is_number=True),
        _Column("Id", lambda row: str(row.id1), is_number=True),
        _Column("Actor 1", lambda row: _actor(row.id1, row.type_id1, row.hero1)),
        _Column("Id", lambda row: str(row.id2), is_number=True),
        _Column("Actor 2", lambda row: _actor(row.id2, row.type_id2, row.hero2)),
        _Column("Impact m/s", lambda row: _speed(row.impact_speed), is_number=True),
        _Column("Relative m/s", lambda row: _speed(row.relative_speed), is_number=True),
    ),
    Actor: (
        _Column("Id", lambda row: str(row.id), is_number=True),
        _Column("Kind", lambda row: row.kind),
        _Column("Actor", lambda row: row.type_id),
        _Column("Role", lambda row: row.role_name),
        _Column("From", lambda row: _seconds(row.spawned_at), is_number=True),
        _Column("To", lambda row: "" if row.destroyed_at is None else _seconds(row.destroyed_at), is_number=True),
        _Column("Parent", lambda row: "" if row.parent is None else str(row.parent), is_number=True),
    ),
    BlockedRow: (
        _Column("Start", lambda row: _seconds(row.start), is_number=True),
        _Column("Duration", lambda row: _seconds(row.duration), is_number=True),
        _Column("Id", lambda row: str(row.id), is_number=True),
        _Column("Actor", lambda row: _actor(row.id, row.type_id)),
        _Column("Place (cm)", lambda row: ", ".join(map(number, (row.x, row.y, row.z)))),
    ),
    MeasureRow: (
        _Column("Id", lambda row: str(row.actor), is_number=True),
        _Column("Actor", lambda row: _actor(row.actor, row.type_id, row.hero)),
        _Column("Measure", lambda row: row.measure.replace("_", " ")),
        _Column("Value", lambda row: f"{row.value:.3f}", is_number=True),
        _Column("Unit", lambda row: row.unit),
        _Column("Time", lambda row: _seconds(row.time), is_number=True),
        _Column("Other", lambda row: "" if row.other is None else f"{row.other_type_id} ({row.other})"),
    ),
    Incident: (
        _Column("Start", lambda row: _seconds(row.start), is_number=True),
        _Column("Stop", lambda row: _seconds(row.stop), is_number=True),
        _Column("Incident", lambda row: row.kind),
        _Column("What happens", lambda row: row.text),
        _Column("Place (m)", lambda row: ", ".join(f"{number:.1f}" for number in (row.x, row.y, row.z))),
    ),
}
