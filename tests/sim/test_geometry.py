from __future__ import annotations

import itertools

import numpy as np
import pytest

from carla_recap.replay.pose import attach
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.recording.packets import pose, transform


def near(place: Location | Vector, x: float, y: float, z: float) -> bool:
    return (place.x, place.y, place.z) == pytest.approx((x, y, z), abs=1e-9)


def test_a_transform_agrees_with_carla() -> None:
    carla = pytest.importorskip("carla", reason="CARLA's client library is not installed")
    theirs = carla.Transform(carla.Location(1, 2, 3), carla.Rotation(pitch=20, yaw=50, roll=-35))
    place, ahead = theirs.transform(carla.Location(4, 5, 6)), theirs.get_forward_vector()
    ours = Transform(Location(1, 2, 3), Rotation(pitch=20, yaw=50, roll=-35))
    moved, forward = ours.transform(Location(4, 5, 6)), ours.forward()
    assert (moved.x, moved.y, moved.z) == pytest.approx((place.x, place.y, place.z), abs=1e-5)
    assert (forward.x, forward.y, forward.z) == pytest.approx((ahead.x, ahead.y, ahead.z), abs=1e-6)


def test_an_attached_transform_is_that_of_a_replay() -> None:
    random = np.random.default_rng(1)
    upright = [(90.0, 30.0, 0.0), (-90.0, 10.0, 40.0), (0.0, 0.0, 0.0)]
    turns = [tuple(turn) for turn in random.uniform((-90, -180, -180), (90, 180, 180), (50, 3)).tolist()] + upright
    for one, other in itertools.product(turns[-10:], turns):
        parent, relative = Transform(Location(1, 2, 3), Rotation(*one)), Transform(Location(4, -5, 6), Rotation(*other))
        expected = transform(attach(np.array(pose(parent)), np.array(pose(relative))))
        found = parent.attached(relative)
        assert near(found.location, expected.location.x, expected.location.y, expected.location.z)
        assert np.array(found.rotation.matrix()) == pytest.approx(np.array(expected.rotation.matrix()), abs=1e-6)
