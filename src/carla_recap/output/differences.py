"""Differences of two recordings as text, as JSON and as tables for a terminal."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

from carla_recap.model.lives import HERO
from carla_recap.output.json import array_of, encoded, rows
from carla_recap.output.table import most_important_first
from carla_recap.output.terminal import TableColumn, name_column, number_column, print_table
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rich.console import Console

    from carla_recap.queries.differences import ActorDifference, ComparedRecording, Differences, LightDifference


def text(found: Differences) -> Iterator[str]:
    """Yield differences as text, in pieces: a summary, the recordings, and what differs."""
    yield from (f"{visible(line)}\n" for line in _summary(found))
    for title, columns, listed in _listings(found):
        yield f"\n{title}\n"
        every = [(column, [visible(column.cell(row)) for row in listed]) for column in columns]
        aligned = []
        for column, cells in every:
            if any(cells):
                width = max(map(len, (column.heading, *cells)))
                align = str.rjust if column.is_number else str.ljust
                aligned.append([align(cell, width) for cell in (column.heading, *cells)])
        yield from (f"  {'  '.join(row)}".rstrip() + "\n" for row in zip(*aligned, strict=True))


def table(found: Differences, console: Console | None = None) -> None:
    """Print differences as tables, to the standard output unless a console is given."""
    from rich.console import Console
    from rich.text import Text

    console = console or Console()
    for number, line in enumerate(_summary(found)):
        style = ("bold green" if found.equal else "bold red") if not number else ""
        console.print(Text(visible(line), style))
    for title, columns, listed in _listings(found):
        console.print()
        console.print(Text(title, "bold"))
        print_table(columns, [[column.cell(row) for column in columns] for row in listed], console)


def json(found: Differences) -> Iterator[str]:
    """Yield differences as one JSON object, in pieces; numbers that are not finite become null.

    Its `actors` and `lights` are all that are in both recordings, also those that do not differ.
    """
    first = found.first
    head = {
        "equal": found.equal,
        "summary": found.summary,
        "reasons": found.reasons,
        "tolerance": found.tolerance,
        "time_tolerance": found.time_tolerance,
        "clock": found.clock,
        "a": asdict(found.a),
        "b": asdict(found.b),
        "first": None if first is None else asdict(first),
    }
    yield encoded(head)[:-1]
    for name in ("actors", "missing", "extra", "lights", "events"):
        yield f', "{name}": '
        yield from array_of(rows(getattr(found, name)))
    yield "}\n"


def _summary(found: Differences) -> Iterator[str]:
    yield from found.reasons or [found.summary]
    yield _recording("A", found.a)
    yield _recording("B", found.b)


def _recording(letter: str, recording: ComparedRecording) -> str:
    every = "" if math.isnan(recording.step) else f", every {recording.step:.4g} s"
    name = recording.map_name or "no map name"
    return f"{letter}: {recording.location}: {name}, {recording.frames} frames in {recording.duration:.2f} s{every}"


def _listings(found: Differences) -> Iterator[tuple[str, Sequence[TableColumn], Sequence[Any]]]:
    """Yield the lists of what differs, none of them empty: a title, the columns, and the rows."""
    listings: tuple[tuple[str, Sequence[TableColumn], Sequence[Any]], ...] = (
        ("Actors that differ, in m, s and degrees", _ACTORS, [row for row in found.actors if row.differs]),
        ("Actors only in A", _UNMATCHED, most_important_first(found.missing)),
        ("Actors only in B", _UNMATCHED, most_important_first(found.extra)),
        ("Traffic lights that differ, in m and s", _LIGHTS, [row for row in found.lights if row.differs]),
        ("Events that differ, in s", _EVENTS, found.events),
    )
    return (listing for listing in listings if listing[2])


def _seconds(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{value:.2f}"


def _metres(value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    if math.isinf(value):
        return "unknown"
    if value and value < 0.001:
        return f"{value:.1g}"
    return f"{value:.1f}" if value >= 100 else f"{value:.3f}"


def _degrees(value: float) -> str:
    return "" if not value else f"{value:.1f}" if value >= 0.1 else f"{value:.1g}"


def _ids(row: ActorDifference | LightDifference) -> str:
    return str(row.id_a) if row.id_a == row.id_b else f"{row.id_a}, {row.id_b}"


def _actor(row: ActorDifference) -> str:
    name = " or ".join(dict.fromkeys((row.type_id_a or "unknown", row.type_id_b or "unknown")))
    return f"{name} (hero)" if row.role_name == HERO else name


def _life(start: float, stop: float | None) -> str:
    return "" if math.isnan(start) else f"{_seconds(start)}-{_seconds(stop) or 'end'}"


def _lives(row: ActorDifference) -> str:
    a, b = _life(row.spawned_at_a, row.destroyed_at_a), _life(row.spawned_at_b, row.destroyed_at_b)
    return "" if a == b else f"{a}, {b}"


_ACTORS: Final = (
    number_column("Id", _ids),
    name_column("Actor", _actor),
    number_column("From", lambda row: _seconds(row.first)),
    number_column("By", lambda row: _metres(row.first_distance)),
    number_column("Mean", lambda row: _metres(row.mean)),
    number_column("Max", lambda row: _metres(row.max)),
    number_column("At", lambda row: _seconds(row.max_at) if row.max else ""),
    number_column("Final", lambda row: _metres(row.final)),
    number_column("Heading", lambda row: _degrees(row.heading), rank=2),
    TableColumn("Exists", _lives, rank=1),
)
_UNMATCHED: Final = (
    number_column("Id", lambda actor: str(actor.id)),
    TableColumn("Kind", lambda actor: actor.kind),
    name_column("Actor", lambda actor: actor.type_id or "unknown"),
    TableColumn("Role", lambda actor: actor.role_name),
    TableColumn("Exists", lambda actor: _life(actor.spawned_at, actor.destroyed_at)),
)
_LIGHTS: Final = (
    number_column("Id", _ids),
    TableColumn("Place", lambda row: f"{row.x:.1f}, {row.y:.1f}"),
    number_column("From", lambda row: _seconds(row.first)),
    number_column("For", lambda row: _seconds(row.seconds)),
)
_EVENTS: Final = (
    number_column("A", lambda row: _seconds(row.start_a)),
    number_column("B", lambda row: _seconds(row.start_b)),
    TableColumn("Event", lambda row: row.kind),
    TableColumn("What happens", lambda row: row.text, narrowed="words"),
)
