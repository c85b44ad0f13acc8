"""The samples: queries find what happens in recordings, which their script makes again; a campaign, workflows for CI."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

import carla_recap
from tests.cli.command import COMMAND, ENVIRONMENT, answer, run
from tests.samples import SAMPLES
from tests.waiting import PATIENCE

WORKFLOWS = [path for path in sorted((SAMPLES / "ci").glob("*.yml")) if "carla-recap campaign" in path.read_text("utf-8")]
SIMULATED = ("avoided", "blocked", "crash", "junction")
LARGEST = 512 << 10  # bytes
RED, YELLOW, GREEN = range(3)
LENGTHS = {"avoided": (522, 26.05), "blocked": (1200, 59.95), "crash": (1200, 59.95), "junction": (600, 29.95)}  # frames, s


def rows(command: str, name: str, *keys: str, options: tuple[str, ...] = ()) -> list[tuple[object, ...]]:
    """Return fields of the rows in the JSON answer, with times rounded to the tick."""
    found = json.loads(answer(command, SAMPLES / f"{name}.mcap", "--json", *options))
    assert (found["map"], found["date"]) == ("Brickfield", 1767261600)
    return [tuple(round(row[key], 3) if isinstance(row[key], float) else row[key] for key in keys) for row in found["rows"]]


@pytest.mark.parametrize("name", SIMULATED)
def test_the_samples_are_small_and_of_one_hero(name):
    assert (SAMPLES / f"{name}.mcap").stat().st_size < LARGEST
    with carla_recap.open_recording(SAMPLES / f"{name}.mcap") as recording:
        assert (recording.info.frames, round(recording.info.duration, 2)) == LENGTHS[name]
        assert recording.info.additional_data
        assert len(recording.heroes) == 1


def test_in_the_crash_the_hero_hits_the_walker_and_then_the_van():
    assert rows("collisions", "crash", "elapsed", "frame", "id1", "hero1", "id2", "type_id2") == [
        (12.1, 243, 41, True, 44, "walker.pedestrian.0004"),
        (15.15, 304, 41, True, 42, "vehicle.mercedes.sprinter"),
    ]


def test_after_the_crash_both_cars_stay_where_they_are_and_the_walker_is_not_blocked():
    assert rows("blocked", "crash", "id", "type_id", "start", "duration") == [
        (1, "spectator", 0.05, 59.9),
        (41, "vehicle.tesla.model3", 15.7, 44.25),
        (42, "vehicle.mercedes.sprinter", 15.7, 44.25),
    ]


def test_the_crash_that_the_autopilot_avoids_is_a_near_miss():
    assert rows("collisions", "avoided") == []
    near = rows("incidents", "avoided", "actors", "start", "stop", options=("--kinds", "near-miss"))
    assert near == [([41, 44], 10.6, 11.0)]


def test_in_the_blocked_lane_three_cars_queue_behind_the_van_one_after_another():
    assert rows("collisions", "blocked") == []
    assert rows("blocked", "blocked", "id", "type_id", "start", "duration")[1:] == [
        (41, "vehicle.mercedes.sprinter", 6.9, 53.05),
        (42, "vehicle.tesla.model3", 11.35, 48.6),
        (43, "vehicle.audi.a2", 14.9, 45.05),
        (44, "vehicle.mini.cooper_s", 15.8, 44.15),
    ]
    places = [x for (x,) in rows("blocked", "blocked", "x")][1:]
    assert places == sorted(places)  # they drive towards lower x


def test_at_the_junction_there_are_no_collisions_and_some_actors_wait():
    assert rows("collisions", "junction") == rows("blocked", "junction") == []
    assert rows("blocked", "junction", "id", "type_id", "start", "duration", options=("--min-time", "10")) == [
        (1, "spectator", 0.05, 29.9),
        (49, "vehicle.audi.tt", 13.55, 16.4),
        (56, "vehicle.seat.leon", 14.25, 15.7),
        (54, "vehicle.nissan.patrol", 14.45, 15.5),
        (46, "vehicle.nissan.patrol", 19.0, 10.95),
        (64, "walker.pedestrian.0019", 17.95, 10.1),
    ]


@pytest.mark.parametrize(
    ("waits", "light", "latest"), [(41, 28, 0.65), (49, 19, 0.5), (54, 17, 0.5), (46, 17, 0.5), (64, 28, 0.5)]
)
def test_actors_at_the_junction_wait_for_a_light(waits, light, latest):
    """They set off `latest` seconds after the light has changed, at the latest; the engine of a car has to rev up first."""
    with carla_recap.open_recording(SAMPLES / "junction.mcap") as recording:
        (stop,) = (row for row in recording.blocked(5) if row.id == waits)
        lights = recording.light_states(light)
    shown = set(lights.state[(lights.time > stop.start) & (lights.time < stop.start + stop.duration - latest)].tolist())
    assert shown == ({GREEN, YELLOW} if waits == 64 else {RED})  # the walker waits for the cars to have red


def test_the_script_makes_the_same_frames(tmp_path):
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    pytest.importorskip("carla", reason="the extra `carla` is not installed")
    environment = ENVIRONMENT | {"PATH": f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"}
    environment["OPENBLAS_CORETYPE"] = "Prescott"  # as on a machine whose processor has fewer instructions
    environment["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-FMA,-AVX2"
    script = [SAMPLES / "make_recordings.sh", tmp_path]
    subprocess.run(script, env=environment, timeout=PATIENCE, check=True, capture_output=True)
    for name in SIMULATED:
        logs = [tmp_path / f"{name}.{which}.log" for which in ("anew", "sample")]
        for recording, log in zip((tmp_path, SAMPLES), logs, strict=True):
            carla_recap.convert(recording / f"{name}.mcap", log)
        assert logs[0].read_bytes() == logs[1].read_bytes(), name


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run in which the hero brakes in time, and one in which it does not."""
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    folder = tmp_path_factory.mktemp("campaign") / "runs"
    done = run("campaign", f"{SAMPLES / 'campaign.py'}:follow", "--seeds", "3,4", "--out", folder, "--pages", "0")
    assert done.returncode == 0, done.stderr
    return folder


def test_the_campaign_is_checked(runs, tmp_path):
    out = tmp_path / "out.xml"
    done = run("check", runs, "--rules", SAMPLES / "rules.toml", "--junit", out, "--html", tmp_path / "pages", "--clips")
    assert done.returncode == 1
    assert [line.split(":")[0] for line in done.stderr.decode().splitlines()] == [
        f"wrote {path}" for path in (tmp_path / "pages" / "index.html", out)
    ]
    cases = {
        (Path(case.get("classname")).name, case.get("name")): list(case) for case in ElementTree.parse(out).iter("testcase")
    }
    assert [key for key, failures in cases.items() if failures] == [
        ("seed=3.mcap", "no-hero-collision"),
        ("seed=3.mcap", "keeps-its-distance"),
    ]
    assert len(cases) == 18
    assert [path.name for path in (tmp_path / "pages" / "pages").iterdir()] == ["seed-3.html"]
    assert [path.name for path in (tmp_path / "pages" / "clips").iterdir()] == ["seed-3.mcap"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_is_yaml_and_its_commands_exist(path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    text = path.read_text("utf-8")
    found = yaml.safe_load(text)
    jobs = found["jobs"] if path.stem == "github-actions" else found
    assert "campaign" in jobs or {"simulate", "check"} <= set(jobs)
    for command in ("campaign", "check"):
        (line,) = re.findall(rf"carla-recap ({command} .*?)(?: \||$)", text, re.MULTILINE)
        options = set(re.findall(r"--[a-z]+", run(command, "--help").stdout.decode()))
        assert set(re.findall(r"--[a-z]+", line)) <= options
    for name in re.findall(r"samples/[\w./-]+", text):
        assert (SAMPLES.parent / name).exists(), name
