from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from carla_recap.model.motion import motion_of, place_in_metres, possible_step, rates, runs, slope, steps_joined
from tests.twins import motion as twin

NAN = np.nan
SECONDS = st.sampled_from([-0.05, 0.0, 0.001, 0.01, 0.05, 0.3, 0.999, 1.0, 1.001, 5.0])
METRES = st.sampled_from([0.0, 0.1, 1.0, 4.9, 5.1, 14.9, 99.0, 101.0, 1e5, NAN])
SPEED = st.sampled_from([NAN, NAN, 0.0, 1.0, 33.0, 149.0, 150.0, 1e6, np.inf])


@pytest.mark.parametrize(
    ("seconds", "speed", "least", "step"),
    [
        (0.2, np.nan, 5.0, 20.0),
        (0.2, 30.0, 5.0, 18.0),
        (0.01, np.nan, 5.0, 5.0),
        (0.01, np.nan, 0.0, 1.0),
        (0.01, 30.0, 0.0, 5.0),
        (0.2, 0.0, 5.0, 5.0),
        (0.0, np.nan, 5.0, 5.0),
    ],
)
def test_a_longer_step_is_a_jump(seconds: float, speed: float, least: float, step: float) -> None:
    assert possible_step(seconds, speed, least=least) == pytest.approx(step)


def test_runs_of_flagged_frames() -> None:
    flags = np.array([True, True, False, True, True, True])
    assert list(runs(flags, np.array([True, True, True, False, True]))) == [(0, 1), (3, 3), (4, 5)]
    assert list(runs(~flags, np.ones(5, np.bool_))) == [(2, 2)]
    assert list(runs(np.array([True]), np.zeros(0, np.bool_))) == [(0, 0)]
    assert list(runs(np.zeros(0, np.bool_), np.zeros(0, np.bool_))) == []


def test_the_slope_of_a_line_through_values() -> None:
    time = np.arange(8) * 0.05
    values = np.stack((7 - 3 * time, np.where(time == time[3], np.nan, 2 * time)))
    slopes = slope(time, values, 0.125)
    assert slopes[0] == pytest.approx(-3)
    assert slopes[1, [0, 1, 2, 4, 5, 6, 7]] == pytest.approx(2)
    assert np.isnan(slopes[1, 3])


@pytest.mark.parametrize("frames", [3, 50, 6000])
def test_all_values_of_half_a_window_count(frames: int) -> None:
    time = 3600 + np.arange(frames) / frames
    values = (time - 3600.3) ** 3
    near = np.abs(time - time[frames // 2]) <= 0.39
    expected = np.polyfit(time[near] - 3600, values[near], 1)[0]
    assert slope(time, values[None], 0.39)[0, frames // 2] == pytest.approx(expected)


def test_a_slope_ends_where_frames_do_not_belong_together() -> None:
    time = np.arange(6) * 0.05
    values = np.array([[0.0, 1.0, 2.0, 100.0, 102.0, 104.0]])
    joined = np.array([True, True, False, True, True])
    assert slope(time, values, 0.125, joined=joined)[0] == pytest.approx([20, 20, 20, 40, 40, 40])
    assert slope(time, values, 0.125)[0, 2] > 400


def test_over_a_long_time_there_is_no_slope() -> None:
    assert np.isnan(slope(np.array([0.0, 1.5, 3.0]), np.array([[1.0, 2.0, 3.0]]), 0.125)).all()
    assert slope(np.array([0.0, 0.9]), np.array([[0.0, 1.8]]), 0.125)[0] == pytest.approx([2, 2])


def test_places_in_metres() -> None:
    assert place_in_metres(100.0, 200.0, -300.0) == (1.0, -2.0, -3.0)
    assert str(place_in_metres(0.0, 0.0, 0.0)) == "(0.0, 0.0, 0.0)"  # not -0.0
    assert [each.tolist() for each in place_in_metres(*np.array([[100.0, 0.0], [50.0, -50.0], [1.0, 2.0]]))] == [
        [1.0, 0.0],
        [-0.5, 0.5],
        [0.01, 0.02],
    ]


@given(st.lists(st.tuples(SECONDS, METRES, METRES, SPEED, st.sampled_from([0.0, 0.0, 0.0, NAN])), max_size=12))
@example([])
@example([(0.05, 1.0, 0.0, NAN, NAN)])
def test_velocities_are_those_of_a_loop(steps: list[tuple[float, ...]]) -> None:
    rows = np.array(steps).reshape(-1, 5)
    time, places = np.cumsum(rows[:, 0]), np.cumsum(np.nan_to_num(rows[:, 1:3]), axis=0).T
    places[np.isnan(rows[:, 1:3].T)] = NAN
    recorded = np.stack((rows[:, 3], rows[:, 4]))
    found, _ = motion_of(time, places, recorded)
    expected = twin.velocities(time.tolist(), places.T.tolist(), recorded.T.tolist())
    np.testing.assert_allclose(found.T, np.array(expected).reshape(-1, 2), rtol=1e-9)


def test_a_jump_has_no_velocity() -> None:
    time, x = np.arange(6) * 0.05, np.array([0.0, 1.0, 2.0, 102.0, 104.0, 106.0])
    joined = steps_joined(time, x[None])
    assert joined.tolist() == [True, True, False, True, True]
    assert rates(time, x, joined) == pytest.approx([20, 20, 20, 40, 40, 40])
    assert np.isnan(rates(time, x, np.zeros(5, np.bool_))).all()


def test_places_of_different_actors_are_not_joined() -> None:
    time, x, actor = np.array([0.0, 0.1, 0.2, 0.3]), np.array([[0.0, 1.0, 2.0, 3.0]]), np.array([1, 1, 2, 2])
    assert steps_joined(time, x, actor=actor).tolist() == [True, False, True]
