"""CARLA's Leaderboard with the sample agent, as a user runs it; needs the Leaderboard and what it imports."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import carla_recap
from tests.samples import SAMPLES
from tests.server.client import free_port
from tests.waiting import PATIENCE

SCRIPT = SAMPLES / "leaderboard.sh"
PEER = Path(__file__).parents[3] / "shared" / "peer"
FOLDERS = {"LEADERBOARD_ROOT": "leaderboard", "SCENARIO_RUNNER_ROOT": "scenario_runner", "CARLA_ROOT": "carla"}
ROOTS = {name: Path(os.environ.get(name, PEER / folder)) for name, folder in FOLDERS.items()}
MODULES = "py_trees dictor shapely networkx pygame tabulate pexpect ephem cv2 transforms3d six".split()  # noqa: SIM905
MISSING = [str(root) for root in ROOTS.values() if not root.is_dir()] + [
    name for name in MODULES if importlib.util.find_spec(name) is None
]
ROUTE = """\
<routes>
  <route id="7" town="Brickfield">
    <waypoints>
      <position x="340.2" y="-3.7" z="0.0" />
      <position x="270.0" y="-3.7" z="0.0" />
    </waypoints>
    <scenarios />
  </route>
</routes>
"""
RECORD = {
    "route_id": "RouteScenario_7_rep0",
    "status": "Completed",
    "scores": {"score_route": 100.0, "score_penalty": 0.7, "score_composed": 70.0},
    "infractions": {"collisions_vehicle": [], "red_light": ["Agent ran a red light 8 at (x=1, y=2, z=0)"]},
    "meta": {"duration_game": 60.0, "duration_system": 20.0},
}


def run(environment: dict[str, str], *arguments: object) -> subprocess.CompletedProcess[str]:
    kept = {key: value for key, value in os.environ.items() if key not in ROOTS}
    return subprocess.run(
        [SCRIPT, *map(str, arguments)],
        env={**kept, "PYTHON": sys.executable, **environment},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_the_agent_finishes_a_route(tmp_path: Path) -> None:
    (tmp_path / "routes.xml").write_text(ROUTE)
    environment = {name: str(root) for name, root in ROOTS.items()}
    environment |= {"PORT": str(free_port()), "TM_PORT": str(free_port()), "RESULTS": str(tmp_path / "results")}
    done = run(environment, tmp_path / "routes.xml")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "results" / "results.json").read_text())
    (record,) = results["_checkpoint"]["records"]
    assert results["entry_status"] == "Finished"
    assert record["scores"]["score_route"] == 100
    assert "RouteScenario_7_rep0       100.00 %" in done.stdout
    with carla_recap.open_recording(tmp_path / "results" / "RouteScenario_7_rep0.log") as recording:
        (hero,) = recording.heroes
        path = recording.trajectory(hero.id)
        assert recording.info.map_name == "Brickfield"
        assert path.x[0] - path.x[-1] == pytest.approx(70, abs=10)  # a route counts as complete within 10 m of its end


def test_a_folder_that_is_not_named_is_an_error() -> None:
    done = run({"LEADERBOARD_ROOT": "here"})
    assert done.returncode != 0
    assert done.stderr.strip().endswith("SCENARIO_RUNNER_ROOT: is not set: the folder of a checkout of ScenarioRunner")


def test_a_folder_without_the_leaderboard_is_an_error(tmp_path: Path) -> None:
    done = run(dict.fromkeys(ROOTS, str(tmp_path)))
    assert done.returncode == 2
    assert done.stderr.strip().endswith(f"there is no {tmp_path}/leaderboard/leaderboard_evaluator.py")


def test_results_are_printed(tmp_path: Path) -> None:
    done = print_results(tmp_path, {"_checkpoint": {"records": [RECORD]}})
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "route                    completion  penalty   score  speed  status",
        "RouteScenario_7_rep0       100.00 %    0.700   70.00  3.0 x  Completed",
        "    Agent ran a red light 8 at (x=1, y=2, z=0)",
        "mean                       100.00 %    0.700   70.00",
    ]


@pytest.mark.parametrize("results", [{}, {"_checkpoint": {"records": []}}, None])
def test_no_results_are_an_error(tmp_path: Path, results: object) -> None:
    done = print_results(tmp_path, results)
    assert done.returncode == 1
    assert "has no results" in done.stderr


def print_results(folder: Path, results: object) -> subprocess.CompletedProcess[str]:
    path = folder / "results.json"
    if results is not None:
        path.write_text(json.dumps(results))
    command = [sys.executable, str(SAMPLES / "leaderboard" / "print_results.py"), str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
