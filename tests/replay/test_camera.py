"""The camera behind an actor and the one above it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.replay import calm_heading, calm_headings, chase, level, top

CAR = np.array([100.0, 200, 30, 5, 10, 90])  # looks along y, rolls and pitches


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (chase(CAR), [100, -800, 530, 0, -25, 90]),
        (chase(np.array([0.0, 0, 0, 180, 80, 0])), [-1000, 0, 500, 0, -25, 0]),  # level, and above
        (chase(CAR, 180.0, back=100, up=50, pitch=-5), [200, 200, 80, 0, -5, 180]),
        (top(CAR), [100, 200, 4030, 0, -90, 90]),
        (top(CAR, 0.0), [100, 200, 4030, 0, -90, 0]),
    ],
)
def test_where_a_camera_is(camera: np.ndarray, expected: list[float]) -> None:
    assert camera == pytest.approx(expected)


def test_arrays_of_poses() -> None:
    drive = np.stack([CAR, CAR + 1])
    for camera in (chase, top, level):
        assert camera(drive)[1] == pytest.approx(camera(drive[1]))
        assert camera(drive, np.array([1.0, 2.0]))[1, 5] == 2
    assert drive[0].tolist() == CAR.tolist()


def test_the_heading_begins_at_the_actor() -> None:
    assert calm_heading(70.0, None, 0.1) == 70
    assert calm_heading(70.0, math.nan, 0.1) == 70
    assert calm_heading(math.inf, 70.0, 0.1) == math.inf


def test_two_thirds_of_a_turn_in_half_a_second() -> None:
    assert calm_heading(90.0, 0.0, 0.5) == pytest.approx(90 * (1 - math.exp(-1)))
    assert calm_heading(90.0, 0.0, 0.0) == 0
    assert calm_heading(90.0, 0.0, 0.1, seconds=0) == 90


def test_the_heading_takes_the_shorter_rotation() -> None:
    assert calm_heading(-170.0, 170.0, 1e9) == pytest.approx(-170)
    assert 170 < calm_heading(-170.0, 170.0, 0.1) < 180


@given(st.floats(-180, 180), st.integers(1, 50))
def test_the_heading_does_not_depend_on_the_steps(yaw: float, steps: int) -> None:
    heading = 0.0
    for _ in range(steps):
        heading = calm_heading(yaw, heading, 0.4 / steps)
    assert math.remainder(heading - calm_heading(yaw, 0.0, 0.4), 360) == pytest.approx(0, abs=1e-6)


@given(st.lists(st.tuples(st.floats(0.001, 1), st.floats(-180, 180)), min_size=1, max_size=20))
def test_headings_at_many_times_equal_single_steps(samples: list[tuple[float, float]]) -> None:
    times = np.cumsum([delta for delta, _ in samples])
    yaws = [0.0]
    for _, turn in samples[1:]:
        yaws.append(math.remainder(yaws[-1] + turn / 4, 360))
    heading: float | None = None
    for place, calm in enumerate(calm_headings(times, np.array(yaws))):
        heading = calm_heading(yaws[place], heading, times[place] - times[place - 1])
        assert math.remainder(heading - calm, 360) == pytest.approx(0, abs=1e-6)


def test_headings_at_many_times_do_not_jump_at_180() -> None:
    yaws = np.array([math.remainder(10 * step, 360) for step in range(72)])
    headings = calm_headings(np.arange(72) * 0.1, yaws)
    assert np.abs(np.diff(headings)).max() <= 10
    assert headings[-1] > 600
