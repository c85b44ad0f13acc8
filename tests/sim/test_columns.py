from __future__ import annotations

from typing import Any

import numpy as np

from carla_recap.sim.columns import StructOfArrays, column


class Table(StructOfArrays):
    id: Any = column(np.int64(0))
    place: Any = column(np.zeros(2))


def test_an_array_that_is_held_keeps_its_rows() -> None:
    table = Table()
    table.append_row(id=1)
    held = table.id
    table.append_row(id=2)
    assert held.tolist() == [1]
    held = table.id
    table.remove_row(0)
    table.append_row(id=3)
    assert held.tolist() == [1, 2]


def test_a_column_that_is_assigned_anew_grows() -> None:
    table = Table()
    table.append_row(id=1)
    table.place = table.place + 5
    table.append_row(id=2)
    assert table.place.tolist() == [[5, 5], [0, 0]]
