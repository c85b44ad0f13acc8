from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from carla_recap.roads import cells as grids
from carla_recap.roads.cells import NO_AREA, BoxGrid, find_areas

CELLS = hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def drawn(*rows: str) -> np.ndarray:
    return np.array([[cell == "#" for cell in row] for row in rows])


def test_cells_are_connected_by_their_sides_not_by_their_corners():
    areas = find_areas(drawn("##..", ".##.", "...#"))
    assert sorted(areas.sizes.tolist()) == [1, 4]


def test_arms_that_meet_later_are_one_area():
    areas = find_areas(drawn("#.#.#", "#.#.#", "###.#", "..###"))
    assert areas.sizes.tolist() == [13]


def test_an_area_at_the_edge_is_not_enclosed():
    areas = find_areas(drawn(".....", ".#.#.", ".#.##", "....."))
    assert sorted(zip(areas.sizes.tolist(), areas.enclosed.tolist(), strict=True)) == [(2, True), (3, False)]


def test_wanted_areas_as_cells():
    cells = drawn(".....", ".#.#.", ".#...", ".....")
    areas = find_areas(cells)
    assert np.array_equal(areas.cells(areas.sizes == 2), drawn(".....", ".#...", ".#...", "....."))


@given(CELLS)
def test_neighbours_are_of_the_same_area_and_areas_are_of_all_cells(cells):
    areas = find_areas(cells)
    assert np.array_equal(areas.numbers != NO_AREA, cells)
    assert np.array_equal(areas.sizes, np.bincount(areas.numbers[cells], minlength=len(areas.sizes)))
    for one, other in ((areas.numbers[1:], areas.numbers[:-1]), (areas.numbers[:, 1:], areas.numbers[:, :-1])):
        both = (one != NO_AREA) & (other != NO_AREA)
        assert np.array_equal(one[both], other[both])


def test_things_beyond_the_limit_of_entries_share_larger_cells(monkeypatch):
    monkeypatch.setattr(grids, "_MOST_ENTRIES", 3)
    low = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=2).reshape(-1, 2)
    (query, things), *more = BoxGrid(low, low + 0.5, 1.0, 0.25).pairs(np.array([(2.2, 3.1), (90.0, 90.0)]))
    assert not more
    assert set(query.tolist()) == {0}
    assert {3 * 6 + 2} <= set(things.tolist())
