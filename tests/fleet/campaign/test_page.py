"""The page of a campaign: its heat maps, tables and links."""

from __future__ import annotations

import re
from pathlib import Path

from carla_recap.fleet.campaign.plan import CampaignRun
from carla_recap.fleet.campaign.report import campaign_page, columns, worst_first
from carla_recap.fleet.campaign.results import COLLISIONS, IMPACT_SPEED, Result, result_named, result_text
from carla_recap.fleet.campaign.runs import FinishedRun, RunReport
from carla_recap.fleet.check import CheckedRecording
from carla_recap.rules.rule_sets import Verdict

NASTY = "</style></p><img src=x onerror=alert(1)>\"'&amp;\x1b"
MEASURE = result_named("ttc")


def row(seed, error=None, broken=None, page=None, value=None, **parameters):
    results = {COLLISIONS.name: Result(0.0)}
    if value is not None:
        results[MEASURE.name] = Result(value, 1.5, 41)
    recording = f"/runs/seed={seed}," + ",".join(f"{name}={each}" for name, each in parameters.items()) + ".mcap"
    run = CampaignRun(recording, seed=seed, parameters=parameters)
    verdicts = [Verdict(rule, "fail", "") for rule in broken or ()]
    checked = None if broken is None else CheckedRecording(recording, tuple(verdicts))
    return FinishedRun(run, RunReport(error, frames=20, results={} if error else results), checked=checked, page=page)


def shown(rows):
    return campaign_page(rows, Path("/runs"), MEASURE, "a.py:run")


def cells(page):
    """Return the address, the class and the value of each cell of the first heat map; failed cells have no address."""
    drawing = re.findall(r'(?s)<svg class="heat.*?</svg>', page)[0]
    linked = re.findall(r'<a class="([\w-]+)" href="([^"]*)">.*?<text [^>]*>([^<]*)</text></a>', drawing)
    return [(address, tone, value) for tone, address, value in linked], re.findall(r'<g class="none">', drawing)


def test_a_cell_shows_the_worst_of_its_runs_and_leads_to_it():
    rows = [
        row(1, speed=8, delay=1, value=2.0),
        row(2, speed=8, delay=1, value=0.5, page="pages/a.html"),
        row(1, speed=8, delay=2, value=6.5),
        row(1, speed=10, delay=1),
        row(1, speed=10, delay=2, error="KeyError: 'three'"),
    ]
    found, failed = cells(shown(rows))
    assert found == [
        ("pages/a.html", "tone-6", "0.5"),
        ("seed%3D1%2Cspeed%3D8%2Cdelay%3D2.mcap", "tone-0", "6.5"),
        ("seed%3D1%2Cspeed%3D10%2Cdelay%3D1.mcap", "unknown", "none"),
    ]
    assert len(failed) == 1
    assert "speed=10, delay=1: none</title>" in shown(rows)


def test_parameters_with_many_values_are_put_together():
    rows = [row(1, speed=index / 7, delay=index % 5, value=float(index)) for index in range(100)]
    found, _ = cells(shown(rows))
    assert len(found) == 12 * 5


def test_of_very_many_texts_the_last_ones_are_put_together():
    rows = [row(1, text=f"t{index:03}", delay=index % 2, value=float(index)) for index in range(200)]
    page = shown(rows)
    found, _ = cells(page)
    assert len(found) == 96 + 2
    assert page.count(">others</text>") == page.count(">t095</text>")
    assert "t096" in found[-2][0]
    assert ">t096</text>" not in page


def test_a_parameter_that_is_named_like_a_column_has_one_of_its_own():
    found = columns(row(1, value=2.0, frames=7, speed=3, score="a", spawn=0))
    assert (found["frames"], found["param.frames"], found["spawn"]) == (20, 7, 0)
    assert (found["speed"], found["param.speed"], found["score"], found["param.score"]) == (None, 3, None, "a")
    assert found["time_to_collision"] == 2.0


def test_the_worst_runs_come_first_and_failed_ones_last():
    rows = [
        row(1, value=0.1, broken=()),
        row(2, broken=("is-long",)),
        row(3, value=0.05, broken=()),
        row(4, error="takes more than 5 s"),
        row(5, broken=()),
    ]
    page = shown(rows)
    seeds = re.findall(r'<tr><td class="number">(\d)</td>', page)
    assert seeds == ["2", "3", "1", "5"]
    assert page.index("is-long") < page.index("takes more than 5 s")
    assert "<h1>5 runs, 1 breaks rules, 1 failed</h1>" in page
    assert "<svg" not in page  # which needs two parameters


def test_of_runs_that_crash_the_fastest_comes_first_and_says_so():
    rows = [row(1, value=0.0), row(2, value=0.0), row(3, value=0.0), row(4, value=0.0), row(5, value=0.1)]
    for each, speed in ((rows[1], 3.0), (rows[2], 12.5), (rows[3], None)):
        each.report.results[COLLISIONS.name] = Result(1.0, 1.5, 41)
        if speed is not None:
            each.report.results[IMPACT_SPEED.name] = Result(speed, 1.5, 41)
    assert [each.run.seed for each in worst_first(rows, MEASURE)] == [3, 2, 4, 1, 5]
    crashes = [result_text(each.report.results, MEASURE).rpartition(", ")[0] for each in rows]
    assert crashes == ["", "crashed at 11 km/h", "crashed at 45 km/h", "crashed", ""]
    assert "12.5 m/s" in shown(rows)


def test_texts_cannot_become_markup():
    rows = [row(1, text=NASTY, other=NASTY * 100, broken=(NASTY,)), row(2, text="a", other="b", error=NASTY)]
    page = shown(rows)
    assert "<img" not in page
    assert "\x1b" not in page
    assert page.count("<style>") == page.count("</style>") == 1


def test_a_page_of_many_runs_stays_small():
    rows = [row(index, speed=index % 50, delay=index // 50, value=float(index)) for index in range(4_000)]
    page = shown(rows)
    assert len(page) < 2_000_000
    assert "and 2,000 more in campaign.json" in page
