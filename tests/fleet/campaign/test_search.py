"""Searches: an optimizer proposes parameters, and gets the results."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from carla_recap.fleet.campaign import FinishedRun
from carla_recap.fleet.campaign.plan import ParameterRange
from carla_recap.fleet.campaign.results import COLLISIONS, Result
from carla_recap.fleet.campaign.runs import RunReport
from carla_recap.fleet.campaign.search import search

pytest.importorskip("optuna", reason="the extra `search` is not installed")


@dataclass
class Formula:
    """A campaign without simulations: its results are values of a function of the parameters."""

    function: Any
    location: str = "runs"
    ahead: int = 1
    asked: list[Any] = field(default_factory=list)

    @property
    def folder(self):
        return self

    def run(self, runs):
        runs = iter(runs)
        waiting = []
        while True:
            waiting += [run for _, run in zip(range(self.ahead - len(waiting)), runs, strict=False)]
            if not waiting:
                return
            run = waiting.pop(0)
            self.asked.append(run)
            yield FinishedRun(run, self._report(run))

    def _report(self, run):
        value = self.function(**run.parameters)
        if value == "fails":
            return RunReport(error="failed")
        return RunReport(results={} if value is None else {COLLISIONS.name: Result(value)})


RANGES = {"x": ParameterRange(-5.0, 5.0), "y": ParameterRange(0, 10), "kind": ("a", "b")}


def bowl(x, y, kind):
    if kind == "b" and y > 8:
        return "fails"
    if x > 4:
        return None
    return (x - 1) ** 2 + (y - 3) ** 2 + (kind == "b") * 10


@pytest.mark.parametrize("ahead", [1, 4])
def test_a_search_finds_small_values(ahead):
    found = list(search(Formula(bowl, ahead=ahead), [1, 2], RANGES, COLLISIONS, 80))
    values = [each.report.results[COLLISIONS.name].value for each in found if each.report.results]
    assert len(found) == 80
    assert min(values) < 0.5
    assert sorted(values[:20])[10] > sorted(values[-20:])[10]
    assert [each.run.seed for each in found[:4]] == [1, 2, 1, 2]


def test_a_search_finds_great_values():
    found = list(search(Formula(lambda x: -abs(x - 2)), [1], {"x": RANGES["x"]}, COLLISIONS, 40, is_maximized=True))
    assert max(each.report.results[COLLISIONS.name].value for each in found) > -0.2


@pytest.mark.parametrize(("low", "high"), [(0.123456, 0.123511), (1e6, 1e6 + 1), (-2 / 3, 1 / 3), (1.0, 2e9)])
def test_values_are_in_their_range_and_differ(low, high):
    found = list(search(Formula(lambda x: x), [1], {"x": ParameterRange(low, high)}, COLLISIONS, 30))
    values = [each.run.parameters["x"] for each in found]
    assert low <= min(values) < max(values) <= high
    assert len(set(values)) == 30


def test_values_of_a_list_are_as_they_are_given():
    ranges = {"x": ParameterRange(-5.0, 5.0), "gap": (9.123456, 12.5)}
    found = list(search(Formula(lambda x, gap: x), [1], ranges, COLLISIONS, 20))
    assert {each.run.parameters["gap"] for each in found} == {9.123456, 12.5}


def test_a_search_repeats_itself_and_no_run():
    one, two = (list(search(Formula(bowl), [1], RANGES, COLLISIONS, 30)) for _ in range(2))
    assert [each.run for each in one] == [each.run for each in two]
    assert len({each.run.name for each in one}) == 30


def test_a_search_ends_when_all_values_have_been_tried():
    found = list(search(Formula(lambda y: float(y)), [1], {"y": ParameterRange(1, 4)}, COLLISIONS, 10))
    assert sorted(each.run.parameters["y"] for each in found) == [1, 2, 3, 4]
