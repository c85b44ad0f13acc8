from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.queries.measures.boxes import Boxes, gap, overlaps, required_deceleration, time_headway, time_to_collision

SQUARE_ROOT_HALF = math.sqrt(0.5)


def car(x: float, y: float, heading: float = 0.0, speed: float = 0.0, length: float = 4.0) -> Boxes:
    yaw = math.radians(heading)
    return Boxes(x, y, yaw, length, 2.0, speed * math.cos(yaw), speed * math.sin(yaw))


@pytest.mark.parametrize(
    ("one", "other", "seconds"),
    [
        (car(-20, 0, 0, 10), car(0, -20, 90, 10), 1.7),
        (car(-20, 0, 0, 10), car(0, -30, 90, 10), math.inf),  # one passes before the other arrives
        (car(0, 0, 0, 10), car(44, 0, 180, 10), 2.0),
        (car(0, 0, 0, 10), car(20, 3, 180, 10), math.inf),  # on the other lane
        (car(0, 0, 0, 10), car(20, 2.5), math.inf),  # parked beside the road
        (car(0, 0), car(10, 0), math.inf),
        (car(0, 0, 0, 10), car(20, 0, 0, 10), math.inf),
        (car(0, 0, 0, 10), car(20, 0, 0, 12), math.inf),
        (car(0, 0, 0, 5), car(3, 0, 0, 10), 0.0),  # in contact, though moving apart
        (car(0, 0, 5, 20), car(60, 3.5, 180, 0), 2.807),  # a swerve of 5 degrees
    ],
)
def test_time_to_collision(one: Boxes, other: Boxes, seconds: float) -> None:
    assert time_to_collision(one, other) == pytest.approx(seconds, abs=1e-3)
    assert time_to_collision(other, one) == pytest.approx(time_to_collision(one, other))


@pytest.mark.parametrize(
    ("other", "metres"),
    [
        (car(0, 2.5), 0.5),
        (car(5, 0), 1.0),
        (car(5, 0, 45), 5 - 3 * SQUARE_ROOT_HALF - 2),
        (car(7, 6), 5.0),
        (car(1, 1, 30), 0.0),
        (car(0, 0, 90, length=8), 0.0),  # a cross: no corner of one is in the other
        (car(4, 0), 0.0),  # they touch
    ],
)
def test_gap(other: Boxes, metres: float) -> None:
    assert gap(car(0, 0), other) == pytest.approx(metres)
    assert gap(other, car(0, 0)) == pytest.approx(metres)
    assert overlaps(car(0, 0), other) == (metres == 0)


def test_at_rest_there_is_no_headway_in_time() -> None:
    assert time_headway([5.0, 5.0], [0.0, 2.0]).tolist() == [math.inf, 2.5]


def test_a_leader_that_is_not_slower_requires_no_deceleration() -> None:
    assert required_deceleration([5, 0, 0, 0], [3, 3, 4, 1e-200], [4, 3, 3, 0]).tolist() == [0, 0, math.inf, math.inf]


def test_what_is_not_a_number_gives_no_number_and_no_warning() -> None:
    nowhere = Boxes(math.nan, 0.0, 0.0, 4.0, 2.0, 1.0, 0.0)
    assert np.isnan(gap(car(0, 0), nowhere))
    assert time_to_collision(car(0, 0), nowhere) == math.inf
    unknown = {"vx": math.nan, "vy": math.nan}
    assert [time_to_collision(car(0, 0), car(x, 0)._replace(**unknown)) for x in (1, 9)] == [0, math.inf]
    assert np.isnan(required_deceleration(math.nan, 3, 2))
    assert np.isnan(time_headway(math.nan, 3))


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
    spacing = max(map(float, (one.length, one.width, other.length, other.width))) / 99
    if is_in:
        assert found < spacing
    else:
        assert distance - spacing <= found <= distance + 1e-9


@given(boxes, boxes)
def test_at_the_time_to_collision_boxes_touch_for_the_first_time(one: Boxes, other: Boxes) -> None:
    time = float(time_to_collision(one, other))

    def at(seconds: float) -> tuple[Boxes, Boxes]:
        moved = [box._replace(x=box.x + box.vx * seconds, y=box.y + box.vy * seconds) for box in (one, other)]
        return moved[0], moved[1]

    before = np.linspace(0, min(time, 60.0), 300, endpoint=False)
    assert not (gap(*at(before)) == 0)[:-1].any() or time == 0
    if time < math.inf:
        assert gap(*at(time)) < 1e-6


@given(boxes, boxes, st.floats(-3, 3), reals, reals)
def test_neither_depends_on_the_axes(one: Boxes, other: Boxes, turn: float, x: float, y: float) -> None:
    cos, sin = math.cos(turn), math.sin(turn)

    def turned(box: Boxes) -> Boxes:
        return box._replace(
            x=x + cos * box.x - sin * box.y,
            y=y + sin * box.x + cos * box.y,
            yaw=box.yaw + turn,
            vx=cos * box.vx - sin * box.vy,
            vy=sin * box.vx + cos * box.vy,
        )

    assert gap(turned(one), turned(other)) == pytest.approx(float(gap(one, other)), abs=1e-6)
