"""Lanes of states: of incidents, and of verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap import Verdict
from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.incidents import Incident
from carla_recap.scene.state_lanes import incident_lanes, verdict_lanes

ELAPSED = np.array([10.0, 10.1, 10.2, 10.3, 10.4])


def stop(start: float, end: float, actor: int) -> Incident:
    where = float("nan")
    return Incident("blocked", start, end, (actor,), ("",), where, where, where, "duration", 1.0, "s", 1.0, start, "")


def test_a_lane_of_incidents_says_to_whom_they_happen() -> None:
    found = [stop(9.0, 10.2, 7), stop(10.1, 10.15, 5), stop(10.1, 10.1, 7), stop(8.0, 9.0, 3), stop(10.4, 12.0, 5)]
    (lane,) = incident_lanes(found, ELAPSED)
    assert (lane.name, lane.states) == (
        "blocked",
        [(0, "long stop: 7"), (1, "long stop: 5, 7"), (2, "long stop: 7"), (3, "none"), (4, "long stop: 5")],
    )
    assert incident_lanes([stop(11.0, 12.0, 4)], ELAPSED) == []
    about = SAME_TIME / 2  # by which times differ that are the same
    (lane,) = incident_lanes([stop(9.0, 10.0 - about, 3), stop(10.2 + about, 10.3 - about, 7)], ELAPSED)
    assert lane.states == [(0, "long stop: 3"), (1, "none"), (2, "long stop: 7"), (4, "none")]


@pytest.mark.parametrize(
    ("status", "time", "expected"),
    [
        ("pass", None, [(0, "pass")]),
        ("fail", None, [(0, "fail: why")]),
        ("fail", 9.0, [(0, "fail: why")]),
        ("fail", 10.2, [(0, "pass"), (2, "fail: why")]),
        ("error", None, [(0, "error: why")]),
        ("fail", 11.0, [(0, "pass")]),
    ],
)
def test_a_lane_of_a_rule_says_from_when_on_it_is_broken(status, time, expected) -> None:
    (lane,) = verdict_lanes([Verdict("slow", status, "why", time)], ELAPSED)
    assert (lane.name, lane.states) == ("slow", expected)
