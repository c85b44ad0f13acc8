"""What is see-through."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.replay.pose import rotations
from carla_recap.scene.opacity import IN_THE_WAY, SEE_THROUGH, SeenBoxes, is_flat, is_near, wanted_opacities

CAR, TRUCK, WALKER = (2.1, 1.0, 0.7), (4.0, 1.2, 1.5), (0.2, 0.2, 0.9)


def opacities(*others: tuple[tuple[float, float, float], tuple[float, float, float]]) -> tuple[float, list[float]]:
    """Return the opacity of a car 10 m before a camera, and those of others, given as centres and half sizes."""
    own = SeenBoxes(np.array([(0, 0, CAR[2])]), np.eye(3)[None], np.array([CAR]))
    centres, halves = (np.array(column, np.float64).reshape(-1, 3) for column in zip(*others, strict=True))
    boxes = SeenBoxes(centres, np.tile(np.eye(3), (len(others), 1, 1)), halves)
    eye, looking = np.array([(-10.0, 0, 5)]), rotations(np.array([(0.0, 0, 0, 0, 17, 0)]))
    opacity, other_opacity = wanted_opacities(eye, looking, own, boxes, np.zeros(len(others), np.intp))
    return float(opacity[0]), other_opacity.tolist()


BUS = (3.0, 1.3, 2.0)


@pytest.mark.parametrize(
    ("others", "own", "expected"),
    [
        ([((30, 0, 0.7), CAR), ((0, 3.5, 0.7), CAR), ((-30, 0, 0.7), CAR)], 1, [1, 1, 1]),
        ([((2.9, 0, 0.9), WALKER)], SEE_THROUGH, [1]),  # it hides half of another
        ([((4, 0, 0.9), WALKER)], 1, [1]),  # and less
        ([((-6.0, 0, 1.5), TRUCK)], 1, [IN_THE_WAY]),  # it covers the followed actor
        *([[((x, 0, 4.0), BUS)], 1, [IN_THE_WAY]] for x in (-9.0, -10.0, -12.0)),  # the camera is inside
        ([((-10.0, 1.5, 4.0), BUS)], 1, [IN_THE_WAY]),
        *([[((-10.0, aside, 4.0), BUS)], 1, [1]] for aside in (1.7, 4.0)),
        ([((-6.0, 0, 1.5), (0.05, 0.05, 1.5))], 1, [1]),  # it covers little
    ],
)
def test_what_is_see_through(others: list, own: float, expected: list[float]) -> None:
    assert opacities(*others) == (own, expected)


def test_flat_and_far_boxes_do_not_matter() -> None:
    assert is_flat(np.array([(1, 1, 0.149), (1, 1, 0.151)])).tolist() == [True, False]
    places = np.array([(59.0, 0, 0), (61, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)])
    assert is_near(places, np.zeros(3)).tolist() == [True, False, False, False]
