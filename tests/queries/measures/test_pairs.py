"""Pairs of actors: which are near each other, and which are on one level; and where an actor is that is off its box."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from carla_recap.queries.measures.pairs import ELEMENTS, PairFrames, near_pairs
from tests.queries.measures.conftest import motion_table


def table_of(x, y=0.0, z=0.0, heights=1.0, parents=(), is_vehicle=True, vx=0.0):
    """Return a table of one actor for each x, whose other numbers are the same for all or one for each; three frames."""
    count = len(x)
    columns = (np.broadcast_to(np.asarray(values, float), count)[:, None] for values in (x, y, z, 0.0, vx))
    table = motion_table(np.arange(3) / 20, *columns)
    kinds = ["vehicle" if vehicle else "walker" for vehicle in np.broadcast_to(is_vehicle, count)]
    lives = zip(table.actors, kinds, strict=True)
    actors = tuple(replace(life, kind=kind, parent=dict(parents).get(life.id)) for life, kind in lives)
    return replace(table, actors=actors, height=np.broadcast_to(np.asarray(heights, float), count))


def pairs_of(table, reach, subjects=True):
    found = near_pairs(table, np.broadcast_to(subjects, len(table.ids)), np.full(len(table.ids), reach))
    return {tuple(sorted(pair)) for each in found for pair in zip(each.one.tolist(), each.other.tolist(), strict=True)}


@pytest.mark.parametrize(("dz", "count"), [(2.5, 3), (2.51, 0), (-2.5, 3), (-2.51, 0)])
def test_boxes_are_on_one_level_up_to_half_a_metre_between_them(dz, count):
    table = table_of([0, 5], z=[0, dz], heights=[1, 3])
    assert len(PairFrames.of(table, np.zeros(3, int), np.ones(3, int), np.arange(3)).frame) == count


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
    table = table_of([0, distance], vx=[10.0, 0.0])
    pairs = PairFrames.of(table, np.zeros(3, int), np.ones(3, int), np.arange(3))
    for each in (pairs, pairs.turned()):
        _, times = each.colliding(10.0)
        assert times.tolist() == ([pytest.approx(seconds)] * 3 if seconds < np.inf else [])
