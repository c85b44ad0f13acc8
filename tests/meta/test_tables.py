"""The tables of the documentation have the rows of the tables in the code."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any, NamedTuple

import pytest

from carla_recap.exports import FORMATS
from carla_recap.fleet.index.tables import RECORDING, TABLES
from carla_recap.model.records import UE4, Group
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import MEASURES
from carla_recap.rules.reading import Key, keys_of
from carla_recap.rules.table import CONDITIONS, PLACE_KEYS, SCOPE
from carla_recap.sensors import SENSOR_TYPES
from tests.samples import ROOT

SQL_TYPES = {
    "string": "varchar",
    "int64": "bigint",
    "bool": "boolean",
    "timestamp[us]": "timestamp",
    "list<item: int64>": "bigint[]",
    "list<item: string>": "varchar[]",
}


class Table(NamedTuple):
    """A table: its page, a heading before it, its first row, the first cells of its rows, and how many others follow."""

    page: str
    heading: str
    head: str
    rows: Callable[[], Iterable[tuple[str, ...]]]
    others: int = 0


def grouped(pairs: Iterable[tuple[Any, str]]) -> Iterable[tuple[Any, str]]:
    """Yield each first value once, with the second ones that it has, in their order."""
    found: dict[Any, dict[str, None]] = defaultdict(dict)
    for first, second in pairs:
        found[first][second] = None
    return ((first, ", ".join(seconds)) for first, seconds in found.items())


def kinds() -> Iterable[tuple[str, ...]]:
    for kind in KINDS.values():
        (unit,) = {measure.unit for measure in kind.measures}
        yield f"`{kind.option}`", kind.text, " or ".join(f"`{measure.name}`" for measure in kind.measures), unit


def measures(*, of_roads: bool) -> Iterable[tuple[str, ...]]:
    for each in MEASURES.values():
        if each.needs_roads == of_roads:
            yield f"`{each.name}`", each.unit, each.extreme, each.text


def conditions() -> Iterable[tuple[str, ...]]:
    def shown(part: Any) -> list[str]:
        if isinstance(part, Key):
            return [f"`{part.name}`"]
        return [part.title] if part.title else [f"`{key.name}`" for key in part.keys]

    for (keys, text), names in grouped(
        ((", ".join(chain(*map(shown, kind.parts))), kind.text), f"`{kind.name}`") for kind in CONDITIONS.values()
    ):
        yield names, keys, text


def keys(parts: Iterable[Any]) -> Iterable[tuple[str, ...]]:
    for (name, text), types in grouped(((key.name, key.text), key.type.name) for key in keys_of(list(parts))):
        yield f"`{name}`", types, text


def attributes() -> Iterable[tuple[str, ...]]:
    """Yield all that are limited to a range; of the others, the page names the families."""
    for (key, text, values), families in grouped(
        ((key, attribute.text, attribute.values), type.kind)
        for type in SENSOR_TYPES.values()
        for key, attribute in type.attributes.items()
        if attribute.least >= -180 and type.kind != "map"
    ):
        yield f"`{key}`", families, text, values


def columns(table: Any) -> Iterable[tuple[str, ...]]:
    for field in table.schema:
        if table.name == "recordings" or field.name != RECORDING:
            kind = SQL_TYPES.get(str(field.type), str(field.type).partition("<")[0])
            yield f"`{field.name}`", kind, (field.metadata or {}).get(b"unit", b"").decode()


def sent_by_the_server() -> Iterable[tuple[str, ...]]:
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    from carla_recap.server.sensors import SENSOR_KINDS

    return ((f"`{name}`", kind.support, kind.what) for name, kind in SENSOR_KINDS.items())


def formats() -> Iterable[tuple[str, ...]]:
    for form in FORMATS.values():
        file, extra = f"`{form.suffix}`" if form.suffix else "folder", f"`{form.extra}`" if form.extra else ""
        yield f"`{form.name}`", file, form.text, extra


OF_RULES = [part for kind in CONDITIONS.values() for part in kind.parts if part not in (PLACE_KEYS, SCOPE)]
SHOWN = {
    "kinds of incidents": Table("incidents", "## What an incident is", "| kind | definition | measure | unit |", kinds),
    "measures": Table(
        "measures", "## Definitions", "| measure | unit | extreme | definition |", lambda: measures(of_roads=False)
    ),
    "measures of roads": Table(
        "measures", "## The road", "| measure | unit | extreme | definition |", lambda: measures(of_roads=True)
    ),
    "conditions": Table("ci", "## Rules", "| condition | keys | is met if |", conditions),
    "keys": Table("ci", "## Rules", "| key | value | |", lambda: keys(OF_RULES)),
    "places": Table("ci", "### Places", "| key | value | |", lambda: keys([PLACE_KEYS])),
    "scopes": Table("ci", "### Scopes", "| key | value | |", lambda: keys([SCOPE])),
    "topics": Table(
        "format",
        "## Topics",
        "| topic |",
        lambda: (
            (f"`{type.topic}`", f"`{type.message}`", f"{type.id}", "state" if type.group is Group.STATE else "events")
            for type in sorted(UE4, key=lambda type: type.id)
            if type.topic
        ),
        5,
    ),
    "types of sensors": Table(
        "sensors",
        "### Types",
        "| type |",
        lambda: ((f"`{name}`", type.kind, type.data) for name, type in SENSOR_TYPES.items()),
    ),
    "attributes of sensors": Table("sensors", "### Attributes", "| attribute |", attributes),
    "sensors of the server": Table("sensors", "## What each sensor sends", "| ", sent_by_the_server),
    "formats of exports": Table("exchange", "", "| format | file | content | extra |", formats),
    **{
        f"columns of {name}": Table("index-and-sql", f"### `{name}`", "| ", lambda table=table: columns(table))
        for name, table in TABLES.items()
    },
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_table_has_the_rows_of_the_code(name: str) -> None:
    table = SHOWN[name]
    text = (ROOT / "docs" / f"{table.page}.md").read_text("utf-8").partition(f"\n{table.heading}")[2]
    lines = f"{table.head}{text.partition(table.head)[2]}".partition("\n\n")[0].splitlines()
    found = [tuple(cell.strip() for cell in line.strip("|").split(" |")) for line in lines[2:]]
    expected = list(table.rows())
    assert expected
    assert [row[: len(expected[0])] for row in found[: len(found) - table.others]] == expected
