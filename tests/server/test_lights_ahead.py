from __future__ import annotations

from dataclasses import replace

import numpy as np

from carla_recap.server.snapshots import NO_LIGHT, LightsAhead
from tests.sim.flat import LENGTH, flat_town, lane, light


def test_of_two_lights_ahead_the_nearer_one_counts() -> None:
    near, far = light(0, (0,)), replace(light(1, (0,)), stops=((0, 101.0),))  # stop lines at 95 m and 101 m
    for signals, rows in (([near, far], [0, 1]), ([far, near], [1, 0])):
        found = LightsAhead(flat_town(signals=signals)).at(np.zeros(5, np.int64), np.array([80.0, 84.0, 90.0, 96.0, 102.0]))
        assert found.tolist() == [NO_LIGHT, rows[0], rows[0], rows[1], NO_LIGHT]


def test_that_holds_on_the_lane_before() -> None:
    lanes = [replace(lane(), successors=(1,), predecessors=()), replace(lane(1), successors=(), predecessors=(0,))]
    near, far = replace(light(0, ()), stops=((1, 3.0),)), replace(light(1, ()), stops=((1, 7.0),))
    for signals, rows in (([near, far], [0, 1]), ([far, near], [1, 0])):
        ahead = LightsAhead(flat_town(lanes=lanes, signals=signals))
        found = ahead.at(np.array([0, 0, 0, 1, 1]), np.array([LENGTH - 10, LENGTH - 8, LENGTH - 4, 1, 5]))
        assert found.tolist() == [NO_LIGHT, rows[0], rows[0], rows[0], rows[1]]
