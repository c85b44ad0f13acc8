from __future__ import annotations

import os
from functools import partial

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.engine import map_sources, processors
from carla_recap.fleet.sources import SourceFile


def length(source: SourceFile, least: int) -> int:
    if len(source.location) < least:
        raise RecapError(f"{source.location}: is short")
    return len(source.location)


def process(_: SourceFile) -> int:
    return os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_outcomes_come_in_order_and_errors_are_among_them(jobs):
    sources = [SourceFile("a" * (index % 7)) for index in range(40)]
    outcomes = list(map_sources(partial(length, least=2), sources, jobs=jobs))
    assert [outcome.source for outcome in outcomes] == sources
    assert [outcome.value for outcome in outcomes] == [n if (n := index % 7) >= 2 else None for index in range(40)]
    assert outcomes[0].error == ": is short"
    assert outcomes[2].error is None


def test_one_job_runs_in_this_process_and_several_do_not():
    source = SourceFile("a")
    assert next(map_sources(process, [source], jobs=1)).value == os.getpid()
    assert next(map_sources(process, [source], jobs=2)).value != os.getpid()


def test_thousands_of_jobs_are_no_thousands_of_processes(monkeypatch):
    given = []
    monkeypatch.setattr("carla_recap.fleet.workers.map_in_workers", lambda *arguments: given.append(arguments[-1]) or [])
    list(map_sources(process, [SourceFile("a", 1, None)], jobs=10**20))
    assert given == [max(32, 4 * processors())]
