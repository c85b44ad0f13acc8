from __future__ import annotations

import os
import shutil
import warnings
from functools import partial

import pytest

from carla_recap import Closed, RecapError, RecapWarning, Recording, map_recordings, open_recordings
from carla_recap.fleet.answers import answers
from carla_recap.fleet.engine import map_sources, processors
from carla_recap.fleet.sources import SourceFile, find_sources
from carla_recap.queries.info import info
from tests.cli.command import CROSSING
from tests.waiting import PATIENCE


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


@pytest.mark.parametrize(
    ("source", "jobs", "here"),
    [
        (SourceFile("a"), 1, True),
        (SourceFile("a"), 2, False),
        (SourceFile("a"), None, True),  # as it is small
        (SourceFile("a", size=1 << 30), None, False),
    ],
)
def test_few_and_small_recordings_are_read_in_this_process(monkeypatch, source, jobs, here):
    monkeypatch.setattr("carla_recap.fleet.engine._PATIENCE", PATIENCE)
    monkeypatch.setattr("carla_recap.fleet.engine.processors", lambda: 2)
    assert (next(map_sources(process, [source], jobs=jobs)).value == os.getpid()) == here


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
    for source in (runs / "a.log", f"{runs}/c.*"):  # one source needs no list
        for recording in open_recordings(source):
            assert recording.collisions()
            seen.append(recording)
    seen += open_recordings([runs / "a.log", runs / "c.mcap"])
    assert [recording.path.name for recording in seen] == ["a.log", "c.mcap"] * 2
    for recording in seen:
        with pytest.raises(Closed):
            recording.collisions()


@pytest.mark.parametrize(("sources", "said"), [("", r"b\.log.* is not a recording"), ("/*.json", "no recordings")])
def test_what_cannot_be_opened_is_an_error_or_a_warning(runs, sources, said):
    with pytest.raises(RecapError, match=said):
        list(open_recordings(f"{runs}{sources}"))
    with pytest.warns(RecapWarning, match=said):
        found = [recording.path.name for recording in open_recordings(f"{runs}{sources}", errors="warn")]
    assert found == ([] if sources else ["a.log", "c.mcap"])


def test_a_method_is_called_for_each_recording(runs):
    first, broken, last = map_recordings(Recording.collisions, runs, jobs=2)
    assert [len(first.value), broken.value, len(last.value)] == [2, None, 2]
    assert broken.error == f"{runs / 'b.log'}: is not a recording (neither CARLA's log nor MCAP)"
    assert (first.source.location, first.error) == (str(runs / "a.log"), None)


def warned(reader):
    warnings.warn("an odd frame", RecapWarning, stacklevel=1)
    return info(reader, all=True)


@pytest.mark.parametrize("most", [0, 1 << 20])
def test_answers_have_their_warnings_however_long_they_are(monkeypatch, most):
    monkeypatch.setattr("carla_recap.fleet.answers._MOST", most)
    (found,) = answers(warned, "json", find_sources([CROSSING]), jobs=1)
    assert len(list(found.pieces)) == found.rows > 0
    assert found.warnings == ("an odd frame",)
