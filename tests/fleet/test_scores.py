"""Scores of many recordings, and limits of them."""

from __future__ import annotations

import pytest

from carla_recap import RecapError, Score, open_recording, read_routes, score
from carla_recap.fleet.outcomes import Outcome
from carla_recap.fleet.scores import ScoreLimits, checked
from carla_recap.fleet.sources import find_sources
from tests.samples import CRASH, SAMPLES

ROUTES = SAMPLES / "routes.xml"


def of_crash(**options: str) -> Score:
    with open_recording(CRASH) as recording:
        return score(recording, ROUTES, route_id="1", **options)


def test_a_recording_is_scored_by_a_file_a_route_or_without_one() -> None:
    found = of_crash()
    assert (found.status, found.score, found.completion, found.penalty) == ("Completed", 30.0, 100.0, 0.3)
    assert [(each.kind, each.time) for each in found.infractions] == [
        ("collisions_pedestrian", pytest.approx(12.1)),
        ("collisions_vehicle", pytest.approx(15.15)),
    ]
    with open_recording(CRASH) as recording:
        assert score(recording, read_routes(ROUTES)[0]) == found
        own = score(recording)
    assert (own.route, own.status, own.penalty) == ("", "Driven", 0.3)


def test_a_vehicle_that_is_not_there_is_an_error() -> None:
    with open_recording(CRASH) as recording, pytest.raises(RecapError, match="no vehicle 99999"):
        score(recording, actor=99999)


def outcome(value: Score | None = None, error: str | None = None) -> Outcome[Score]:
    (source,) = find_sources([str(CRASH)])
    return Outcome(source, value, error)


def test_limits_give_verdicts() -> None:
    found = of_crash()
    limits = ScoreLimits(score=50, completion=90, infractions=1, of_kind={"collisions_pedestrian": 0, "red_light": 0})
    verdicts = checked(outcome(found), limits).verdicts
    assert [(each.rule, each.status) for each in verdicts] == [
        ("score", "fail"),
        ("completion", "pass"),
        ("infractions", "fail"),
        ("collisions_pedestrian", "fail"),
        ("red_light", "pass"),
    ]
    assert verdicts[0].message == "score 30.00, at least 50 was expected; Completed"
    assert (verdicts[3].time, verdicts[3].actors) == (pytest.approx(12.1), (44,))
    assert len(verdicts[2].details) == 2


def test_a_recording_that_cannot_be_scored_has_errors() -> None:
    found = checked(outcome(error=f"{CRASH}: is damaged"), ScoreLimits(score=50, of_kind={"red_light": 0}))
    assert [(each.rule, each.status, each.message) for each in found.verdicts] == [
        ("score", "error", "is damaged"),
        ("red_light", "error", "is damaged"),
    ]
    assert found.status == "error"


def test_an_unknown_kind_is_an_error() -> None:
    with pytest.raises(RecapError, match="'speeding' is no kind of infraction; there are collisions_pedestrian, "):
        ScoreLimits(of_kind={"speeding": 0})
    assert not ScoreLimits()
