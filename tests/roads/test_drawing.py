"""The lines of small maps written by hand."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.roads import load_map
from tests.roads.towns import crossing, lane, opendrive, painted_stop, road, section, stop_sign

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.roads import RoadMap


@pytest.fixture
def draw(tmp_path: Path):
    def draw(*roads: str) -> RoadMap:
        path = tmp_path / "small.xodr"
        path.write_text(opendrive(*roads))
        return load_map(path)

    return draw


def near(lines: list[np.ndarray], *expected: list[tuple[float, float, float]]) -> bool:
    """Return whether the lines are these, in any order."""
    found = sorted(np.round(line, 2).tolist() for line in lines)
    wanted = sorted(np.round(line, 2).tolist() for line in expected)
    return len(found) == len(wanted) and all(
        len(a) == len(b) and np.allclose(a, b, atol=0.011) for a, b in zip(found, wanted, strict=True)
    )


def test_a_junction_wider_than_what_is_drawn_of_it_warns(draw):
    with pytest.warns(RecapWarning, match="of a lane of road 1 that is 80 m wide, 400 lines are drawn on"):
        draw(road(length=2, sections=section(0, right=lane(-1, 80)), junction=5))


def test_a_straight_road_in_right_handed_metres(draw):
    town = draw(road(height=2, inside=crossing(50)))
    assert town.name == "small"
    assert near(town.centre_lines, [(0, -1.75, 2), (100, -1.75, 2)], [(100, 1.75, 2), (0, 1.75, 2)])
    assert near(
        town.lane_borders,
        [(0, -3.5, 2), (100, -3.5, 2)],
        [(100, 3.5, 2), (0, 3.5, 2)],
        [(100, 0, 2), (0, 0, 2)],  # once, though two lanes have it
    )
    assert near(town.crossings, [(52, -4, 2), (52, 4, 2), (48, 4, 2), (48, -4, 2), (52, -4, 2)])
    assert town.junctions == town.stop_lines == []


ONE_LANE, TWO_LANES = section(0, right=lane(-1)), section(0, right=lane(-1) + lane(-2))
INSIDE = {"x": 100, "length": 20, "junction": 9}


@pytest.mark.parametrize(
    ("roads", "expected"),
    [
        ([road(x=10, y=20, heading=math.pi / 2, sections=ONE_LANE)], [[(11.75, 20, 0), (11.75, 120, 0)]]),
        (
            [road(1), road(2, x=100), road(3, x=200)],  # successive roads are one line
            [[(0, -1.75, 0), (300, -1.75, 0)], [(300, 1.75, 0), (0, 1.75, 0)]],
        ),
        (
            [road(sections=TWO_LANES + section(40, right=lane(-1)))],  # a line ends with its lane
            [[(0, -1.75, 0), (100, -1.75, 0)], [(0, -5.25, 0), (40, -5.25, 0)]],
        ),
    ],
)
def test_centre_lines(draw, roads, expected):
    assert near(draw(*roads).centre_lines, *expected)


@pytest.mark.parametrize(
    ("roads", "expected"),
    [
        ([road(sections=TWO_LANES, inside=stop_sign(80, -2, -1))], [(80, 0, 0), (80, -7, 0)]),  # of lanes side by side
        (
            [road(1), *(road(n, **INSIDE, inside=stop_sign(s, -1, -1)) for n, s in ((2, 3), (3, 15)))],
            [(100, 0, 0), (100, -3.5, 0)],  # before the junction in which the signs are
        ),
        ([road(inside=painted_stop(80, -1.75, 3.0) + stop_sign(82, -1, -1))], [(80, -3.25, 0), (80, -0.25, 0)]),
    ],
)
def test_stop_lines(draw, roads, expected):
    assert near(draw(*roads).stop_lines, expected)


def test_a_curve_is_smooth_and_has_few_points(draw):
    radius = 20.0
    town = draw(road(length=radius * math.pi, shape=f'<arc curvature="{1 / radius}"/>', sections=section(0, right=lane(-1))))
    (line,) = town.centre_lines
    middles = (line[1:] + line[:-1]) / 2
    for points in (line, middles):
        assert np.abs(np.linalg.norm(points[:, :2] - [0, radius], axis=1) - (radius + 1.75)).max() < 0.05
    assert len(line) < 50


def test_shoulders_and_pavements_have_borders_but_no_centre_lines(draw):
    right = lane(-1) + lane(-2, 1, "shoulder") + lane(-3, 2, "sidewalk") + lane(-4, 5, "none")
    town = draw(road(sections=section(0, right=right)))
    assert len(town.centre_lines) == 1
    assert near(town.lane_borders, *([(0, -y, 0), (100, -y, 0)] for y in (0, 3.5, 4.5, 6.5)))


def test_the_outline_of_a_junction(draw):
    one_way = section(0, right=lane(-1))
    town = draw(
        road(1, sections=one_way),
        road(2, x=100, length=20, junction=9, sections=one_way),
        road(3, x=100, length=20, junction=9, shape='<arc curvature="0.05"/>', sections=one_way),
        road(4, x=120, sections=one_way),
    )
    (outline,) = town.junctions
    assert outline[0].tolist() == outline[-1].tolist()
    assert outline[:, 0].min() == pytest.approx(100, abs=0.3)
    assert outline[:, 0].max() == pytest.approx(120, abs=0.3)
    # On the right, the straight lane alone has an edge; on the left, the bent lane has.
    assert any(np.allclose(line[[0, -1]], [(0, -3.5, 0), (220, -3.5, 0)], atol=0.01) for line in town.lane_borders)
    within = np.concatenate([line for line in town.lane_borders if ((line[:, 0] > 101) & (line[:, 0] < 118)).any()])
    assert not (np.linalg.norm(within[:, :2] - [110, -1.5], axis=1) < 1).any()


def test_a_sign_for_a_huge_range_of_lanes_takes_no_time(draw):
    town = draw(road(inside=stop_sign(80, -(2**31), 2**31 - 1)))
    assert len(town.stop_lines) in (1, 2)
