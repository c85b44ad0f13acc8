"""Answers as data frames and Arrow tables."""

from __future__ import annotations

import sys
from dataclasses import dataclass, make_dataclass

import numpy as np
import pytest

from carla_recap import MissingExtra, open_recording
from carla_recap.tables import Columns, Rows
from carla_recap.tables.display import cell
from tests.samples import SAMPLES


@dataclass(frozen=True)
class Row:
    """A row of every kind of column."""

    id: int
    name: str
    time: float
    hero: bool
    parent: int | None = None


class TypedRows(Rows[Row]):
    """Rows with a type, also if there are none."""

    row_type = Row


@dataclass(frozen=True)
class Pair(Columns):
    """Two columns."""

    a: np.ndarray
    b: np.ndarray


ROWS = [Row(1, "one", 0.5, True, 7), Row(2, "two", 1.5, False)]


@pytest.mark.parametrize("kind", [Rows, TypedRows])
def test_rows_become_tables(kind):
    frame, table = kind(ROWS).to_pandas(), kind(ROWS).to_arrow()
    assert (frame["id"].dtype, frame["time"].dtype, frame["hero"].dtype) == (np.int64, np.float64, np.bool_)
    assert frame["name"].tolist() == ["one", "two"]
    assert frame["parent"].isna().tolist() == [False, True]
    assert table.to_pylist() == [
        {"id": 1, "name": "one", "time": 0.5, "hero": True, "parent": 7},
        {"id": 2, "name": "two", "time": 1.5, "hero": False, "parent": None},
    ]


def test_no_rows_have_columns_too():
    frame, table = TypedRows().to_pandas(), TypedRows().to_arrow()
    assert list(frame.columns) == table.column_names == ["id", "name", "time", "hero", "parent"]
    assert (frame["name"].dtype, frame["time"].dtype) == (TypedRows(ROWS).to_pandas()["name"].dtype, np.float64)
    assert (table.num_rows, str(table.schema.field("name").type)) == (0, "string")


def test_no_rows_of_no_type_have_no_columns():
    assert (list(Rows().to_pandas().columns), Rows().to_arrow().num_columns) == ([], 0)


def test_large_numbers_fit():
    rows = Rows([Row((1 << 64) - 1, "", 0.0, False)])
    frame, table = rows.to_pandas(), rows.to_arrow()
    assert (frame["id"].dtype, frame["id"].tolist()) == (np.uint64, [(1 << 64) - 1])
    assert (str(table.schema.field("id").type), table.column("id").to_pylist()) == ("uint64", [(1 << 64) - 1])


def test_columns_become_tables():
    pair = Pair(np.arange(3, dtype=np.float32), np.array([True, False, True]))
    frame = pair.to_pandas()
    assert (frame["a"].dtype, frame["b"].tolist()) == (np.float32, [True, False, True])
    assert pair.to_arrow().to_pydict() == {"a": [0.0, 1.0, 2.0], "b": [True, False, True]}


@pytest.mark.parametrize("table", [TypedRows(ROWS), Pair(np.zeros(1), np.zeros(1))], ids=["rows", "columns"])
@pytest.mark.parametrize(
    ("method", "package", "extra"), [("to_pandas", "pandas", "pandas"), ("to_arrow", "pyarrow", "arrow")]
)
def test_a_package_that_is_missing_is_named(monkeypatch, table, method, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtra) as caught:
        getattr(table, method)()
    message = f"{method}() needs an optional dependency: pip install '.[{extra}]' in a clone of carla-recap"
    assert str(caught.value) == message


LONG = 20_000


@dataclass(frozen=True)
class Point:
    """A row."""

    time: float
    name: str = ""


class Points(Rows[Point]):
    """Rows."""

    row_type = Point
    row_units = {"time": "s"}  # noqa: RUF012


@dataclass(frozen=True, repr=False)
class Curve(Columns):
    """Columns."""

    x: np.ndarray
    y: np.ndarray


@pytest.fixture(scope="module")
def recording():
    with open_recording(SAMPLES / "crash.mcap") as opened:
        yield opened


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (17.35000000000011, "17.35"),
        (2.0, "2"),
        (-0.5, "-0.5"),
        (1e-5, "1e-05"),
        (3e20, "3e+20"),
        (float("nan"), "nan"),
        (np.float32(0.1), "0.1"),
        (12345.6789, "12345.679"),
        (4294967295, "4294967295"),
        ((41, 1.25), "41, 1.25"),
        (None, ""),
        ("a\x1b[2Jb", "a\\x1b[2Jb"),
        ("x" * 50, "x" * 39 + "…"),
    ],
)
def test_values_are_shown_for_people(value, text):
    assert cell(value) == text


def test_a_short_table_has_all_rows():
    assert repr(Points([Point(0.05, "one"), Point(17.35000000000011)])) == (
        "Points: 2 rows\ntime (s)  name\n    0.05  one\n   17.35"
    )
    assert repr(Points()) == "Points: 0 rows"
    assert Points()._repr_html_() == "<p>Points: 0 rows</p>"


@pytest.mark.parametrize(
    "table", [Points(Point(float(n)) for n in range(LONG)), Curve(np.arange(LONG), np.zeros(LONG))], ids=["rows", "columns"]
)
def test_of_a_long_table_both_ends_are_shown(table):
    heading, _, *lines = repr(table).splitlines()
    assert heading.endswith(": 20,000 rows")
    assert [line.split()[0] for line in lines] == [*"01234", "…", *(str(LONG - n) for n in range(5, 0, -1))]
    html = table._repr_html_()
    assert (html.count("<tr>"), "20,000 rows" in html) == (12, True)


def test_html_is_escaped():
    assert "&lt;script&gt;" in Points([Point(0.0, "<script>")])._repr_html_()


def test_columns_without_room_are_named():
    wide = make_dataclass("Wide", ["first", "wide", "other", "last", "end"], bases=(Columns,), frozen=True, repr=False)
    lines = repr(wide(np.zeros(1), *([letter * 39] for letter in "xyz"), np.ones(1))).splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[-1] == "and the columns last, end"


def test_answers_of_a_recording_are_short(recording):
    trajectories = recording.trajectories()
    for answer in (
        recording.collisions(),
        recording.incidents(kinds="all"),
        trajectories,
        trajectories[41],
        recording.time_series("hero"),
        recording.actors,
        recording.table("transforms"),
        recording.controls("hero"),
    ):
        assert len(repr(answer).splitlines()) <= 14
        assert "0000000" not in repr(answer)
        assert answer._repr_html_().count("<tr>") <= 12


def test_trajectories_are_shown_by_actor(recording):
    lines = repr(recording.trajectories("vehicle")).splitlines()
    assert lines[0] == "Trajectories: 5 rows"
    assert lines[2].split()[:4] == ["41", "1200", "0", "59.95"]
