from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import pytest

from carla_recap.errors import MissingExtra
from carla_recap.queries.collisions import collisions
from carla_recap.tables import Rows


@dataclass(frozen=True)
class Row:
    id: int
    seconds: float
    name: str
    hero: bool


class Typed(Rows[Row]):
    row_type = Row


ROWS = [Row(1, 0.5, "a", True), Row(2**64 - 1, float("nan"), "é", False)]


def test_to_pandas() -> None:
    pytest.importorskip("pandas")
    frame = Typed(ROWS).to_pandas()
    assert list(frame.columns) == ["id", "seconds", "name", "hero"]
    assert [frame[name].dtype for name in ("id", "seconds", "hero")] == [np.uint64, np.float64, np.bool_]
    assert list(frame["id"]) == [1, 2**64 - 1]
    assert list(frame["name"]) == ["a", "é"]
    assert Typed(ROWS[:1]).to_pandas()["id"].dtype == np.int64


def test_to_arrow() -> None:
    pytest.importorskip("pyarrow")
    table = Typed(ROWS).to_arrow()
    assert [str(type) for type in table.schema.types] == ["uint64", "double", "string", "bool"]
    assert table.column("id").to_pylist() == [1, 2**64 - 1]


def test_empty() -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = Typed().to_pandas()
    assert list(frame.columns) == ["id", "seconds", "name", "hero"]
    assert frame["seconds"].dtype == np.float64
    assert frame["name"].dtype == Typed(ROWS).to_pandas()["name"].dtype
    assert [str(type) for type in Typed().to_arrow().schema.types] == ["int64", "double", "string", "bool"]
    assert Rows[Row]().to_pandas().empty


def test_untyped() -> None:
    pytest.importorskip("pandas")
    assert Rows(ROWS).to_pandas().shape == (2, 4)


MOVING = {"velocities": [(1, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0), (2, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0)]}


def test_an_answer(make) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("pandas")
    frame = collisions(make(MOVING, {"collisions": [(0, 1, 2, 1, 0)]})).to_pandas()
    assert frame.iloc[0].to_dict() == {
        "elapsed": 0.5,
        "frame": 2,
        "letter1": "o",
        "id1": 1,
        "type_id1": "",
        "hero1": True,
        "letter2": "o",
        "id2": 2,
        "type_id2": "",
        "hero2": False,
        "contact": 1,
        "impact_speed": 5.0,
        "relative_speed": 4.0,
    }


@pytest.mark.parametrize(("module", "method"), [("pandas", "to_pandas"), ("pyarrow", "to_arrow")])
def test_missing(monkeypatch: pytest.MonkeyPatch, module: str, method: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match=rf"{method}\(\) needs an optional dependency"):
        getattr(Typed(ROWS), method)()
