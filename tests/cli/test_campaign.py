"""`carla-recap campaign`: what it prints and writes, and what it says about wrong arguments."""

from __future__ import annotations

import csv
import io
import json
import re
import signal
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from carla_recap.fleet.campaign.report import INDEX, PAGE, RUNS
from tests.cli.command import COMMAND, ENVIRONMENT, answer, run
from tests.fleet.campaign import functions
from tests.roads.straight_road import STRAIGHT_ROAD
from tests.samples import SAMPLES, names_in
from tests.waiting import wait_until

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")

FILE = Path(functions.__file__)
RULES = """
[rules.is-long]
duration = { min = "0.2 s" }
"""
ALONE = ("--workers", "1")
"""Options that start one process, and not one for each processor, each of which imports the simulator."""
RAISED = "seed=1,how=raise.mcap: KeyError: 'three' (functions.py)"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A campaign in which a run fails and one breaks a rule, and its folder."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "rules.toml").write_text(RULES)
    options = ("--seeds", "1,2", "--param", "how=raise,nothing", "--rules", folder / "rules.toml")
    options += ("--pages", "1", "--csv", "--keep-going", *ALONE)
    return run("campaign", f"{FILE}:misbehave", "--out", folder / "runs", *options), folder / "runs"


def test_all_runs_are_rows_with_their_parameters(done):
    done, folder = done
    assert done.returncode == 2
    rows = list(csv.DictReader(io.StringIO(done.stdout.decode())))
    assert [(row["seed"], row["how"], row["rules"]) for row in rows] == [
        ("1", "raise", ""),
        ("2", "raise", ""),
        ("1", "nothing", "is-long"),
        ("2", "nothing", "is-long"),
    ]
    assert rows[0]["error"].startswith("KeyError: 'three'")
    assert rows[2]["recording"] == str(folder / "seed=1,how=nothing.mcap")
    lines = done.stderr.decode().splitlines()
    assert re.sub(r":\d+\)", ")", lines[0]) == f"carla-recap: {RAISED}"
    assert re.sub(r":\d+\)", ")", lines[1]) == "carla-recap: 2 runs: KeyError: 'three' (functions.py)"
    assert lines[-1] == "runs: 2 done, 0 were there, 2 failed; 2 recordings of 2 break rules"


def test_a_campaign_ends_when_runs_fail_one_after_the_other(tmp_path):
    options = ("--seeds", "1:40", "--param", "how=raise", "--pages", "0", "--workers", "3")
    done = run("campaign", f"{FILE}:misbehave", "--out", tmp_path, *options)
    assert done.returncode == 2
    lines = [re.sub(r":\d+\)", ")", line) for line in done.stderr.decode().splitlines()]
    assert lines[:2] == [f"carla-recap: {RAISED}", "carla-recap: 3 runs: KeyError: 'three' (functions.py)"]
    assert lines[2] == "ended after 3 failed runs in a row; --keep-going makes the others, too"
    assert lines[-1] == "runs: 0 done, 0 were there, 3 failed"


def test_the_page_the_index_and_the_runs_are_written(done):
    _, folder = done
    assert names_in(folder) == [RUNS, INDEX, PAGE, "pages", "seed=1,how=nothing.mcap", "seed=2,how=nothing.mcap"]
    runs = json.loads((folder / RUNS).read_text())["runs"]
    assert [each["page"] for each in runs if each["page"]] == ["pages/seed-1-how-nothing.html"]
    assert "about to raise" in runs[0]["details"]
    query = "select parameters['how'] as how, count(*) as runs from recordings group by how"
    assert answer("sql", folder / INDEX, query, "--csv") == "how,runs\nnothing,2\n"


def test_pages_and_index_have_the_runs_of_the_last_campaign_alone(tmp_path):
    (town := tmp_path / "Own.xodr").write_text(STRAIGHT_ROAD, "utf-8")
    options = ("--param", "how=nothing", "--town", town, "--map", town, *ALONE)
    command = ("campaign", f"{FILE}:misbehave", "--out", tmp_path, *options)
    assert run(*command, "--seeds", "1,2", "--pages", "0").returncode == 0
    (tmp_path / "pages").mkdir()
    for seed in (1, 2):
        (tmp_path / "pages" / f"seed-{seed}-how-nothing.html").write_text("stale")
    done = run(*command, "--seeds", "2,3", "--pages", "1")
    assert (done.returncode, b"exists" in done.stderr) == (0, False)
    assert names_in(tmp_path / "pages") == ["seed-2-how-nothing.html"]
    assert (tmp_path / "pages" / "seed-2-how-nothing.html").read_text("utf-8") != "stale"
    query = "select parameters['seed'] as seed, roads_known from recordings order by seed"
    assert answer("sql", tmp_path / INDEX, query, "--csv") == "seed,roads_known\n2,true\n3,true\n"


def test_an_interrupted_campaign_says_how_many_runs_are_done(tmp_path):
    arguments = ["campaign", f"{FILE}:misbehave", "--param", "how=nothing,hang", "--out", str(tmp_path), "--workers", "1"]
    with Popen([COMMAND, *arguments], stdout=PIPE, stderr=PIPE, env=ENVIRONMENT) as process:
        wait_until(lambda: (tmp_path / "seed=1,how=nothing.mcap").exists())
        process.send_signal(signal.SIGINT)
        said = process.communicate()[1].decode()
    assert re.search("interrupted: [01] of 2 runs done; the same command makes the others", said)
    assert "Traceback" not in said


def test_recordings_are_scored(tmp_path):
    options = ("--param", "delay=4,6", "--param", "speed=1", "--from-drive", "--measure", "score", "--json", *ALONE)
    done = run("campaign", f"{SAMPLES / 'campaign.py'}:pedestrian", *options, "--pages", "0", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    scores = [each["results"]["score"]["value"] for each in json.loads(done.stdout)["runs"]]
    assert scores == [50.0, 100.0]
    assert '<th scope="col" class="number">score</th>' in (tmp_path / PAGE).read_text("utf-8")


def test_a_search_finds_the_crash_of_the_sample(tmp_path):
    pytest.importorskip("optuna", reason="the extra `search` is not installed")
    options = ("--param", "delay=4.5..6.0", "--param", "speed=1.5..2.5", "--search", "--maximize", "collisions")
    options += ("--runs", "8", "--pages", "0", "--workers", "2")
    done = run("campaign", f"{SAMPLES / 'campaign.py'}:pedestrian", *options, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert ": crashed at 33 km/h, collisions 1 at " in done.stdout.decode().splitlines()[0]
    assert len(list(tmp_path.glob("*.mcap"))) == 8
