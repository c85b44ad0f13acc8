"""The command that checks recordings by rules."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from carla_recap import RecapWarning, recover
from carla_recap.cli.check import check
from carla_recap.errors import RecapError
from tests.cli.command import error, on_terminal, run, wrote
from tests.samples import SAMPLES, names_in, save

RULES = SAMPLES / "rules.toml"
ALONE = ("--jobs", "1")
"""Options that start no processes, which would import the package first."""


@pytest.fixture
def runs(tmp_path):
    """A folder with a recording that passes and one that fails."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for name in ("crash", "junction"):
        shutil.copy(SAMPLES / f"{name}.mcap", folder)
    return folder


def test_verdicts_are_printed_the_worst_first(runs):
    save(runs / "broken.mcap", b"nothing")
    done = run("check", runs, "--rules", RULES)
    lines = done.stdout.decode().splitlines()
    assert [(line.split()[0], Path(line.split()[1]).name) for line in lines[:-1]] == [
        ("error", "broken.mcap"),
        ("fail", "crash.mcap"),
        ("fail", "crash.mcap"),
        ("fail", "crash.mcap"),
        ("fail", "crash.mcap"),
        ("pass", "junction.mcap"),
    ]
    assert "no-hero-collision     12.10 s  2 collisions of the hero" in lines[1]
    assert lines[-1] == f"1 passed, 1 failed, 1 not judged; 3 recordings, 9 rules of {RULES}"
    assert (done.returncode, done.stderr) == (2, b"")


@pytest.mark.parametrize(("name", "code"), [("junction", 0), ("crash", 1)])
def test_the_exit_code_is_that_of_the_worst_verdict(name, code):
    done = run("check", SAMPLES / f"{name}.mcap", "--rules", RULES)
    assert (done.returncode, done.stderr) == (code, b"")


def test_rules_with_the_same_error_are_counted(tmp_path):
    path = tmp_path / "recovered.mcap"
    cut = (SAMPLES / "crash.mcap").read_bytes()[:250_000]
    with pytest.warns(RecapWarning, match="are missing"):
        recover(save(tmp_path / "cut.mcap", cut), path)
    line = run("check", path, "--rules", RULES).stdout.decode().splitlines()[0]
    assert line.split(maxsplit=2)[2].startswith("8 rules  expected a recording with all of its events")  # and not its length


@pytest.mark.parametrize(("options", "code", "status"), [((), 0, "pass"), (("--strict",), 1, "fail")])
def test_a_rule_that_had_nothing_to_judge_is_listed_and_is_broken_if_strict(tmp_path, options, code, status):
    rules = save(tmp_path / "rules.toml", b"[rules.slow]\nspeed = { of = 'role:heroo', max = 0.1 }")
    done = run("check", SAMPLES / "crash.mcap", "--rules", rules, *options)
    line = done.stdout.decode().splitlines()[-2].split(maxsplit=3)
    assert line[0] == status
    said = "nothing to judge: no speed of the actor of the role heroo was measured (it has no role:heroo)"
    assert line[2:] == ["slow", said]
    assert done.returncode == code


def test_json(runs):
    done = run("check", runs, "--rules", RULES, "--json", *ALONE)
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert found["counts"] == {"pass": 1, "fail": 1, "error": 0}
    assert found["rules"][0] == {
        "name": "no-hero-collision",
        "condition": "collisions",
        "description": "The hero hits nothing",
    }
    worst, best = found["recordings"]
    assert (Path(worst["recording"]).name, worst["status"], worst["map"], worst["frames"]) == (
        "crash.mcap",
        "fail",
        "Brickfield",
        1200,
    )
    first = worst["verdicts"][0]
    assert (first["rule"], first["status"], first["actors"]) == ("no-hero-collision", "fail", [41, 44])
    assert first["time"] == pytest.approx(12.1)
    assert {verdict["status"] for verdict in best["verdicts"]} == {"pass"}


def test_on_a_terminal_verdicts_are_a_table(runs):
    code, shown, _ = on_terminal("check", runs, "--rules", RULES, *ALONE)
    assert code == 1
    assert "What happens" in shown
    assert "no-hero-collision" in shown


def test_what_cannot_be_written_is_an_error_after_the_verdicts(runs, tmp_path, monkeypatch):
    def fails(*_):
        raise RecapError("out.xml: cannot be written: No space left on device")

    monkeypatch.setattr("carla_recap.fleet.junit.write_junit", fails)
    monkeypatch.setattr("carla_recap.fleet.pages.overview", fails)
    for options in (["--junit", tmp_path / "out.xml"], ["--html", tmp_path / "out"]):
        done = CliRunner().invoke(check, [str(runs), "--rules", str(RULES), *ALONE, *map(str, options)])
        assert "no-hero-collision     12.10 s  2 collisions of the hero" in done.stdout
        assert isinstance(done.exception, RecapError)
        assert wrote(done.stderr) == []


def test_pages(runs, tmp_path):
    pages = ("--html", tmp_path / "out", "--clips")
    done = run("check", runs, "--rules", RULES, "--json", *pages, "--junit", tmp_path / "new" / "out.xml")
    assert (done.returncode, wrote(done.stderr)) == (1, [f"{tmp_path}/out/index.html", f"{tmp_path}/new/out.xml"])
    assert names_in(tmp_path / "out") == ["clips", "index.html", "pages"]
    assert names_in(tmp_path / "out" / "pages") == ["crash.html"]
    assert "1 failed of 2 recordings" in (tmp_path / "out" / "index.html").read_text("utf-8")
    page = str(tmp_path / "out" / "pages" / "crash.html")
    assert f"page: {page}" in (tmp_path / "new" / "out.xml").read_text("utf-8")
    assert [each["page"] for each in json.loads(done.stdout)["recordings"]] == [page, None]


def test_pages_without_rules_of_the_road_are_a_warning(tmp_path):
    rules = save(tmp_path / "rules.toml", b"[rules.short]\nduration = { max = '1 s' }")
    done = run("check", SAMPLES / "crossing.log", "--rules", rules, "--html", tmp_path / "out", *ALONE)
    assert (done.returncode, b"the map 'Crossing' is unknown; rules of the road are left out" in done.stderr) == (1, True)


def test_a_folder_of_pages_that_is_not_empty_is_left_alone_without_force(runs, tmp_path):
    save(tmp_path / "mine.txt", b"")
    assert "is not empty; --force writes over" in error("check", runs, "--rules", RULES, "--html", tmp_path)
    done = run("check", runs, "--rules", RULES, "--html", tmp_path, "--force", *ALONE)
    assert done.returncode == 1
    assert names_in(tmp_path) == ["index.html", "mine.txt", "pages", "runs"]


def test_names_that_are_no_text_are_printed_and_written(tmp_path):
    name = os.fsdecode(b"caf\xe9 <&\x1b[31m.mcap")
    shutil.copy(SAMPLES / "crash.mcap", tmp_path / name)
    options = ("--html", tmp_path / "out", "--junit", tmp_path / "out.xml", *ALONE)
    done = run("check", tmp_path / name, "--rules", RULES, "-q", *options)
    assert (done.returncode, done.stderr) == (1, b"")
    assert b"caf\\udce9 <&\\x1b[31m.mcap" in done.stdout
    assert len(names_in(tmp_path / "out" / "pages")) == 1
    assert (
        next(ElementTree.parse(tmp_path / "out.xml").iter("testcase"))
        .get("classname")
        .endswith("caf\ufffd <&\ufffd[31m.mcap")
    )


def test_all_faults_of_the_rules_are_lines_before_anything_is_read(tmp_path):
    rules = save(tmp_path / "rules.toml", b"[rules.a]\nframes = { max = -1 }\n[rules.b]\nmaps = 'x'\n")
    done = run("check", "absent.mcap", "--rules", rules)
    assert (done.returncode, done.stdout) == (2, b"")
    first, second = done.stderr.decode().splitlines()
    assert first == f"carla-recap: {rules}: rule 'a': frames.max: expected a whole number of 0 or more, found -1"
    assert second.startswith(f"carla-recap: {rules}: rule 'b': unknown condition 'maps'; ")
