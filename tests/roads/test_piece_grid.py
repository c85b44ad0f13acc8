"""The squares in which lanes are looked for: with a table of all squares, and without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carla_recap.roads import find_road_network, network


def test_lanes_are_the_same_without_a_table_of_all_squares(monkeypatch):
    rng = np.random.default_rng(1)
    points = np.append(rng.uniform(-400, 400, (2_000, 2)), [[1e6, 1e6], [-1e6, -1e6], [1e6, 0]], axis=0)
    points = np.column_stack((points, np.zeros(len(points))))
    roads = find_road_network("Brickfield")
    expected = replace(roads).lanes_at(points)
    monkeypatch.setattr(network, "_MOST_CELLS", 0)
    found = replace(roads).lanes_at(points)
    assert (found.lane >= 0).any()
    for name in ("lane", "offset", "outside"):
        assert np.array_equal(getattr(found, name), getattr(expected, name), equal_nan=True)
