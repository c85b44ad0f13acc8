from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from carla_recap import create_recording, open_recording
from carla_recap.editing.convert import convert
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.records import Spawn
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.roads import RoadMap
from carla_recap.show.clips import IncidentClip, clips
from carla_recap.show.rerun import export as rrd
from tests.samples import CROSSING, images, names_in


def test_clips(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    written = clips(CROSSING, tmp_path / "clips", before=2.0, after=1.0)
    names = ["01-collision-20.9s-105-110", "02-collision-24.6s-100-101"]
    assert names_in(tmp_path / "clips") == sorted(name + suffix for name in names for suffix in (".mcap", ".rrd"))
    for found, name in zip(written, names, strict=True):
        assert (found.recording, found.rrd) == tuple(tmp_path / "clips" / (name + suffix) for suffix in (".mcap", ".rrd"))
    with open_recording(written[1].recording) as recording:
        assert recording.info.duration == pytest.approx(24.6 - 25.1 + 2 * 0.5 + 3.0)
        assert [row.elapsed for row in recording.collisions()] == [pytest.approx(2.0)]
    assert written[0].rrd is not None
    assert b".partial" not in written[0].rrd.read_bytes()


def test_clips_of_all_kinds(tmp_path: Path) -> None:
    written = clips(CROSSING, tmp_path, IncidentOptions(), before=0, after=0, suffix=".log", rerun=False)
    assert [found.recording.name for found in written] == names_in(tmp_path)
    assert [found.incident.kind for found in written] == ["blocked", "collision", "hard braking", "collision"]
    assert written[2].recording.name == "03-hard-braking-23.5s-100.log"
    assert all(found.rrd is None for found in written)
    with open_recording(written[1].recording) as recording:
        assert recording.info.duration == pytest.approx(0.8)


def test_a_clip_of_an_instant_has_one_frame(tmp_path: Path) -> None:
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        for second in range(5):
            recorder.add_frame(second, collisions=[(0, 1, 2, 0, 0)] if second == 2 else [])
    (found,) = clips(path, tmp_path / "clips", before=0, after=0, rerun=False)
    assert len(images(found.recording)) == 1


def test_more_incidents_than_the_limit_are_a_warning(tmp_path: Path) -> None:
    with pytest.warns(RecapWarning, match="only the first 1 of 2 incidents"):
        written = clips(CROSSING, tmp_path / "clips", limit=1, rerun=False)
    assert [type(found) for found in written] == [IncidentClip]


@pytest.mark.parametrize(
    ("late", "followed"),
    [
        ({4: {"destroyed": [1]}}, 2),  # before the clip
        ({40: {"destroyed": [1]}}, 1),
        ({0: {}, 42: {"spawned": [Spawn(1, 1, type_id="vehicle.a")]}}, 2),
        ({4: {"destroyed": [1, 2]}}, None),
    ],
)
def test_the_followed_actor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: dict[int, dict[str, Any]], followed: int | None
) -> None:
    """The first actor of the incident that is present; else the one that the player chooses."""
    pytest.importorskip("rerun")
    path, asked, roads = tmp_path / "own.log", [], RoadMap("Town01", [], [], [], [], [])

    def export(_: Any, destination: Path, *, follow: int | None, road_map: RoadMap, incidents: Any) -> None:
        assert road_map is roads
        asked.append(follow)
        destination.touch()

    monkeypatch.setattr(rrd, "export_rerun", export)
    cast = [Spawn(id, 1, type_id="vehicle.a") for id in ((2,) if 0 in late else (1, 2))]
    moments = {0: {"spawned": cast}, 40: {"collisions": [(0, 1, 2, 0, 0)]}}
    with create_recording(path, map_name="Town01", date=0) as recorder:
        for number in range(50):
            recorder.add_frame(number / 4, **moments.get(number, {}) | late.get(number, {}))
    clips(path, tmp_path / "clips", before=1.0, after=1.0, road_map=roads)
    assert asked == [followed]


def test_a_long_incident(tmp_path: Path) -> None:
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        for second in range(200):
            recorder.add_frame(second, spawned=[] if second else [Spawn(1, 1)], transforms=[(1, 5, 0, 0, 0, 0, 0)])
    (found,) = clips(path, tmp_path / "clips", IncidentOptions(kinds=["blocked"]), rerun=False, after=3)
    assert 60 <= len(images(found.recording)) <= 66


def test_clips_are_not_written_over_their_source(tmp_path: Path) -> None:
    source = tmp_path / "01-collision-20.9s-105-110.mcap"
    convert(CROSSING, source)
    content = source.read_bytes()
    with pytest.raises(RecapError, match="is the source itself"):
        clips(source, tmp_path, rerun=False, force=True)
    assert source.read_bytes() == content


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"before": -1.0}, "0 or more were expected"),
        ({"after": math.nan}, "0 or more were expected"),
        ({"suffix": ".txt"}, r"unknown format '\.txt'"),
    ],
)
def test_invalid_options_are_errors(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(RecapError, match=message):
        clips(CROSSING, tmp_path / "clips", rerun=False, **options)
    assert names_in(tmp_path) == []
