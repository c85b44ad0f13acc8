"""The command that compares two recordings."""

from __future__ import annotations

import json
import re

import pytest

from carla_recap import clip
from tests.cli.command import answer, error, on_terminal, run
from tests.samples import SAMPLES

CRASH, BLOCKED, JUNCTION = (SAMPLES / f"{name}.mcap" for name in ("crash", "blocked", "junction"))


def test_recordings_that_differ():
    done = run("diff", CRASH, BLOCKED)
    assert (done.returncode, done.stderr) == (1, b"")
    printed = done.stdout.decode()
    lines = printed.splitlines()
    assert lines[0] == "the paths differ from 0.00 s on: vehicle.tesla.model3 (hero, 41, 42) by 28.00 m"
    assert lines[2:4] == ["7 actors only in A", "7 actors only in B"]
    listed = [block.splitlines()[0] for block in printed.split("\n\n")[1:]]
    assert listed == [
        "Actors that differ, in m, s and degrees",
        "Actors only in A",
        "Actors only in B",
        "Events that differ, in s",
    ]
    assert "vehicle.tesla.model3 (hero)" in printed


def test_a_tolerance_may_make_them_equal(tmp_path):
    clip(CRASH, tmp_path / "most.mcap", start=0.0, duration=59.5)
    assert run("diff", CRASH, tmp_path / "most.mcap").returncode == 1
    assert answer("diff", CRASH, tmp_path / "most.mcap", "--tolerance", 0.1).startswith("equal within 0.1 m\n")
    done = run("diff", CRASH, tmp_path / "most.mcap", "--tolerance", 0.1, "--time-tolerance", 0.1)
    assert done.returncode == 1


def test_json():
    done = run("diff", CRASH, BLOCKED, "--json", "--no-events")
    found = json.loads(done.stdout)
    assert done.returncode == 1
    assert found["equal"] is False
    assert found["first"]["id_a"] == 41
    assert found["actors"][0]["max"] == pytest.approx(73.0, abs=0.01)
    assert any(row["mean"] is None for row in found["actors"])
    assert found["events"] == []
    assert [len(found[name]) for name in ("missing", "extra", "lights")] == [7, 7, 17]
    assert found["a"]["map_name"] == "Brickfield"


def test_a_table_on_a_terminal():
    code, shown, other = on_terminal("diff", CRASH, BLOCKED)
    assert (code, other) == (1, b"")
    assert "Actors that differ" in shown
    assert all(len(re.sub("\x1b[^m]*m", "", line)) <= 120 for line in shown.splitlines())


def test_a_page_and_an_rrd(tmp_path):
    clip(CRASH, tmp_path / "b.mcap", start=0.0, duration=10.0)
    done = run("diff", CRASH, tmp_path / "b.mcap", "--html", tmp_path / "page.html", "--no-events")
    assert done.returncode == 1
    assert done.stdout.startswith(b"1200 frames in 59.95 s, and 201 in 10.00 s\n")
    assert b"page.html: " in done.stderr
    assert "<html" in (tmp_path / "page.html").read_text("utf-8")
    assert "page.html: exists" in error("diff", CRASH, tmp_path / "b.mcap", "--html", tmp_path / "page.html")
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    done = run("diff", CRASH, tmp_path / "b.mcap", "--rrd", tmp_path / "both.rrd", "--no-events")
    assert done.returncode == 1
    assert (tmp_path / "both.rrd").stat().st_size > 100_000


@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
def test_ghosts_never_overwrite_what_is_compared(tmp_path, names):
    for name in names:
        (tmp_path / f"{name}.mcap").write_bytes(CRASH.read_bytes())
    first, second = (tmp_path / f"{name}.mcap" for name in names)
    said = error("diff", first, second, "--rrd", tmp_path / "b.mcap", "--force")
    assert said.endswith("b.mcap: is the source itself")
    assert (tmp_path / "b.mcap").read_bytes() == CRASH.read_bytes()
