"""The squares in which lanes are looked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from carla_recap.roads import cells, find_road_network, network
from carla_recap.roads.surfaces import road_network_of
from tests.roads.towns import lane, opendrive, road, section
from tests.twins.lane_positions import lane_position


def assert_as_one_by_one(roads, points, headings):
    found = roads.lanes_at(points, headings)
    for row, point in enumerate(points):
        expected = lane_position(roads, point, None if headings is None else headings[row])
        assert found.lane[row] in (expected["lanes"] or {network.NONE})
        assert found.outside[row] == pytest.approx(expected["outside"])
        is_of_junction = np.append(roads.lanes["junction"], network.NONE)[found.lane[row]] != network.NONE
        assert found.in_junction[row] == (expected["in_junction"] or is_of_junction)
        if expected["beside"]:
            assert min(abs(found.beside[row] - beside) for beside in expected["beside"]) < 1e-6


@given(
    near=st.lists(st.tuples(st.integers(0, 10_000), *[st.floats(-24, 24)] * 2, st.floats(-5, 5)), min_size=1, max_size=8),
    heading=st.none() | st.floats(-3.2, 3.2),
    columns=st.sampled_from((2, 3)),
)
@example(near=[(1767, 20.25, 4.0, 0.0)], heading=0.0, columns=2)  # on a lane against its direction, beside another one
@settings(deadline=None)
def test_lanes_are_those_that_are_found_one_by_one(near, heading, columns):
    roads = find_road_network("Brickfield")
    starts = np.stack([roads.pieces[f"{axis}0"] for axis in "xyz"], axis=1)
    points = np.array([starts[number % len(starts)] + away for number, *away in near])[:, :columns]
    assert_as_one_by_one(roads, points, None if heading is None else np.full(len(points), heading))


def test_of_hundreds_of_lanes_around_a_point_the_nearest_counts():
    x, y = np.meshgrid(np.arange(28) * 1.5, np.arange(28) * 1.5)
    parked = section(0, right=lane(-1, 1.0))
    places = enumerate(zip(x.ravel(), y.ravel(), strict=True), 1)
    roads = road_network_of(
        opendrive(*(road(n, x=east, y=north, length=1.2, sections=parked) for n, (east, north) in places))
    )
    points = np.array([(20.0, 55.0), (20.0, 43.0), (55.0, 20.0), (-9.0, 20.0), (20.0, -9.0)])
    assert_as_one_by_one(roads, points, None)


def test_the_squares_of_a_map_with_many_parts_are_larger(monkeypatch):
    monkeypatch.setattr(cells, "_MOST_ENTRIES", 4_000)
    roads = replace(find_road_network("Brickfield"))
    points = np.random.default_rng(1).uniform((0, 0), (330, 260), (60, 2))
    assert_as_one_by_one(roads, points, None)
