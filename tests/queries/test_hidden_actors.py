"""Actors that a scenario hides far below the ground until it needs them: no measure and no incident knows them meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap import IncidentOptions, check, open_recording
from carla_recap.queries.incidents import incidents
from carla_recap.queries.measures import measures, time_series
from carla_recap.roads.surfaces import build_network
from carla_recap.rules.rule_sets import parse_rules
from tests.replay.scripts import light, pose, spawn, write
from tests.roads.straight_road import STRAIGHT_ROAD

HERO, HIDDEN = 1, 2
SHOWN = 8.0  # s: when the hidden car is set on the road
TICK = 0.1  # s


@pytest.fixture(params=["lights", "no lights"])
def recording(request, tmp_path):
    """The hero drives past a car that is 499 m below the road, and is set on it later."""
    frames = []
    for number in range(120):
        below = number * TICK < SHOWN - TICK / 2
        frames.append({"transforms": [pose(HERO, 100 * number), pose(HIDDEN, 9000, 600, -49900 if below else 0)]})
        if request.param == "lights":
            frames[-1]["light_states"] = [light(9, 2)]
    frames[0]["spawned"] = [spawn(HERO, role_name="hero"), spawn(HIDDEN, x=9000)]
    if request.param == "lights":
        frames[0]["spawned"].append(spawn(9, "traffic.traffic_light", x=4000))
    with open_recording(write(tmp_path / "hidden.mcap", frames, tick=TICK)) as opened:
        yield opened


def test_a_car_below_the_road_is_near_nobody_does_not_stand_and_is_not_off_the_road(recording):
    series, own = (time_series(recording.reader, id) for id in (HERO, HIDDEN))
    hidden = series.time < SHOWN - TICK
    assert set(series.nearest[hidden].tolist()) == {-1}
    assert np.isinf(series.gap[hidden]).all()
    assert set(series.nearest[series.time > SHOWN + 0.6].tolist()) == {HIDDEN}
    assert own.time.min() > SHOWN - TICK
    assert incidents(recording.reader, IncidentOptions(kinds=["blocked"], min_time=5.0)) == []
    assert HIDDEN in [row.id for row in recording.blocked(min_time=5.0)]  # as CARLA's own query has it
    roads = build_network(STRAIGHT_ROAD, "Straight")
    (found,) = (row for row in measures(recording.reader, {HIDDEN}, roads=roads) if row.measure == "distance_off_road")
    assert found.time > SHOWN - TICK


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize(
    ("last", "count"),
    [
        ({}, 1),
        ({"transforms": [pose(HERO, 900), pose(HIDDEN, 9000, 600)]}, 2),
        # Another one with its id is on the road.
        (
            {
                "destroyed": [(HIDDEN,)],
                "spawned": [spawn(HIDDEN)],
                "transforms": [pose(HERO, 900), pose(HIDDEN, 9000)],
            },
            2,
        ),
    ],
)
def test_a_car_counts_for_rules_if_it_is_ever_on_the_road(tmp_path, suffix, last, count):
    frames = [{"transforms": [pose(HERO, 100 * number), pose(HIDDEN, 9000, 600, -49900)]} for number in range(9)]
    frames[0]["spawned"] = [spawn(HERO, role_name="hero"), spawn(HIDDEN, x=9000)]
    frames[-1] |= last
    rules = parse_rules(f'[rules.it]\nactors = {{ of = "vehicle", min = {count}, max = {count} }}', "rules.toml")
    with open_recording(write(tmp_path / f"hidden{suffix}", frames)) as opened:
        (found,) = check(opened, rules)
    assert found.status == "pass", found.message
