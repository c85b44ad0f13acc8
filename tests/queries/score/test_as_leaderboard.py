"""Scores are those of the Leaderboard's evaluator, of drives that it recorded on the server with `--record`.

`runs/` has recordings and results of the evaluator with CARLA's client on this package's server: the evaluator's
npc_agent.py on route 11, and the agent of the samples on route 12.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from carla_recap import Score, open_recording, score
from carla_recap.queries.score.checkpoint import checkpoint
from tests.roads.towns import town

RUNS = sorted((Path(__file__).parent / "runs").glob("*.mcap"))
ROUTES = Path(__file__).parents[3] / "samples" / "leaderboard" / "town10hd.xml"


def scored(path: Path) -> Score:
    with open_recording(path) as recording:
        return score(recording, ROUTES, road_map=str(town("Town10HD")))


def result(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.with_suffix(".json").read_text())
    return found


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_the_score_is_the_evaluators(path: Path) -> None:
    (theirs,) = result(path)["_checkpoint"]["records"]
    (ours,) = checkpoint([scored(path)])["_checkpoint"]["records"]
    assert (ours["route_id"], ours["status"]) == (theirs["route_id"], theirs["status"])
    assert ours["num_infractions"] == theirs["num_infractions"] > 0
    assert {kind: len(texts) for kind, texts in ours["infractions"].items()} == {
        kind: len(texts) for kind, texts in theirs["infractions"].items()
    }
    for kind in ("collisions_vehicle", "stop_infraction"):
        said, expected = ([text.partition(", z")[0] for text in each["infractions"][kind]] for each in (ours, theirs))
        assert said == expected
    assert ours["scores"]["score_route"] == pytest.approx(theirs["scores"]["score_route"], abs=0.05)
    assert ours["scores"]["score_penalty"] == pytest.approx(theirs["scores"]["score_penalty"], abs=0.002)
    assert ours["scores"]["score_composed"] == pytest.approx(theirs["scores"]["score_composed"], abs=0.2)
    assert ours["meta"]["route_length"] == pytest.approx(theirs["meta"]["route_length"], abs=0.05)


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_results_have_the_form_of_the_evaluators(path: Path) -> None:
    def shape(value: Any) -> Any:
        return {name: shape(item) for name, item in value.items()} if isinstance(value, dict) else type(value)

    ours, theirs = checkpoint([scored(path)]), result(path)
    assert list(ours) == list(theirs)
    assert ours["labels"] == theirs["labels"]
    assert len(ours["values"]) == len(theirs["values"])
    overall = ours["_checkpoint"]["global_record"], theirs["_checkpoint"]["global_record"]
    assert set(overall[0]) == set(overall[1])
    for name in ("infractions", "scores_mean", "scores_std_dev", "meta"):
        assert set(overall[0][name]) == set(overall[1][name])
    for name, value in overall[1]["infractions"].items():
        assert overall[0]["infractions"][name] == pytest.approx(value, abs=0.01)
    records = ours["_checkpoint"]["records"][0], theirs["_checkpoint"]["records"][0]
    assert set(records[1]) <= set(records[0])
    assert shape(records[1]["scores"]).keys() == shape(records[0]["scores"]).keys()
