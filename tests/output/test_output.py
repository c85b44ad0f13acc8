from __future__ import annotations

import io
import json as stdlib
import math
import re
from dataclasses import asdict
from typing import Any, NoReturn

import pytest
from rich.console import Console

from carla_recap.model.frame import Header
from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import NO_ACTOR, Attribute, Spawn, attributes
from carla_recap.output import differences
from carla_recap.output import table as table_output
from carla_recap.output.json import encoded
from carla_recap.output.json import json as json_text
from carla_recap.output.table import cells, table
from carla_recap.output.text import lines
from carla_recap.queries.blocked import blocked
from carla_recap.queries.collisions import collisions
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.info import info
from carla_recap.queries.summary import summary
from carla_recap.recording import open_recording
from tests.queries.conftest import Make

NAN = float("nan")
EVIL = "[red]\x1b[31m\x07\x9b5A\u202egnp.exe\r\n\u2028[/nothing]"


def spawn(id: int, type_id: str, *attributes: Attribute) -> Spawn:
    return Spawn(id, 1, NAN, 0, 0, 0, 0, 0, 0, type_id, list(attributes))


def strict(text: str) -> Any:
    """What JSON says, by the letter of its standard."""

    def refuse(constant: str) -> NoReturn:
        raise AssertionError(constant)

    return stdlib.loads(text, parse_constant=refuse)


def parsed(answer: Any) -> Any:
    return strict("".join(json_text(answer)))


def printed(answer: Any, width: int = 200) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    table(answer, console)
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


def test_json(make: Make) -> None:
    answer = collisions(make({"spawned": [spawn(1, "vehicle.été")]}, {"collisions": [(0, 1, NO_ACTOR, 1, 0)]}))
    assert parsed(answer) == {
        "version": 1,
        "map": "Town01",
        "date": 1_600_000_000,
        "rows": [asdict(row) | {"impact_speed": None, "relative_speed": None} for row in answer],
        "frames": 2,
        "last_frame": 2,
        "duration": 0.5,
    }
    assert len(answer) == 1


def test_what_is_not_finite_is_null(make: Make) -> None:
    reader = make({"spawned": [spawn(1, "a")], "transforms": [(1, 1, 1, 1, float("inf"), NAN, 1)]}, durations=[NAN])
    frame, born, pose = (row["record"] for row in parsed(info(reader, all=True))["rows"])
    assert frame == {"id": 1, "duration": None, "elapsed": 0.0}
    assert (born["x"], born["y"]) == (None, 0.0)
    assert list(pose.values()) == [1, 1.0, 1.0, 1.0, None, None, 1.0]


def test_what_is_not_finite_in_a_dataclass_is_null() -> None:
    box = BoundingBox(NAN, 0.0, 0.0, 1.0, float("inf"), 1.0)
    found = strict(encoded({"boxes": (box, [box])}))
    assert found == {"boxes": [nulled := {**asdict(box), "x": None, "extent_y": None}, [nulled]]}


def test_json_has_a_line_per_row(make: Make) -> None:
    pieces = list(json_text(info(make({"destroyed": [(1,), (2,)]}))))
    assert [piece.count("\n") for piece in pieces] == [0, 1, 1, 1, 1]


def test_json_of_texts_that_are_none(make: Make) -> None:
    reader = make({"spawned": [spawn(1, "a\udce9b\0c", Attribute(3, "k\udcff", "\x1b"))]}, header=Header("\udcff", 0))
    answer = parsed(info(reader))
    record = answer["rows"][0]["record"]
    assert (answer["map"], record["type_id"]) == ("?", "a?b")
    assert record["attributes"] == [{"type": 3, "key": "k?", "value": "\x1b"}]


def test_table_of_collisions(make: Make) -> None:
    before = {"spawned": [spawn(1, "vehicle.a")], "velocities": [(1, 3, 4, 0, 0, 0, 0)]}
    reader = make(before, {"collisions": [(0, 1, NO_ACTOR, 1, 0), (0, 1, 9, 0, 0)]})
    lines = [" ".join(line.split()) for line in printed(collisions(reader)).splitlines()]
    assert lines[0] == "Town01, 09/13/20 12:26:40, version 1"
    assert "Time (s) Frame Id Actor 1 Id Actor 2 Contact Impact (m/s) Relative (m/s)" in lines
    assert "0.50 2 1 vehicle.a (hero) a static object 1 5.00 5.00" in lines
    assert "0.50 2 1 vehicle.a 9 unknown 2 5.00" in lines
    assert lines[-1] == "2 rows; 2 frames, 0.5 seconds"


def test_what_is_unknown_is_empty_in_tables(make: Make) -> None:
    hero = Spawn(1, 1, type_id="vehicle.a", attributes=attributes(role_name="hero"))
    reader = make({"spawned": [hero], "transforms": [(1, 0, 0, 0, 0, 0, 0)]}, {"collisions": [(0, 1, NO_ACTOR, 1, 0)]})
    (incident,), (recording,) = cells(incidents(reader)), cells(summary(reader, IncidentOptions()))
    assert (incident[-1], recording[6]) == ("", "")
    assert "nan" not in "".join(lines(summary(reader, IncidentOptions())))


def test_table_of_a_contact_that_is_interrupted(make: Make) -> None:
    hit = {"collisions": [(0, 1, 2, 0, 0)]}
    lines = printed(collisions(make(hit, {}, hit, durations=[0.25] * 3))).splitlines()
    assert lines[-1] == "2 rows of 1 contact; 3 frames, 0.5 seconds"


def test_blocked_vehicles_come_before_walkers_and_others(make: Make) -> None:
    cast = [spawn(1, "spectator"), spawn(2, "static.prop.mesh"), spawn(3, "walker.a"), spawn(4, "vehicle.a")]
    poses = [(actor.id, actor.id, 0, 0, 0, 0, 0) for actor in cast]
    answer = blocked(make({"spawned": cast, "transforms": poses}, {"transforms": poses}, {}), 0.1)
    assert [cells[2] for cells in table_output.cells(answer)] == ["4", "3", "1", "2"]
    assert [row.id for row in answer] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("width", "heading"),
    [
        (120, "Id Actor Measure Value Unit Time (s) Id Other"),
        (80, "Id Measure Value Unit Time (s) Id Other"),
        (60, "Id Measure Value Unit Time (s) Id"),
        (40, "Id Measure Value Time (s)"),
    ],
)
def test_measures_keep_ids_values_and_times_in_narrow_terminals(width: int, heading: str) -> None:
    with open_recording("samples/crash.mcap") as recording:
        lines = printed(recording.measures("hero"), width).splitlines()
    assert " ".join(lines[1].split()) == heading
    assert max(map(len, lines)) <= width
    hard = next(line.split() for line in lines if "157.523" in line)
    assert hard[0] == "41"
    assert "15.10" in hard


def test_an_id_is_whole_where_names_have_no_room(make: Make) -> None:
    cast = [spawn(4_000_000_001, "vehicle.a"), spawn(4_000_000_002, "vehicle.b")]
    answer = collisions(make({"spawned": cast}, {"collisions": [(0, cast[0].id, cast[1].id, 1, 1)]}))
    assert "4000000001" in printed(answer, 40)


def test_table_of_info(make: Make) -> None:
    reader = make({"spawned": [spawn(1, "vehicle.a", Attribute(3, "role_name", "hero"))], "destroyed": [(2,)]})
    shown = printed(info(reader))
    assert "type_id=vehicle.a attributes=[role_name=hero]" in shown
    assert re.search(r"0\.00 +1 +destroyed +id=2", shown)


def test_a_long_table_has_one_heading(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_output, "_PAGE", 4)
    shown = printed(info(make({"destroyed": [(id,) for id in range(10)]})))
    assert shown.count("Details") == 1
    rows = [line for line in shown.splitlines() if "destroyed" in line]
    assert len(rows) == 10
    (heading,) = (line for line in shown.splitlines() if "Details" in line)
    assert {heading.index("Record")} == {line.index("destroyed") for line in rows}
    assert {heading.index("Details")} == {line.index("id=") for line in rows}


def test_a_table_controls_no_terminal(make: Make) -> None:
    reader = make(
        {"spawned": [spawn(1, EVIL, Attribute(3, EVIL, EVIL))], "transforms": [(1, 1, 0, 0, 0, 0, 0)]},
        {"collisions": [(0, 1, 1, 0, 0)]},
        header=Header(EVIL, 0),
    )
    for answer in (info(reader, all=True), collisions(reader), blocked(reader, 0.1)):
        shown = printed(answer)
        assert shown.replace("\n", "").isprintable()
        assert "[red]\\x1b[31m\\x07\\x9b5A\\u202egnp.exe\\r\\n\\u2028[/nothing]" in shown.replace("\n", "")


METRES = {None: "", math.nan: "", math.inf: "unknown", 0.0: "0.000", 0.00042: "0.0004", 0.001: "0.001"}


@pytest.mark.parametrize(
    ("form", "texts"),
    [
        (differences._metres, METRES | {5.0: "5.000", 99.9: "99.900", 100.0: "100.0", 123.456: "123.5"}),
        (differences._degrees, {0.0: "", 0.042: "0.04", 0.1: "0.1", 12.34: "12.3"}),
        (differences._seconds, {None: "", math.nan: "", 0.0: "0.00", 1.236: "1.24"}),
    ],
)
def test_numbers_have_digits_that_matter_and_what_is_unknown_is_empty(form, texts):
    assert {value: form(value) for value in texts} == texts
