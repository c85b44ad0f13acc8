"""Pairs of actors: which are near each other, and which are on one level; and where an actor is that is off its box."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn
from carla_recap.queries.measures.motion_table import MotionTable
from carla_recap.queries.measures.pairs import ELEMENTS, PairFrames, near_pairs


def table_of(x, y=0.0, z=0.0, heights=1.0, parents=(), offset=(0.0, 0.0, 0.0), yaw=0.0, is_vehicle=True):
    """Return a table of one actor for each x, whose other numbers are the same for all or one for each; three frames."""
    count, frames = len(x), 3

    def rows(values):
        return np.repeat(np.broadcast_to(np.asarray(values, float), count)[:, None], frames, axis=1)

    ids = np.arange(1, count + 1)
    lives = tuple(
        ActorLife(id, "", "vehicle" if vehicle else "walker", "", 0.0, parent=dict(parents).get(id), spawn=Spawn(id))
        for id, vehicle in zip(ids.tolist(), np.broadcast_to(is_vehicle, count), strict=True)
    )
    return MotionTable(
        first=0,
        last=frames,
        time=np.arange(frames) / 20,
        actors=lives,
        x=rows(x),
        y=rows(y),
        z=rows(z),
        yaw=rows(yaw),
        vx=rows(0.0),
        vy=rows(0.0),
        length=np.full(count, 4.0),
        width=np.full(count, 2.0),
        height=np.broadcast_to(np.asarray(heights, float), count),
        offset=np.broadcast_to(np.asarray(offset, float), (count, 3)),
    )


def pairs_of(table, reach, subjects=True):
    found = near_pairs(table, np.broadcast_to(subjects, len(table.ids)), np.full(len(table.ids), reach))
    return {tuple(sorted(pair)) for each in found for pair in zip(each.one.tolist(), each.other.tolist(), strict=True)}


@pytest.mark.parametrize(("dz", "count"), [(2.5, 3), (2.51, 0), (-2.5, 3), (-2.51, 0)])
def test_boxes_are_on_one_level_up_to_half_a_metre_between_them(dz, count):
    table = table_of([0, 5], z=[0, dz], heights=[1, 3])
    assert len(PairFrames.of(table, np.zeros(3, int), np.ones(3, int), np.arange(3)).frame) == count


@pytest.mark.parametrize(("distance", "are_near"), [(20.0, True), (20.1, False)])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_actors_are_near_if_their_reaches_meet(axis, distance, are_near):
    table = table_of([0, distance if axis == "x" else 0], y=[0, distance if axis == "y" else 0])
    assert pairs_of(table, 10.0) == ({(0, 1)} if are_near else set())


def test_memory_does_not_grow_with_the_square_of_the_actors():
    """One actor in 4 is a subject; each is near its neighbours alone."""
    table = table_of(100.0 * np.arange(3000))
    subjects = np.arange(3000) % 4 == 0
    tracemalloc.start()
    found = list(near_pairs(table, subjects, np.full(3000, 60.0)))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    pairs = {pair for part in found for pair in zip(part.one.tolist(), part.other.tolist(), strict=True)}
    assert pairs == {(one, one + 1) for one in range(2999) if one % 4 in (0, 3)}
    assert most < 5 * ELEMENTS


def test_pairs_have_a_subject_and_a_vehicle_and_no_one_is_attached():
    table = table_of([0, 1, 2], parents=[(3, 1)], is_vehicle=[True, True, False])
    assert pairs_of(table, 10.0) == {(0, 1), (1, 2)}
    assert pairs_of(table, 10.0, subjects=[True, False, False]) == {(0, 1)}
    assert pairs_of(table_of([0, 1], is_vehicle=False), 10.0) == set()


@pytest.mark.parametrize(("distance", "seconds"), [(50.0, 4.6), (103.9, 9.99), (104.1, np.inf)])
def test_times_to_collision_are_known_up_to_a_horizon(distance, seconds):
    """Boxes of 4 m length close up at 10 m/s."""
    table = table_of([0, distance])
    table = replace(table, vx=np.stack([np.full(3, 10.0), np.zeros(3)]))
    pairs = PairFrames.of(table, np.zeros(3, int), np.ones(3, int), np.arange(3))
    for each in (pairs, pairs.turned()):
        _, times = each.colliding(10.0)
        assert times.tolist() == ([pytest.approx(seconds)] * 3 if seconds < np.inf else [])
