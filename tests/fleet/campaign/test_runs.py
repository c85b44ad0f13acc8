"""Runs of campaigns: of functions and of scripts for CARLA's client, in worker processes and on a cluster."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
from functools import partial
from pathlib import Path

import pytest

from carla_recap import open_recording
from carla_recap.errors import RecapError
from carla_recap.fleet.campaign import campaign
from carla_recap.fleet.campaign.results import measured
from carla_recap.sim import World
from carla_recap.util.functions import FileFunction
from tests.fleet.campaign import functions
from tests.samples import SAMPLES, names_in
from tests.waiting import time_limit

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")

FILE = str(Path(functions.__file__))
NO_TICK = "no tick was recorded; a function that ticks its world was expected, or a duration"
FAULTS = {
    "raise": "KeyError: 'three' (functions.py)",
    "exit": "SystemExit: 3 (functions.py)",
    "end": "its worker process ends (exit code 5)",
    "hang": "takes more than 5 s",
    "do not tick": NO_TICK,
    "record elsewhere": NO_TICK,
}
HARMLESS = ("nothing", "fork", "leave a process", "stop", "print")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The recordings of runs of a function with two seeds, by one worker process."""
    folder = tmp_path_factory.mktemp("runs")
    with time_limit():
        found = list(campaign(functions.drive, seeds=[7, 8], params={"vehicles": [1, 3]}, out=folder, jobs=1))
    assert [finished.report.error for finished in found] == [None] * 4
    return folder


def test_each_run_is_a_recording_of_its_name_with_its_parameters(folder):
    assert names_in(folder) == [f"seed={seed},vehicles={count}.mcap" for seed in (7, 8) for count in (1, 3)]
    with open_recording(folder / "seed=7,vehicles=3.mcap") as recording:
        parameters = dict(recording.header.parameters)
        assert all(re.fullmatch("[0-9a-f]{16}", parameters.pop(f"campaign.{name}")) for name in ("code", "map"))
        assert parameters == {
            "seed": "7",
            "vehicles": "3",
            "campaign.function": "drive",
            "campaign.town": "Brickfield",
            "campaign.duration": "0.0",
            "campaign.additional_data": "false",
        }
        assert recording.header.date == 1767261600
        assert (recording.info.frames, len(recording.heroes)) == (40, 1)
        assert sum(actor.kind == "vehicle" for actor in recording.actors.values()) == 3


def test_the_same_runs_give_the_same_bytes_in_other_processes(folder, tmp_path):
    file = FileFunction(FILE, "drive")
    with time_limit():
        list(campaign(file, seeds=[8, 7], params={"vehicles": [3]}, out=tmp_path, jobs=2))
    for path in tmp_path.glob("*.mcap"):
        assert path.read_bytes() == (folder / path.name).read_bytes()
    assert len(names_in(tmp_path)) == 2


def test_what_is_there_is_not_simulated_again(folder):
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    removed = folder / "seed=8,vehicles=1.mcap"
    content = removed.read_bytes()
    removed.unlink()
    with time_limit():
        found = list(campaign(functions.drive, seeds=[7, 8], params={"vehicles": [1, 3]}, out=folder, jobs=1))
    assert [finished.report.was_there for finished in found] == [True, False, True, True]
    assert all(finished.report.results["speed"].value > 0 for finished in found)
    assert removed.read_bytes() == content
    after = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {removed.name}


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_run_that_fails_is_a_row_and_the_others_go_on(tmp_path):
    hows = [*FAULTS, *HARMLESS]
    with time_limit():
        found = list(campaign(functions.misbehave, seeds=[1], params={"how": hows}, out=tmp_path, jobs=2, limit=5))
    assert [finished.run.parameters["how"] for finished in found] == hows
    errors = {finished.run.parameters["how"]: finished.report.error for finished in found}
    errors = {how: error and re.sub(r":\d+\)$", ")", error) for how, error in errors.items()}
    assert errors == FAULTS | dict.fromkeys(HARMLESS)
    details = {finished.run.parameters["how"]: finished.report.details for finished in found}
    assert details["raise"].endswith("about to raise")
    assert 'raise KeyError("three")' in details["raise"]
    assert len(names_in(tmp_path)) == len(HARMLESS)


def test_a_world_ticks_on_up_to_a_duration(tmp_path):
    with time_limit():
        (ticked,) = campaign(functions.wait_here, seeds=[1], out=tmp_path, jobs=1, duration=0.5)
    assert (ticked.report.error, ticked.report.frames) == (None, 10)


def test_what_a_killed_campaign_has_left_is_removed(tmp_path):
    (tmp_path / ".running-0a1b2c3d" / "run-x").mkdir(parents=True)
    with time_limit():
        list(campaign(functions.wait_here, seeds=[1], out=tmp_path, jobs=1, duration=0.1))
    assert [path.name for path in tmp_path.iterdir()] == ["seed=1.mcap"]


@pytest.mark.parametrize("name", ["file", "file/below", "x" * 300])
def test_a_folder_that_cannot_be_written_is_an_error(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(RecapError, match=name[:4]):
        list(campaign(functions.drive, seeds=[1], out=tmp_path / name, jobs=1))


SOURCE = """
def run(world, speed=1):
    world.run(0.1)


def walk(world, speed=1):
    world.run(0.2)
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with the file of a function, and two recordings of it."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "scene.py").write_text(SOURCE)
    with time_limit():
        list(campaign(FileFunction(str(folder / "scene.py"), "run"), seeds=[1, 2], out=folder / "runs", jobs=1))
    return folder


@pytest.fixture
def made(scene, tmp_path):
    """The file of a function, and the folder of two recordings of it."""
    shutil.copytree(scene, tmp_path, dirs_exist_ok=True)
    return tmp_path / "scene.py", tmp_path / "runs"


def test_recordings_of_something_else_are_an_error_that_says_what(made):
    file, folder = made
    changes = [
        ({"duration": 0.5}, "run", "duration 0.0 instead of 0.5;"),
        ({"additional_data": True}, "run", "additional data false instead of true;"),
        ({}, "walk", "function run instead of walk;"),
    ]
    for options, name, said in changes:
        with pytest.raises(RecapError, match=f"seed=1.mcap: is there already, and was made with {said} --again"):
            list(campaign(FileFunction(str(file), name), seeds=[3, 1, 2], out=folder, jobs=1, **options))
    file.write_text(SOURCE.replace("0.1", "0.3"))
    with pytest.raises(RecapError, match="was made with other code; --again"):
        list(campaign(FileFunction(str(file), "run"), seeds=[1, 2], out=folder, jobs=1))
    assert names_in(folder) == ["seed=1.mcap", "seed=2.mcap"]


def test_a_later_recording_of_something_else_ends_the_campaign_or_is_made_anew(made):
    file, folder = made
    file.write_text(SOURCE.replace("0.1", "0.3"))
    (folder / "seed=1.mcap").unlink()
    function = FileFunction(str(file), "run")
    with time_limit():
        list(campaign(function, seeds=[1], out=folder, jobs=1))
        with pytest.raises(RecapError, match=r"seed=2\.mcap: .* other code"):
            list(campaign(function, seeds=[1, 2], out=folder, jobs=1))
        found = list(campaign(function, seeds=[1, 2], out=folder, jobs=1, again=True))
    assert [(each.report.was_there, each.report.frames) for each in found] == [(True, 6), (False, 6)]


def test_a_recording_that_does_not_say_what_made_it_is_an_error(tmp_path):
    with World() as world:
        world.start_recorder(tmp_path / "seed=1.mcap")
        world.tick()
    with pytest.raises(RecapError, match="does not say which function and code made it"):
        list(campaign(functions.drive, seeds=[1], out=tmp_path, jobs=1))


def test_an_impact_has_the_relative_speed_just_before():
    with open_recording(SAMPLES / "crash.mcap") as recording:
        found = measured(recording)
        expected = max(row.relative_speed for row in recording.collisions() if row.hero1 or row.hero2)
    assert found["impact_speed"].value == expected > 5
    assert found["impact_speed"].actor == 41
    with open_recording(SAMPLES / "avoided.mcap") as recording:
        assert "impact_speed" not in measured(recording)


SCRIPT = """
import json, os, sys
import carla

host, port = os.environ["CARLA_HOST"], int(os.environ["CARLA_PORT"])
parameters = json.loads(os.environ["CARLA_RECAP_PARAMETERS"])
assert sys.argv[1:] == [f"--host={host}", f"--port={port}", f"--seed={os.environ['CARLA_RECAP_SEED']}",
                        f"--speed={parameters['speed']}"]
client = carla.Client(host, port)
client.set_timeout(60)
if parameters["speed"] == 9:
    sys.exit("no such speed")
world = client.reload_world() if parameters["speed"] == 10 else client.get_world()
blueprint = world.get_blueprint_library().find("vehicle.audi.tt")
blueprint.set_attribute("role_name", "hero")
hero = world.spawn_actor(blueprint, world.get_map().get_spawn_points()[0])
for _ in range(20):
    hero.apply_control(carla.VehicleControl(throttle=parameters["speed"] / 10))
    world.tick()
"""


def test_a_script_runs_against_a_server_of_its_own(tmp_path, monkeypatch):
    pytest.importorskip("carla", reason="the extra `carla` is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.py").write_text(SCRIPT)
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\ntouch {tmp_path}/used\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    options = {"seeds": [3], "params": {"speed": [8, 9, 10]}}
    with time_limit():
        found = list(campaign(tmp_path / "drive.py", out=tmp_path / "a", jobs=2, **options))
        list(campaign(tmp_path / "drive.py", out=tmp_path / "b", jobs=1, carla="0.9.16", python=python.name, **options))
    assert (tmp_path / "used").exists()
    errors = [finished.report.error for finished in found]
    assert errors == [None, "the script ends with exit code 1: no such speed", None]
    for speed in (8, 10):
        path = tmp_path / "a" / f"seed=3,speed={speed}.mcap"
        with open_recording(path) as recording:
            assert recording.info.frames == 20 + (speed == 10)  # CARLA's client ticks when it loads a map
            parameters = recording.header.parameters
            assert (parameters["seed"], parameters["speed"]) == ("3", str(speed))
            assert parameters["campaign.function"] == "drive.py"
            assert [hero.type_id for hero in recording.heroes] == ["vehicle.audi.tt"]
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_each_run_is_there_once_when_workers_are_killed(client, tmp_path):
    seeds, killed = range(1, 9), set()
    with time_limit():
        runs = campaign(functions.drive, seeds=seeds, params={"seconds": [0.2]}, out=tmp_path / "a", client=client)
        found = []
        for finished in runs:
            found.append(finished)
            if len(found) in (2, 5):
                pid = next(iter(client.run(os.getpid).values()))
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
        list(campaign(functions.drive, seeds=seeds[:4], params={"seconds": [0.2]}, out=tmp_path / "b", jobs=1))
    assert len(killed) == 2
    assert [(finished.run.seed, finished.report.error) for finished in found] == [(seed, None) for seed in seeds]
    assert names_in(tmp_path / "a") == sorted(f"seed={seed},seconds=0.2.mcap" for seed in seeds)
    for name in names_in(tmp_path / "b"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_recordings_go_to_an_object_store(tmp_path):
    from tests.web import serve_bucket

    (tmp_path / "empty").mkdir()
    with serve_bucket("runs", tmp_path / "empty") as url, time_limit():
        run = partial(campaign, functions.drive, params={"seconds": [0.2]}, out=f"{url}/some/", jobs=1)
        first = list(run(seeds=[1, 2]))
        again = list(run(seeds=[1, 2, 3]))
        with open_recording(f"{url}/some/seed=3,seconds=0.2.mcap") as recording:
            assert recording.header.parameters.items() >= {"seed": "3", "seconds": "0.2"}.items()
    assert [finished.report.error for finished in (*first, *again)] == [None] * 5
    assert [finished.report.was_there for finished in again] == [True, True, False]
