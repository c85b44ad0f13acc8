"""The command that scores recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from carla_recap import open_recording, score
from carla_recap.cli.score import FORMULAS, _lines
from carla_recap.queries import score as scoring
from tests.cli.command import answer, error, on_terminal, run, wrote
from tests.samples import SAMPLES

CRASH, AVOIDED, ROUTES = (SAMPLES / name for name in ("crash.mcap", "avoided.mcap", "routes.xml"))
BY_ROUTE = ("--route", ROUTES, "--route-id", "1")


def test_the_formulas_of_the_option_are_all() -> None:
    assert FORMULAS == scoring.FORMULAS


def test_without_a_route_there_is_no_completion() -> None:
    lines = answer("score", CRASH, "--from-drive").splitlines()
    assert lines[0] == "no route of Brickfield: Driven"
    assert lines[1].startswith("score 30.00 = 100 x 0.3000, without completion, by the formula")
    rows = [line.split("\t") for line in answer("score", CRASH, AVOIDED, "--from-drive").splitlines()]
    assert [(row[3], row[6]) for row in rows[1:]] == [("", "Driven"), ("", "Driven"), ("", ""), ("", "")]
    assert rows[1][7] == "1 x collisions_pedestrian, 1 x collisions_vehicle"
    code, shown, _ = on_terminal("score", CRASH, AVOIDED, *BY_ROUTE)
    assert (code, "avoided.mcap" in shown) == (0, True)


def test_an_infraction_that_counts_twice_is_one_line() -> None:
    with open_recording(CRASH) as recording:
        found = score(recording, ROUTES, route_id="1")
    first, second = found.infractions
    lines = list(_lines(replace(found, infractions=(first, second, second))))
    assert [line.endswith(", counted twice\n") for line in lines[3:5]] == [False, True]
    assert lines[5].startswith("to see the first")
    on_the_way = replace(found, status="Failed", completion=41.236)
    assert next(_lines(on_the_way)) == "route 1 of Brickfield: Failed - Recording ends at 41.24 % of the route\n"


def test_json_is_the_form_of_the_leaderboard() -> None:
    found = json.loads(answer("score", CRASH, AVOIDED, *BY_ROUTE, "--json"))
    first, second = found["_checkpoint"]["records"]
    assert (first["route_id"], first["status"], second["status"]) == ("RouteScenario_1_rep0", "Completed", "Perfect")
    assert first["scores"] == {"score_composed": 30.0, "score_route": 100.0, "score_penalty": 0.3}
    assert [event["link"] for event in first["events"]] == ["#t=12.10", "#t=15.15"]
    assert first["recording"] == str(CRASH)
    overall = found["_checkpoint"]["global_record"]
    assert overall["scores_mean"] == {"score_composed": 65.0, "score_route": 100.0, "score_penalty": 0.65}
    assert overall["scores_std_dev"] == {"score_composed": 49.497, "score_route": 0.0, "score_penalty": 0.495}
    assert overall["infractions"]["collisions_pedestrian"] == pytest.approx(1 / 0.219, abs=0.05)
    assert found["values"][0] == "65.0"
    numbers = [(each["success"], each["driving_efficiency"], each["driving_smoothness"]) for each in (first, second)]
    assert numbers == [(False, None, 42.857), (True, None, 50.0)]
    assert first["comfort"]["lateral_acceleration"] == 100.0
    assert found["_checkpoint"]["bench2drive"] == {
        "success_rate": 50.0,
        "driving_efficiency": None,
        "driving_smoothness": 46.429,
        "abilities": {"mean": None},
    }


def test_limits_decide_the_exit_code(tmp_path: Path) -> None:
    junit = tmp_path / "out.xml"
    done = run("score", CRASH, AVOIDED, *BY_ROUTE, "--min-score", 60, "--max", "red_light=0", "--junit", junit)
    assert done.returncode == 1
    assert wrote(done.stderr) == [str(junit)]
    assert f"carla-recap: {CRASH}: score 30.00, at least 60 was expected; Completed\n" in done.stderr.decode()
    suite = ElementTree.parse(junit).getroot()[0]
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("carla-recap score", "4", "1")
    told = suite.find(".//failure").text.splitlines()
    assert {"actors: 44", f"to see it: carla-recap view '{CRASH}#t=12.10'"} <= set(told)
    assert [line[:24] for line in told if " s: " in line] == ["12.10 s: Agent collided ", "15.15 s: Agent collided "]
    assert run("score", CRASH, *BY_ROUTE, "--min-score", 30, "--min-completion", 99, "--max-infractions", 2).returncode == 0
    for limit in (("--max-infractions", 1), ("--max", "collisions_pedestrian=0")):
        assert run("score", CRASH, *BY_ROUTE, *limit).returncode == 1


def test_a_recording_that_cannot_be_scored_is_an_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nothing")
    done = run("score", CRASH, broken, *BY_ROUTE, "--min-score", 10, "--max", "red_light=0", "--junit", tmp_path / "out.xml")
    assert done.returncode == 2
    errors = ElementTree.parse(tmp_path / "out.xml").findall(".//error")
    assert [each.get("message") for each in errors] == ["is not a recording (neither CARLA's log nor MCAP)"] * 2
    assert f"carla-recap: {broken}: is not a recording (neither CARLA's log nor MCAP)\n" in done.stderr.decode()
    assert b"score 30.00" in done.stdout
    assert error("score", SAMPLES / "crossing.log", "--from-drive").startswith(
        f"{SAMPLES / 'crossing.log'}: the map 'Crossing' is unknown, but its roads are needed"
    )


def test_several_route_files_have_the_routes_of_all(tmp_path: Path) -> None:
    text = ROUTES.read_text("utf-8")
    (other := tmp_path / "other.xml").write_text(text.replace('id="1"', 'id="7"').replace('id="2"', 'id="8"'), "utf-8")
    lines = answer("score", CRASH, "--route", ROUTES, "--route", other, "--route-id", "7", "--formula", "2.1").splitlines()
    assert lines[0] == "route 7 of Brickfield: Completed"
    assert lines[1].startswith("score 37.04 = ")
