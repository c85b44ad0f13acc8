from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.queries.measures.boxes import Boxes, gap, overlaps, time_to_collision

reals = st.floats(-20, 20).map(lambda value: round(value, 3))
sizes = st.floats(0.3, 12).map(lambda value: round(value, 3))
angles = st.one_of(st.floats(-4, 4), st.sampled_from([0, math.pi / 2, math.pi, -math.pi / 2]))
boxes = st.builds(Boxes, reals, reals, angles, sizes, sizes, reals, reals)


def outline(box: Boxes, points: int = 100) -> np.ndarray:
    """Return points on the edges of a box."""
    x, y, yaw, length, width = (float(value) for value in box[:5])
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)]) * (length / 2, width / 2)
    share = np.linspace(0, 1, points)[:, None]
    edges = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    cos, sin = math.cos(yaw), math.sin(yaw)
    return edges @ np.array([(cos, sin), (-sin, cos)]) + (x, y)


def contains(box: Boxes, points: np.ndarray) -> np.ndarray:
    x, y, yaw, length, width = (float(value) for value in box[:5])
    cos, sin = math.cos(yaw), math.sin(yaw)
    local = (points - (x, y)) @ np.array([(cos, -sin), (sin, cos)])
    return (np.abs(local[:, 0]) <= length / 2 + 1e-9) & (np.abs(local[:, 1]) <= width / 2 + 1e-9)


@given(boxes, boxes)
def test_the_gap_is_the_least_distance_of_the_outlines(one: Boxes, other: Boxes) -> None:
    first, second = outline(one), outline(other)
    distance = np.sqrt(((first[:, None] - second) ** 2).sum(axis=2).min())
    is_in = contains(one, second).any() or contains(other, first).any()
    found = float(gap(one, other))
    assert found == pytest.approx(float(gap(other, one)), abs=1e-9)
    assert overlaps(one, other) == overlaps(other, one) == (found == 0)
    spacing = max(map(float, (one.length, one.width, other.length, other.width))) / 99
    if is_in:
        assert found < spacing
    else:
        assert distance - spacing <= found <= distance + 1e-9


@given(boxes, boxes)
def test_at_the_time_to_collision_boxes_touch_for_the_first_time(one: Boxes, other: Boxes) -> None:
    time = float(time_to_collision(one, other))
    assert time == pytest.approx(float(time_to_collision(other, one)))

    def at(seconds: float) -> tuple[Boxes, Boxes]:
        moved = [box._replace(x=box.x + box.vx * seconds, y=box.y + box.vy * seconds) for box in (one, other)]
        return moved[0], moved[1]

    before = np.linspace(0, min(time, 60.0), 300, endpoint=False)
    assert not (gap(*at(before)) == 0)[:-1].any() or time == 0
    if time < math.inf:
        assert gap(*at(time)) < 1e-6
