"""Metric files, run as they are, by the command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("carla", reason="the extra `carla` is not installed")

from carla_recap import RecapError
from carla_recap.metrics import MetricsLog, run_metric
from carla_recap.server import running
from tests.cli.command import CROSSING, ENVIRONMENT, run
from tests.waiting import PATIENCE

SAMPLES = CROSSING.parent
SHARED = Path(__file__).parents[3] / "shared"
PEER = SHARED / "peer" / "scenario_runner"
LANE_CENTER = PEER / "srunner" / "metrics" / "examples" / "distance_to_lane_center.py"

METRIC = """
import json
from srunner.metrics.examples.basic_metric import BasicMetric

class Farthest(BasicMetric):
    def _create_metric(self, town_map, log, criteria):
        hero = log.get_ego_vehicle_id()
        found = [each.location.x for each in log.get_all_actor_transforms(hero)]
        town = None if town_map is None else town_map.name
        print(json.dumps({"farthest": max(found), "town": town, "criteria": criteria}))
"""


@pytest.fixture
def metric(tmp_path):
    def write(text):
        path = tmp_path / "my_metric.py"
        path.write_text(text)
        return path

    return write


def test_a_metric_gets_the_map_the_log_and_the_criteria(tmp_path, metric):
    """A folder for results of ScenarioRunner is not taken for it."""
    (tmp_path / "srunner" / "metrics" / "data").mkdir(parents=True)
    (criteria := tmp_path / "c.json").write_text('{"Collision": {"test_status": "SUCCESS"}}')
    crash = SAMPLES / "crash.mcap"
    done = run("metrics", "--metric", metric(METRIC), "--log", crash, "--criteria", criteria, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")
    found = json.loads(done.stdout)
    assert found["town"] == "Brickfield"
    assert found["criteria"] == {"Collision": {"test_status": "SUCCESS"}}
    assert found["farthest"] > 200


def test_an_unknown_map_is_none_with_a_warning(metric):
    done = run("metrics", "--metric", metric(METRIC), "--log", CROSSING)
    assert json.loads(done.stdout)["town"] is None
    assert b"no map for 'Crossing'" in done.stderr


def test_an_error_of_the_metric_is_shown_with_its_own_lines(metric):
    done = run("metrics", "--metric", metric(METRIC.replace("hero =", "hero = 1 / 0 #")), "--log", SAMPLES / "crash.mcap")
    assert done.returncode == 1
    lines = done.stderr.decode().splitlines()
    assert lines[-1] == "ZeroDivisionError: division by zero"
    assert not any("carla_recap" in line for line in lines)


@pytest.mark.parametrize(
    ("text", "name", "criteria", "message"),
    [
        (METRIC, "my_metric.py", "{", "is no JSON file"),
        (METRIC, "my_metric.py", "[]", "an object with a member for each criterion"),
        (METRIC, "gone.py", "{}", "no such file"),
        ("class Other: pass", "my_metric.py", "{}", "no class in it extends BasicMetric"),
    ],
)
def test_wrong_files_are_errors(tmp_path, metric, text, name, criteria, message):
    metric(text)
    (tmp_path / "c.json").write_text(criteria)
    with MetricsLog(SAMPLES / "crash.mcap") as log, pytest.raises(RecapError, match=message):
        run_metric(tmp_path / name, log, criteria=tmp_path / "c.json")


@pytest.mark.skipif(not LANE_CENTER.exists(), reason="ScenarioRunner is not beside this clone")
def test_a_metric_gives_the_same_figures_as_with_scenario_runners_manager(tmp_path):
    name = "carla-0.9.13-lane-center.log"
    logs, maps = SHARED / "data" / "carla-logs", SHARED / "data" / "maps"
    results = []
    for folder in ("ours", "theirs"):
        (tmp_path / folder / "srunner" / "metrics" / "data").mkdir(parents=True)
        results.append(tmp_path / folder / "srunner" / "metrics" / "data" / "DistanceToLaneCenter_results.json")
    done = run("metrics", "--metric", LANE_CENTER, "--log", logs / name, "--map", maps, cwd=tmp_path / "ours")
    assert (done.returncode, done.stderr) == (0, b"")
    with running(maps=maps) as port:
        command = [sys.executable, PEER / "metrics_manager.py", "--port", str(port), "--log", name, "--metric", LANE_CENTER]
        environment = {**ENVIRONMENT, "PYTHONPATH": str(PEER), "SCENARIO_RUNNER_ROOT": str(logs)}
        subprocess.run(command, check=True, env=environment, cwd=tmp_path / "theirs", capture_output=True, timeout=PATIENCE)
    ours, theirs = (json.loads(path.read_text()) for path in results)
    assert ours["frames"] == theirs["frames"]
    # The text that the manager parses has six digits.
    assert ours["distance"] == pytest.approx(theirs["distance"], abs=1e-3)


HELPED = METRIC.replace("import json", "import json, helper, aids.more, random").replace(
    "        hero =", "        self.found = helper.NAME, aids.more.NAME, random.__name__\n        hero ="
)


def test_metrics_have_the_helpers_of_their_own_folders(tmp_path: Path) -> None:
    before = set(sys.modules)
    with MetricsLog(CROSSING) as log:
        for name in ("one", "two", "one"):
            (tmp_path / name / "aids").mkdir(parents=True, exist_ok=True)
            (tmp_path / name / "my_metric.py").write_text(HELPED, "utf-8")
            for helper in ("helper.py", "aids/more.py"):
                (tmp_path / name / helper).write_text(f"NAME = {name!r}", "utf-8")
            assert run_metric(tmp_path / name / "my_metric.py", log).found == (name, name, "random")
    assert not {"helper", "aids", "aids.more"} & (sys.modules.keys() - before)


def test_a_run_leaves_modules_as_they_were(tmp_path: Path) -> None:
    import random

    (tmp_path / "random.py").write_text(METRIC, "utf-8")
    path = list(sys.path)
    with MetricsLog(CROSSING) as log:
        run_metric(tmp_path / "random.py", log)
    assert sys.path == path
    assert sys.modules["random"] is random
