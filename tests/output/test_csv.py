"""Answers as CSV: of one recording, and of many."""

from __future__ import annotations

import csv
import io
import math

import pytest

from carla_recap import open_recording
from carla_recap.output import csv as output
from carla_recap.queries.measures import measures_over_time
from carla_recap.queries.recorded_actors import actors
from tests.cli.command import CROSSING, answer, error
from tests.replay.scripts import spawn, write

AVOIDED = CROSSING.with_name("avoided.mcap")


@pytest.fixture(scope="module")
def avoided():
    with open_recording(AVOIDED) as recording:
        yield recording


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_the_columns_are_the_measures_over_time(avoided):
    series = avoided.time_series(44)
    rows = table(answer("measures", AVOIDED, "--over-time", "--actor", 44, "--csv"))
    assert len(rows) == len(series)
    for name, values in series.columns().items():
        known = [math.isfinite(value) and not (name in ("leader", "threat", "nearest") and value < 0) for value in values]
        assert [row[name] for row in rows] == [
            str(value) if is_known else "" for value, is_known in zip(values, known, strict=True)
        ]


def test_of_a_pair_each_is_measured_with_the_other_alone(avoided):
    rows = table("".join(output.csv(measures_over_time(avoided.reader, pair=("hero", 44)))))
    assert {row["actor"] for row in rows} == {"41", "44"}
    assert {row["nearest"] for row in rows if row["actor"] == "44"} == {"41"}


def test_extremes_are_a_table_too(avoided):
    rows = table("".join(output.csv(avoided.measures())))
    assert {row["measure"] for row in rows} >= {"gap", "time_to_collision"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--pair", "hero", "44", "--actor", "44"), "--pair and --actor"),
        (("--over-time", "--map", "town.xodr"), "--map is about the extremes"),
        (("--pair", "hero", "7"), "no vehicle or walker 7"),
    ],
)
def test_what_does_not_go_together_is_an_error(arguments, message):
    assert message in error("measures", AVOIDED, *arguments)


def test_a_text_with_a_carriage_return_is_one_cell(tmp_path):
    path, role = tmp_path / "run.log", "a\rb"
    write(path, [{"spawned": [spawn(1, role_name=role)]}])
    with open_recording(path) as recording:
        text = "".join(output.csv(actors(recording.reader)))
    (row,) = csv.DictReader(io.StringIO(text, newline=""))
    assert row["role_name"] == role
