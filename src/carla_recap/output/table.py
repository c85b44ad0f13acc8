"""Answers as tables for a terminal."""

from __future__ import annotations

import math
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from carla_recap.model.lives import STATIC_OBJECT, ActorLife
from carla_recap.model.records import NO_ACTOR
from carla_recap.output.terminal import (
    INCIDENT_STYLES,
    TableColumn,
    actor_style,
    brief_actor,
    name_column,
    number_column,
    print_table,
)
from carla_recap.output.text import incident_counts, local_date, top_speed
from carla_recap.queries.blocked import Blocked, BlockedRow
from carla_recap.queries.collisions import CollisionRow, Collisions
from carla_recap.queries.incidents import Incident
from carla_recap.queries.info import InfoRow
from carla_recap.queries.measures.definitions import MeasureRow
from carla_recap.queries.measures.series import MeasureMoment
from carla_recap.queries.recorded_actors import RecordedActors
from carla_recap.queries.summary import RecordingSummary
from carla_recap.util.text import number, readable, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rich.console import Console

    from carla_recap.output.text import AnyAnswer


def table(answer: AnyAnswer, console: Console | None = None) -> None:
    """Print an answer as a table; characters that could control the terminal are shown as escape sequences."""
    from rich.console import Console
    from rich.text import Text

    console = console or Console()
    header = answer.header
    console.print(Text(f"{visible(header.map_name)}, {local_date(header.date)}, version {header.version}"))
    count = 0
    rows = iter(in_order(answer))
    while page := list(islice(rows, None if isinstance(answer, list) else _PAGE)):
        columns = _COLUMNS[answer.row_type]
        cells = [[column.cell(row) for column in columns] for row in page]
        print_table(columns, cells, console, headed=not count)
        count += len(page)
    extent = answer.extent
    things = "row" if count == 1 else "rows"
    if isinstance(answer, Collisions) and answer.contacts < count:
        things += f" of {answer.contacts} contact{'s' if answer.contacts > 1 else ''}"
    console.print(Text(f"{count} {things}; {extent.frames} frames, {number(extent.duration)} seconds"))


_PAGE: Final = 500


def in_order(answer: AnyAnswer) -> Iterable[Any]:
    """Return the rows of an answer as tables have them."""
    if isinstance(answer, Blocked):
        return sorted(answer, key=lambda row: _KINDS.get(row.type_id.partition(".")[0], len(_KINDS)))
    return most_important_first(answer) if isinstance(answer, RecordedActors) else answer


def most_important_first(actors: Iterable[ActorLife]) -> list[ActorLife]:
    """Return actors in the order of tables: heroes, vehicles and walkers before what never moves."""
    return sorted(actors, key=lambda actor: (not actor.is_hero, _KINDS.get(actor.kind, len(_KINDS)), actor.id))


def cells(answer: AnyAnswer) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each row of an answer."""
    columns = _COLUMNS[answer.row_type]
    return (tuple(column.cell(row) for column in columns) for row in in_order(answer))


def print_rows(console: Console, row_type: type | None, rows: Sequence[Sequence[str]], *first: TableColumn) -> None:
    """Print a table of the rows of several answers: the cells of the `first` columns, then those of `cells`, if any."""
    columns = [*first, *_COLUMNS[row_type]] if row_type else first
    print_table(columns, rows, console)


def _known(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else ""


def _seconds(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 1e9 else number(value)


def _speed(value: float) -> str:
    return "" if math.isnan(value) else _seconds(value)


def _place(place: tuple[float, ...]) -> str:
    return "" if math.isnan(place[0]) else ", ".join(f"{number:.1f}" for number in place)


def _id(id: int | None) -> str:
    return "" if id is None or id == NO_ACTOR else str(id)


def _actor(id: int, type_id: str, hero: bool = False) -> str:
    name = type_id or (STATIC_OBJECT if id == NO_ACTOR else "unknown")
    return f"{name} (hero)" if hero else name


def _details(record: dict[str, Any]) -> str:
    return " ".join(f"{name}={_brief(value)}" for name, value in record.items())


def _brief(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return f"{value['key']}={value['value']}" if "key" in value else _details(value)
    return f"[{', '.join(map(_brief, value))}]" if isinstance(value, list) else str(value)


_KINDS: Final = {"vehicle": 0, "walker": 1, "traffic_light": 2, "sensor": 3, "traffic_sign": 4, "other": 5}
"""The ranks of kinds of actors in the order of tables."""


_COLUMNS: Final[dict[type, tuple[TableColumn, ...]]] = {
    InfoRow: (
        number_column("Time (s)", lambda row: _seconds(row.elapsed), least=8),
        number_column("Frame", lambda row: str(row.frame), least=8, rank=-1),
        TableColumn("Record", lambda row: row.type, least=16),
        TableColumn("Details", lambda row: _details(row.record), narrowed="words", least=16),
    ),
    CollisionRow: (
        number_column("Time (s)", lambda row: _seconds(row.elapsed)),
        number_column("Frame", lambda row: str(row.frame), rank=2),
        number_column("Id", lambda row: _id(row.id1)),
        name_column("Actor 1", lambda row: _actor(row.id1, row.type_id1, row.hero1)),
        number_column("Id", lambda row: _id(row.id2)),
        name_column("Actor 2", lambda row: _actor(row.id2, row.type_id2, row.hero2)),
        number_column("Contact", lambda row: str(row.contact), rank=3),
        number_column("Impact (m/s)", lambda row: _speed(row.impact_speed), rank=-1),
        number_column("Relative (m/s)", lambda row: _speed(row.relative_speed), rank=1),
    ),
    ActorLife: (
        number_column("Id", lambda row: str(row.id)),
        TableColumn("Kind", lambda row: row.kind, style=actor_style),
        name_column("Actor", lambda row: row.type_id),
        TableColumn("Role", lambda row: row.role_name, narrowed="middle", rank=-3),
        number_column("From (s)", lambda row: _seconds(row.spawned_at), rank=-2),
        number_column("To (s)", lambda row: "" if row.destroyed_at is None else _seconds(row.destroyed_at), rank=-1),
        number_column("Parent", lambda row: "" if row.parent is None else str(row.parent), rank=1),
    ),
    BlockedRow: (
        number_column("Start (s)", lambda row: _seconds(row.start), rank=-1),
        number_column("Duration (s)", lambda row: _seconds(row.duration)),
        number_column("Id", lambda row: str(row.id)),
        name_column("Actor", lambda row: _actor(row.id, row.type_id)),
        TableColumn("Place (cm)", lambda row: ", ".join(map(number, (row.x, row.y, row.z))), rank=1),
    ),
    MeasureRow: (
        number_column("Id", lambda row: str(row.actor)),
        name_column("Actor", lambda row: _actor(row.actor, row.type_id, row.hero), rank=4),
        TableColumn("Measure", lambda row: row.measure.replace("_", " "), narrowed="words"),
        number_column("Value", lambda row: f"{row.value:.3f}"),
        TableColumn("Unit", lambda row: row.unit, rank=2),
        number_column("Time (s)", lambda row: _seconds(row.time)),
        number_column("Id", lambda row: "" if row.other is None else str(row.other), rank=1),
        name_column("Other", lambda row: "" if row.other is None else row.other_type_id, rank=3),
    ),
    MeasureMoment: (
        number_column("Time (s)", lambda row: _seconds(row.time), least=8),
        number_column("Id", lambda row: str(row.actor), least=6),
        number_column("Speed (m/s)", lambda row: _known(row.speed), least=11),
        number_column("Acceleration (m/s²)", lambda row: _known(row.acceleration), least=11, rank=3),
        number_column("Gap (m)", lambda row: _known(row.gap), least=7),
        number_column("To", lambda row: _id(row.nearest), least=5, rank=1),
        number_column("TTC (s)", lambda row: _known(row.time_to_collision), least=7),
        number_column("With", lambda row: _id(row.threat), least=5, rank=1),
        number_column("Headway (m)", lambda row: _known(row.distance_headway), least=11),
        number_column("Headway (s)", lambda row: _known(row.time_headway), least=11, rank=2),
        number_column("Leader", lambda row: _id(row.leader), least=6, rank=1),
    ),
    RecordingSummary: (
        TableColumn("Map", lambda row: readable(row.map), narrowed="middle", rank=3),
        number_column("Duration (s)", lambda row: _seconds(row.duration)),
        number_column("Frames", lambda row: str(row.frames), rank=4),
        number_column("Vehicles", lambda row: str(row.actors.get("vehicle", 0)), rank=1),
        number_column("Walkers", lambda row: str(row.actors.get("walker", 0)), rank=2),
        number_column("Hero (m)", lambda row: f"{row.hero.distance:.0f}" if row.hero else ""),
        number_column("Top speed (km/h)", lambda row: top_speed(row.hero) if row.hero else "", rank=1),
        TableColumn("Incidents", lambda row: incident_counts(row.incidents), narrowed="end"),
    ),
    Incident: (
        number_column("Start (s)", lambda row: _seconds(row.start)),
        number_column("Stop (s)", lambda row: _seconds(row.stop), rank=2),
        TableColumn("Incident", lambda row: row.kind, style=lambda kind: INCIDENT_STYLES.get(kind, "")),
        TableColumn("What happens", lambda row: row.text, narrowed="words", brief=brief_actor),
        number_column("Value", lambda row: "" if math.isnan(row.value) else f"{row.value:.2f} {row.unit}", rank=3),
        TableColumn("Place (m)", lambda row: _place((row.x, row.y, row.z)), rank=1),
    ),
}
