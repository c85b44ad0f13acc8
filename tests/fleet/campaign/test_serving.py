"""Scripts for CARLA's client as runs of a campaign."""

from __future__ import annotations

import sys

import pytest

from carla_recap import open_recording
from carla_recap.fleet.campaign import campaign
from tests.waiting import time_limit

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
pytest.importorskip("carla", reason="the extra `carla` is not installed")

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
