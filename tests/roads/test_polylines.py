from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from carla_recap.roads.polylines import Surface, distances_to, join, simplify, stations
from tests.waiting import time_limit

LINES = hnp.arrays(np.float64, st.tuples(st.integers(2, 40), st.just(3)), elements=st.floats(-1000, 1000))


def line(*points: tuple[float, float]) -> np.ndarray:
    return np.array(points, np.float64)


def grid(x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(*x, 0.1), np.arange(*y, 0.1)), axis=-1).reshape(-1, 2)


def area(outline: np.ndarray) -> float:
    x, y = outline.T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2)


def test_a_straight_line_needs_two_points():
    assert simplify(np.linspace((0, 0, 0), (30, 40, 5), 100)).tolist() == [[0, 0, 0], [30, 40, 5]]


def test_a_bend_keeps_its_corner():
    bent = np.concatenate((np.linspace((0, 0), (10, 0), 11), np.linspace((10, 0), (10, 10), 11)[1:]))
    assert simplify(bent).tolist() == [[0, 0], [10, 0], [10, 10]]


def test_a_line_of_which_each_point_is_a_corner_is_kept_at_once():
    """Each of its parts has but one point less than that around it: examined one in another, they would take minutes."""
    corners = np.stack((np.arange(100_000.0), np.arange(100_000) % 2), axis=1)
    with time_limit():
        assert len(simplify(corners)) == len(corners)


@given(LINES, st.floats(0.001, 10))
@example(np.array([(0, 0, 0), (9, 0, 0), (9, 9, 0), (0, 0, 0)], np.float64), 0.03)  # closed
def test_no_point_deviates_by_more_than_the_tolerance(points, tolerance):
    lighter = simplify(points, tolerance)
    assert lighter[0].tolist() == points[0].tolist()
    assert lighter[-1].tolist() == points[-1].tolist()
    nearest = np.min([distances_to(points, *pair) for pair in pairwise(lighter)], axis=0)
    assert nearest.max() <= tolerance * (1 + 1e-9)


def test_distances_are_to_the_ends_beyond_them():
    assert distances_to(line((5, 2), (-3, 4), (13, 4)), *line((0, 0), (10, 0))).tolist() == [2, 5, 5]
    assert distances_to(line((3, 4)), *line((0, 0), (0, 0))).tolist() == [5]


def test_the_stations_of_points_are_their_distances_along_the_line():
    assert stations(line((1, 1), (4, 5), (4, 5), (4, -1))).tolist() == [0, 5, 5, 11]


@pytest.mark.parametrize(
    ("lines", "joined"),
    [
        ([[(2, 0), (3, 0)], [(0, 0), (1, 0)], [(1, 0), (2, 0)]], [[(0, 0), (1, 0), (2, 0), (3, 0)]]),
        ([[(0, 0), (1, 0)], [(1, 0), (1, 1)], [(1, 1), (0, 0)]], [[(0, 0), (1, 0), (1, 1), (0, 0)]]),
        ([[(0, 0), (1, 0)], [(1, 0), (2, 0)], [(1, 0), (2, 1)]], None),  # a fork
        ([[(0, 0), (1, 0)], [(0, 0), (-1, 0)]], None),  # both begin there
        ([[(0, 0), (1, 0), (1, 1), (0, 0)]], None),  # closed
    ],
)
def test_successive_lines_become_one_and_others_stay_apart(lines, joined):
    assert sorted(map(np.ndarray.tolist, join([line(*points) for points in lines]))) == sorted(
        line(*points).tolist() for points in joined or lines
    )


def test_the_outline_of_a_rectangle():
    (outline,) = Surface(grid((-20, 10), (5, 15))).outlines()
    assert outline[0].tolist() == outline[-1].tolist()
    assert area(outline) == pytest.approx(300, rel=0.05)  # counterclockwise
    assert outline.min(axis=0) == pytest.approx([-20, 5], abs=0.3)
    assert outline.max(axis=0) == pytest.approx([10, 15], abs=0.3)
    assert len(outline) < 12


def test_a_surface_covers_its_inside_and_not_its_edge():
    surface = Surface(grid((0, 10), (0, 20)))
    outside = line((-1, 5), (11, 5), (5, -1), (5, 21), (1e6, 5), (5, -1e6))
    edge = line((0.05, 5), (9.95, 5), (5, 0.05), (5, 19.95))
    assert surface.covers(line((5, 5), (0.5, 0.5), (0.5, 19.5), (9.5, 0.5), (9.5, 19.5))).all()
    assert not surface.covers(np.concatenate((outside, edge))).any()


@pytest.mark.parametrize(("half", "filled"), [(4, True), (10, False)])
def test_a_small_hole_is_filled(half, filled):
    points = grid((0, 40), (0, 40))
    surface = Surface(points[(np.abs(points - 20) >= half).any(axis=1)])
    assert surface.covers(line((20, 20), (5, 20))).tolist() == [filled, True]
    assert len(surface.outlines()) == 1


def test_two_pieces_have_two_outlines():
    surface = Surface(np.concatenate((grid((0, 5), (0, 5)), grid((20, 25), (0, 5)))))
    assert sorted(round(area(outline)) for outline in surface.outlines()) == pytest.approx([26, 26], abs=2)


def test_a_surface_as_large_as_the_world_takes_little_memory():
    assert all(np.isfinite(outline).all() for outline in Surface(line((0, 0), (1e30, 1e30))).outlines())


def test_a_covered_point_covers_all_cells_around_it():
    surface = Surface(grid((0, 10), (0, 10)))
    point = line((-0.1, 5.1))  # in the rim, of which nothing is covered
    around = [(x, y) for x in (-0.25, 0, 0.25) for y in (-0.25, 0, 0.25)]
    surface.cover(line((-0.1, 5.1), (50, 5)))
    assert surface.covers(point + around).all()
    assert not surface.covers(point + line((-0.5, 0), (0, 0.5), (0, -0.5))).any()
