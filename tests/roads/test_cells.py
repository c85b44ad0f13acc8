"""Connected areas of cells, as they are found by a flood."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from carla_recap.roads.cells import NO_AREA, find_areas

CELLS = hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12)))
ARMS_THAT_MEET_LATER = np.array([[1, 0, 1, 0, 1], [1, 0, 1, 0, 1], [1, 1, 1, 0, 1], [0, 0, 1, 1, 1]], np.bool_)


def flooded(cells: np.ndarray, start: tuple[int, int]) -> set[tuple[int, int]]:
    """Return the cells to which one comes from a cell by the sides of others."""
    found: set[tuple[int, int]] = set()
    waiting = [start]
    while waiting:
        x, y = at = waiting.pop()
        if 0 <= x < cells.shape[0] and 0 <= y < cells.shape[1] and cells[at] and at not in found:
            found.add(at)
            waiting += [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
    return found


@given(CELLS)
@example(ARMS_THAT_MEET_LATER)
def test_areas_are_those_of_a_flood(cells: np.ndarray) -> None:
    areas = find_areas(cells)
    assert np.array_equal(areas.numbers != NO_AREA, cells)
    for number, (size, enclosed) in enumerate(zip(areas.sizes, areas.enclosed, strict=True)):
        area = set(map(tuple, np.argwhere(areas.cells(np.arange(len(areas.sizes)) == number)).tolist()))
        assert area == flooded(cells, min(area))
        assert size == len(area)
        assert enclosed == all(0 < x < cells.shape[0] - 1 and 0 < y < cells.shape[1] - 1 for x, y in area)
