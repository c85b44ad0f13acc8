"""Captions: which incidents they are about, when, and in which words."""

from __future__ import annotations

from typing import Any

import pytest

from carla_recap.queries.incidents import Incident
from carla_recap.scene.captions import readable_name
from carla_recap.show.video.overlay import Captions, is_near


def incident(kind: Any, start: float, stop: float, *actors: int, text: str = "hero does it", x: float = 0.0) -> Incident:
    return Incident(kind, start, stop, actors, ("",) * len(actors), x, 0.0, 0.0, "", 0.0, "", 0.0, start, text)


CRASH = incident("collision", 10.0, 10.5, 1, 2, text="hero collides with vehicle.audi.a2 (2)")
BRAKING = incident("hard braking", 9.0, 9.8, 1, text="hero brakes hard at 44 km/h")
STOP = incident("blocked", 11.0, 50.0, 1, text="hero stands still for 39 s")
BIKE = "vehicle.bh.crossbike (3) collides with walker.pedestrian.0004 (4)"
FAR = incident("collision", 10.0, 10.5, 3, 4, text=BIKE, x=500.0)
CRASH_TEXT, BRAKING_TEXT = "Hero collides with Audi A2 (2)", "Hero brakes hard at 44 km/h"
WALL = incident("collision", 10.1, 10.2, 1, 9, text="hero collides with a wall")
OTHERS = incident("collision", 10.0, 10.5, 3, 4, text="a crash")
LATE = incident("collision", 12.100000000000037, 12.5, 1, 2)  # a rounded time is that of the incident
STOP_TEXT = "Hero stands still for 39 s"


def captions(*incidents: Incident, **options: Any) -> Captions:
    return Captions(incidents, **{"start": 0.0, "stop": 60.0, "followed": 1} | options)


@pytest.mark.parametrize(
    ("incidents", "options", "shown"),
    [
        ([CRASH], {}, {9.9: [], 10.0: [CRASH_TEXT], 13.0: [CRASH_TEXT], 14.0: []}),
        ([LATE], {"start": 12.1, "stop": 12.1}, {12.1: ["Hero does it"]}),
        ([CRASH], {"speed": 0.25}, {10.8: [CRASH_TEXT], 11.0: []}),
        ([CRASH], {"speed": 4.0}, {20.0: [CRASH_TEXT]}),
        ([STOP], {}, {12.0: [], 14.0: [STOP_TEXT], 31.0: [STOP_TEXT], 51.0: []}),
        ([STOP], {"followed": 7}, {14.0: [STOP_TEXT], 31.0: []}),
        ([OTHERS, BRAKING], {}, {10.4: [BRAKING_TEXT, "A crash"]}),
        ([STOP, CRASH, BRAKING, WALL], {}, {10.4: ["Hero collides with a wall", CRASH_TEXT]}),
        ([CRASH, BRAKING], {}, {10.4: [CRASH_TEXT, BRAKING_TEXT]}),
    ],
    ids=["seconds", "rounded", "slow", "fast", "long stop", "of another", "followed first", "important first", "two"],
)
def test_captions_at_times(incidents: list[Incident], options: Any, shown: dict[float, list[str]]) -> None:
    found = captions(*incidents, **options)
    assert {time: [caption.text for caption in found.at(time)] for time in shown} == shown


@pytest.mark.parametrize(
    ("place", "texts"), [((0.0, 0.0), []), ((460.0, 10.0), ["Crossbike (3) collides with pedestrian 0004 (4)"])]
)
def test_incidents_of_others_are_shown_where_they_are_near(place: tuple[float, float], texts: list[str]) -> None:
    assert [caption.text for caption in captions(FAR).at(10.0, is_near(*place))] == texts


def test_a_caption_fades_at_its_end() -> None:
    found = captions(CRASH)
    opacities = [caption.opacity for time in (10.0, 12.0, 13.3, 13.49) for caption in found.at(time)]
    assert opacities[:2] == [1, 1]
    assert 1 > opacities[2] > opacities[3] > 0


def test_marks_are_the_incidents_of_the_followed_actor_within_the_video() -> None:
    found = captions(CRASH, FAR, incident("collision", 70.0, 70.0, 1), start=5.0, stop=15.0)
    assert list(found.marks()) == [(0.5, "collision")]


@pytest.mark.parametrize(
    ("type_id", "name"),
    [
        ("vehicle.audi.a2", "Audi A2"),
        ("vehicle.harley-davidson.low_rider", "Harley-Davidson Low Rider"),
        ("walker.pedestrian.0004", "pedestrian 0004"),
        ("static.prop.trafficcone01", "Prop Trafficcone01"),
        ("vehicle", "vehicle"),
    ],
)
def test_names_read_well(type_id: str, name: str) -> None:
    assert readable_name(type_id) == name
