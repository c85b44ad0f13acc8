"""The files of an incident page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from carla_recap import RecapError, open_recording
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.show.page import Opening, samples, write_report
from carla_recap.town.mesh import load_town_of
from tests.replay.scripts import pose, spawn
from tests.samples import CROSSING
from tests.show.page.conftest import WITHOUT_ROADS, data, lying, marks, record, report


def test_the_summary_is_that_of_the_recording(crossing_page: Path) -> None:
    summary = data(crossing_page, "report")
    assert (summary["source"], summary["map"], summary["frames"]) == ("crossing.log", "Crossing", 531)
    assert (summary["duration"], summary["version"], summary["whole"], summary["follow"]) == (53.0, 1, True, 100)
    assert summary["date"] == "2026-01-01T10:00:00+00:00"
    assert [kind[:2] for kind in summary["kinds"]] == [
        ["vehicle", 6],
        ["walker", 2],
        ["traffic light", 4],
        ["sensor", 2],
        ["other", 3],
    ]


def test_the_summary_of_the_call(tmp_path: Path) -> None:
    with open_recording(CROSSING) as recording:
        written = write_report(recording, tmp_path / "page", WITHOUT_ROADS, pictures="none")
    assert written._replace(size=0) == (tmp_path / "page", 4, True, 53.0, 0, 0)
    assert written.size == sum(file.stat().st_size for file in (tmp_path / "page").rglob("*") if file.is_file())
    assert not data(tmp_path / "page", "report")["drawn"]


def test_without_roads_those_of_the_map_of_the_recording_are_shown(tmp_path: Path) -> None:
    with open_recording(CROSSING.with_name("crash.mcap")) as recording:
        write_report(recording, tmp_path / "found.html", pictures="none")
        write_report(recording, tmp_path / "given.html", pictures="none", town=load_town_of(recording))
    found, given = (data(tmp_path / f"{name}.html", "ground")["surfaces"]["lengths"] for name in ("found", "given"))
    assert len(found) > 10
    assert found.tolist() == given.tolist()


def test_without_a_time_a_page_opens_at_the_last_incident(tmp_path: Path) -> None:
    summary = data(report(CROSSING, tmp_path / "page.html", opening=Opening()), "report")
    last = summary["incidents"][-1]
    assert summary["opening"] == {"time": last["start"], "actors": last["actors"], "notes": []}


def test_a_long_recording_is_replayed_around_its_incidents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "BUDGET", 15_000)
    report(CROSSING, tmp_path / "page", before=2, after=1)
    summary, recording = data(tmp_path / "page", "report"), data(tmp_path / "page", "recording")
    assert not summary["whole"]
    assert recording["spans"] == [[12.1, 15.1], [18.9, 25.6]]
    for incident in summary["incidents"]:
        assert any(start <= incident["start"] <= stop for start, stop in recording["spans"])


def test_who_was_knocked_down_before_an_interval_lies_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames: list[dict[str, Any]] = [
        {"transforms": [pose(1, 50 * min(n, 4)), pose(2, 200, z=93), pose(3, 0, 900), pose(4, 0, 1200)]} for n in range(300)
    ]
    frames[0]["spawned"] = [spawn(1), spawn(2, "walker.pedestrian.0001", yaw=90), spawn(3), spawn(4)]
    frames[4]["collisions"], frames[290]["collisions"] = [(0, 1, 2, False, False)], [(1, 3, 4, False, False)]
    monkeypatch.setattr(samples, "BUDGET", 2_000)
    source = record(tmp_path / "a.log", frames, tick=0.1)
    with open_recording(source) as recording:
        found = incidents(recording.reader, IncidentOptions(kinds=["collision"]))
        replay, whole = samples.sample(recording, found[1:], 1.0, 0.5, None)
    assert (whole, replay.spans) == (False, [(pytest.approx(28.0), pytest.approx(29.5))])
    assert lying(replay, 28.5) == {2: 0}
    assert len(marks(replay, 28.5)) == 0
    assert len(marks(replay, 29.2)) == 1


def test_incidents_beyond_the_budget_are_listed_without_a_replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "BUDGET", 5_000)
    report(CROSSING, tmp_path / "page", before=2, after=1)
    page = tmp_path / "page"
    listed, spans = data(page, "report")["incidents"], data(page, "recording")["spans"]
    assert [any(start <= one["start"] <= stop for start, stop in spans) for one in listed] == [True, False, False, False]


@pytest.mark.parametrize("span", [{"before": -1}, {"after": float("nan")}])
def test_invalid_times_are_refused(tmp_path: Path, span: dict[str, float]) -> None:
    with pytest.raises(RecapError, match="0 or more were expected"):
        report(CROSSING, tmp_path / "page", **span)
