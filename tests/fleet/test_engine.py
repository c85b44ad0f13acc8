from __future__ import annotations

import gc
import os
import shutil
from functools import partial

import pytest

from carla_recap import Closed, NotARecording, RecapError, RecapWarning, Recording, map_recordings, open_recordings
from carla_recap.fleet.engine import map_sources, processors
from carla_recap.fleet.sources import SourceFile
from tests.cli.command import CROSSING


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


CRASH = CROSSING.with_name("crash.mcap")


@pytest.fixture
def runs(tmp_path):
    shutil.copy(CROSSING, tmp_path / "a.log")
    (tmp_path / "b.log").write_bytes(b"junk")
    shutil.copy(CRASH, tmp_path / "c.mcap")
    return tmp_path


def test_recordings_are_open_one_after_another(runs):
    seen = []
    for recording in open_recordings([runs / "a.log", runs / "c.mcap"]):
        assert recording.collisions()
        seen.append(recording)
    assert [recording.path.name for recording in seen] == ["a.log", "c.mcap"]
    for recording in seen:
        with pytest.raises(Closed):
            recording.collisions()


def test_one_source_needs_no_list(runs):
    for source in (runs / "c.mcap", f"{runs}/c.*", str(runs / "c.mcap")):
        assert [recording.path.name for recording in open_recordings(source)] == ["c.mcap"]


def test_an_iteration_that_ends_early_closes_the_recording(runs):
    recordings = open_recordings(runs)
    recording = next(iter(recordings))
    del recordings
    gc.collect()
    with pytest.raises(Closed):
        recording.collisions()


def test_a_broken_recording_is_an_error(runs):
    with pytest.raises(NotARecording, match=r"b\.log"):
        list(open_recordings(runs))


def test_a_broken_recording_is_a_warning_if_wanted(runs):
    with pytest.warns(RecapWarning, match=r"b\.log.* is not a recording"):
        assert [recording.path.name for recording in open_recordings(runs, errors="warn")] == ["a.log", "c.mcap"]


def test_a_source_without_recordings(runs):
    with pytest.raises(RecapError, match="no recordings"):
        list(open_recordings(f"{runs}/*.json"))
    with pytest.warns(RecapWarning, match="no recordings"):
        assert not list(open_recordings(f"{runs}/*.json", errors="warn"))


def test_a_method_is_called_for_each_recording(runs):
    first, broken, last = map_recordings(Recording.collisions, runs, jobs=2)
    assert [len(first.value), broken.value, len(last.value)] == [2, None, 2]
    assert broken.error == f"{runs / 'b.log'}: is not a recording (neither CARLA's log nor MCAP)"
    assert (first.source.location, first.error) == (str(runs / "a.log"), None)
