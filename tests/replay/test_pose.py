"""Poses: rotations, axes, and attached actors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carla_recap import open_recording
from carla_recap.replay import Player, quaternions, right_handed, right_handed_velocities
from carla_recap.replay.pose import attach, detach, left_handed, rotations, wrap
from tests.replay.scripts import matrix_of
from tests.samples import carla_log

ANGLES = st.floats(-720, 720)
POSES = arrays(np.float64, (6,), elements=st.floats(-180, 180, allow_subnormal=False).map(lambda value: round(value, 3)))


@given(ANGLES, ANGLES)
def test_change_takes_the_shortest_rotation(before: float, after: float) -> None:
    turn = wrap(np.array(after - before))
    assert -180 <= turn <= 180
    assert np.cos(np.radians(before + turn)) == pytest.approx(np.cos(np.radians(after)), abs=1e-9)
    assert np.sin(np.radians(before + turn)) == pytest.approx(np.sin(np.radians(after)), abs=1e-9)


def test_right_handed() -> None:
    assert right_handed(np.array([100.0, 200, 300, 1, 2, 3])).tolist() == [1, -2, 3, 1, -2, -3]
    assert right_handed_velocities(np.array([[1.0, 2, 3, 4, 5, 6]])).tolist() == [[1, -2, 3, -4, 5, -6]]


@pytest.mark.parametrize(("name", "hero"), [("0.9.10", 259), ("0.9.13", 234)])
def test_recorded_rotations_turn_right_handed_axes_as_poses_do(name: str, hero: int) -> None:
    with open_recording(carla_log(f"carla-{name}-lane-center.log")) as recording:
        scenes = [scene for scene in Player(recording).scenes() if hero in scene.velocities["id"]]
    rows = [scene.velocities[scene.velocities["id"] == hero][0].item()[1:] for scene in scenes]
    recorded = right_handed_velocities(np.array(rows))[:, 3:]
    axes = rotations(right_handed(np.array([scene.pose_of(hero) for scene in scenes])))
    seconds = np.diff([scene.time for scene in scenes])
    turn = axes[1:] @ np.swapaxes(axes[:-1], 1, 2)
    turned = np.stack((turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]), axis=1)  # small angles about x, y and z
    for mine, others in zip((np.degrees(turned) / seconds[:, None]).T, recorded[1:].T, strict=True):
        assert np.corrcoef(mine, others)[0, 1] > 0.8


@given(POSES)
def test_left_handed_inverts_right_handed(place: np.ndarray) -> None:
    assert left_handed(right_handed(place)) == pytest.approx(place)


def test_axes_equal_those_of_unreal() -> None:
    """Yaw 90 looks along Unreal's y, which is right, so -y; pitch 90 looks up; roll 90 puts the left side up."""
    forward, left, up = np.eye(3)
    for carla, columns in (
        ((0, 0, 90), (-left, forward, up)),
        ((0, 90, 0), (up, left, -forward)),
        ((90, 0, 0), (forward, up, -left)),
    ):
        matrix = rotations(right_handed(np.array([0, 0, 0, *carla], float)))
        assert pytest.approx(np.array(columns), abs=1e-12) == matrix.T


@given(POSES)
def test_quaternions_equal_matrices(place: np.ndarray) -> None:
    assert rotations(place) == pytest.approx(matrix_of(quaternions(place)), abs=1e-12)


def test_attached() -> None:
    """A camera 2 m ahead of a car and 1 m to its right, looking right; the car looks along y."""
    car = np.array([1000.0, 2000, 0, 0, 0, 90])
    assert attach(car, np.array([200.0, 100, 50, 0, 0, 90])) == pytest.approx([900, 2200, 50, 0, 0, 180])
    assert attach(car, np.array([0.0, 0, 0, 0, 30, 0])) == pytest.approx([1000, 2000, 0, 0, 30, 90])


@given(POSES, POSES)
def test_attached_poses_rotate_with_the_parent(parent: np.ndarray, relative: np.ndarray) -> None:
    world = rotations(right_handed(attach(parent, relative)))
    expected = rotations(right_handed(parent)) @ rotations(right_handed(relative))
    assert world == pytest.approx(expected, abs=1e-5)


@given(POSES, POSES)
def test_detach_inverts_attach(parent: np.ndarray, child: np.ndarray) -> None:
    again = attach(parent, detach(parent, child))
    assert again[:3] == pytest.approx(child[:3], abs=1e-3)
    assert rotations(right_handed(again)) == pytest.approx(rotations(right_handed(child)), abs=1e-5)
