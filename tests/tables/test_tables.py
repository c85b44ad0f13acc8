"""Answers as data frames and Arrow tables."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import pytest

from carla_recap import MissingExtra
from carla_recap.tables import Columns, Rows


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
