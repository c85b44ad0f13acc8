"""The summary of a recording: actors and incidents by kind, and the way of the hero."""

from __future__ import annotations

import json
import math

import pytest

from carla_recap import ActorKind, RecapWarning, Spawn, attributes, create_recording, open_recording
from carla_recap.output.json import json as json_text
from carla_recap.output.text import text
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.queries.summary import summary
from tests.cli.command import CROSSING, answer, run, the_line

CRASH = CROSSING.with_name("crash.mcap")


@pytest.fixture
def recorded(tmp_path):
    """Return a function that records the hero at some x in m, a frame each second."""

    def record(places, suffix=".log", **more):
        spawn = Spawn(7, ActorKind.VEHICLE, type_id="vehicle.audi.tt", attributes=attributes(role_name="hero"))
        with create_recording(tmp_path / f"run{suffix}", map_name="nowhere") as recorder:
            for number, x in enumerate(places):
                records = {"spawned": [spawn, *more.get("others", [])]} if number == 0 else {}
                recorder.add_frame(float(number), transforms=[(7, 100 * x, 0, 0, 0, 0, 0)], **records)
        return open_recording(tmp_path / f"run{suffix}")

    return record


def test_actors_are_counted_by_kind_vehicles_and_walkers_first():
    with open_recording(CRASH) as recording:
        found = recording.summary
        assert list(found.actors.items())[:3] == [("vehicle", 5), ("walker", 4), ("other", 1)]
        assert sum(found.actors.values()) == len(recording.actors)
        assert (found.map, found.frames) == ("Brickfield", 1200)


def test_incidents_are_those_of_all_kinds():
    with open_recording(CRASH) as recording:
        found = recording.incidents(kinds="all")
        assert sum(recording.summary.incidents.values()) == len(found)
        assert recording.summary.incidents["collision"] == sum(each.kind == "collision" for each in found)


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_the_way_of_the_hero_has_no_jumps(recorded, suffix):
    with recorded([0, 10, 30, 30, 530, 535], suffix) as recording, pytest.warns(RecapWarning, match="'nowhere' is unknown"):
        hero = recording.summary.hero
    assert (hero.id, hero.type_id, hero.time) == (7, "vehicle.audi.tt", 5)
    assert hero.distance == pytest.approx(35)
    assert hero.top_speed == pytest.approx(15)  # of the slope around the second frame


def test_the_way_of_the_hero_ends_where_another_actor_gets_its_id(tmp_path):
    spawn = Spawn(7, ActorKind.VEHICLE, type_id="vehicle.audi.tt", attributes=attributes(role_name="hero"))
    with create_recording(tmp_path / "a.log", map_name="nowhere") as recorder:
        for number in range(9):
            again = {"destroyed": [7], "spawned": [Spawn(7, ActorKind.VEHICLE)]} if number == 5 else {}
            records = {"spawned": [spawn]} if number == 0 else again
            recorder.add_frame(float(number), transforms=[(7, 100 * number, 0, 0, 0, 0, 0)], **records)
    with open_recording(tmp_path / "a.log") as recording, pytest.warns(RecapWarning, match="'nowhere' is unknown"):
        hero = recording.summary.hero
    assert (hero.time, hero.distance) == (4, 4)


def test_places_that_are_not_finite_do_not_count(recorded):
    with recorded([0, math.nan, 10, 20]) as recording, pytest.warns(RecapWarning):
        assert recording.summary.hero.distance == pytest.approx(20)


@pytest.mark.parametrize(
    ("types", "words"),
    [
        (["static.prop.mesh"] * 3 + ["static.prop.bin"], "4 others (3 static.prop.mesh)"),
        (["static.prop.mesh", "static.prop.mesh", "static.prop.bin", "static.prop.box"], "4 others"),
        (["static.prop.mesh"], "1 other"),
    ],
)
def test_others_that_are_mostly_of_one_blueprint_say_so(recorded, types, words):
    others = [Spawn(100 + number, ActorKind.OTHER, type_id=name) for number, name in enumerate(types)]
    with recorded([0, 10], others=others) as recording, pytest.warns(RecapWarning):
        shown = "".join(text(summary(recording.reader, options=IncidentOptions(kinds="all"))))
    assert f"Actors: 1 vehicle, {words}\n" in shown


def test_without_a_hero_there_is_none(tmp_path):
    with create_recording(tmp_path / "run.log", map_name="nowhere") as recorder:
        recorder.add_frame(0.0)
    with open_recording(tmp_path / "run.log") as recording, pytest.warns(RecapWarning):
        assert (recording.summary.hero, recording.summary.actors, recording.summary.incidents) == (None, {}, {})


def test_the_text_of_one_recording_has_few_lines_and_of_many_a_line_each_and_json_the_fields():
    with open_recording(CRASH) as recording:
        found = summary(recording.reader, options=IncidentOptions(kinds="all"))
    alone = "".join(text(found)).splitlines()
    assert len(alone) <= 15
    assert "Actors: 5 vehicles, 4 walkers, 1 other, 17 traffic lights, 22 traffic signs, 1 sensor" in alone
    heading, *rows = answer("summary", CRASH, CRASH.with_name("avoided.mcap")).splitlines()
    assert (heading.split()[0], len(rows)) == ("Recording", 2)
    assert rows[1].endswith("Brickfield   1 near miss")
    (row,) = json.loads("".join(json_text(found)))["rows"]
    assert (row["actors"]["vehicle"], row["hero"]["id"], row["incidents"]["collision"]) == (5, 41, 2)


def test_an_unknown_map_is_said():
    assert "the map 'Crossing' is unknown; rules of the road are left out" in the_line(run("summary", CROSSING).stderr)
