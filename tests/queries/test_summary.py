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
from tests.cli.command import CROSSING, answer

CRASH = CROSSING.with_name("crash.mcap")


HERO = Spawn(7, ActorKind.VEHICLE, type_id="vehicle.audi.tt", attributes=attributes(role_name="hero"))


def recorded(tmp_path, places, suffix=".log", **events):
    """Record the hero at some x in m, a frame each second, and events: records by `at_` and the number of the frame."""
    with create_recording(tmp_path / f"run{suffix}", map_name="nowhere") as recorder:
        for number, x in enumerate(places):
            records = {"spawned": [HERO, *events.get("others", [])]} if number == 0 else events.get(f"at_{number}", {})
            recorder.add_frame(float(number), transforms=[(7, 100 * x, 0, 0, 0, 0, 0)], **records)
    return open_recording(tmp_path / f"run{suffix}")


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
@pytest.mark.parametrize(
    ("places", "events", "time", "distance", "top_speed"),
    [
        ([0, 10, 30, 30, 530, 535], {}, 5, 35, 15),  # of the slope around the second frame, not of the jump
        ([0, math.nan, 10, 20], {}, 3, 20, 10),
        (range(0, 90, 10), {"at_5": {"destroyed": [7], "spawned": [Spawn(7, ActorKind.VEHICLE)]}}, 4, 40, 10),
    ],
    ids=["a jump", "no number", "another actor with its id"],
)
def test_the_way_of_the_hero(tmp_path, suffix, places, events, time, distance, top_speed):
    with recorded(tmp_path, places, suffix, **events) as recording, pytest.warns(RecapWarning, match="'nowhere' is unknown"):
        hero = recording.summary.hero
    assert (hero.id, hero.type_id, hero.time) == (7, "vehicle.audi.tt", time)
    assert (hero.distance, hero.top_speed) == pytest.approx((distance, top_speed))


@pytest.mark.parametrize(
    ("types", "words"),
    [
        (["static.prop.mesh"] * 3 + ["static.prop.bin"], "4 others (3 static.prop.mesh)"),
        (["static.prop.mesh", "static.prop.mesh", "static.prop.bin", "static.prop.box"], "4 others"),
        (["static.prop.mesh"], "1 other"),
    ],
)
def test_others_that_are_mostly_of_one_blueprint_say_so(tmp_path, types, words):
    others = [Spawn(100 + number, ActorKind.OTHER, type_id=name) for number, name in enumerate(types)]
    with recorded(tmp_path, [0, 10], others=others) as recording, pytest.warns(RecapWarning):
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
