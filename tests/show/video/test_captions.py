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
FAR = incident(
    "collision", 10.0, 10.5, 3, 4, text="vehicle.bh.crossbike (3) collides with walker.pedestrian.0004 (4)", x=500.0
)


def captions(*incidents: Incident, followed: int | None = 1, **options: Any) -> Captions:
    return Captions(incidents, **{"start": 0.0, "stop": 60.0, "followed": followed} | options)


def texts(found: Captions, time: float, *args: Any) -> list[str]:
    return [caption.text for caption in found.at(time, *args)]


def test_a_collision_is_shown_from_its_start_for_some_seconds() -> None:
    found = captions(CRASH)
    assert [len(found.at(time)) for time in (9.9, 10.0, 13.0, 14.0)] == [0, 1, 1, 0]
    assert texts(found, 10.0) == ["Hero collides with Audi A2 (2)"]


def test_a_rounded_time_is_that_of_the_incident() -> None:
    late = incident("collision", 12.100000000000037, 12.5, 1, 2)
    assert texts(captions(late, start=12.1, stop=12.1), 12.1) == ["Hero does it"]


def test_captions_are_shown_for_seconds_of_the_video() -> None:
    slow, fast = (captions(CRASH, speed=speed) for speed in (0.25, 4.0))
    assert [len(slow.at(time)) for time in (10.8, 11.0)] == [1, 0]
    assert len(fast.at(20.0)) == 1


def test_a_long_stop_of_the_followed_actor_is_shown_all_the_time_and_does_not_count() -> None:
    found = captions(STOP)
    assert texts(found, 12.0) == []
    assert texts(found, 14.0) == texts(found, 31.0) == ["Hero stands still for 39 s"]
    assert texts(found, 51.0) == []


def test_a_long_stop_of_another_actor_is_mentioned_once() -> None:
    found = captions(STOP, followed=7)
    assert [len(found.at(time)) for time in (14.0, 31.0)] == [1, 0]


def test_captions_of_the_followed_actor_stand_above_those_of_others() -> None:
    found = captions(incident("collision", 10.0, 10.5, 3, 4, text="a crash"), BRAKING)
    assert texts(found, 10.4) == ["Hero brakes hard at 44 km/h", "A crash"]


def test_the_most_important_captions_are_the_first() -> None:
    found = captions(STOP, CRASH, BRAKING, incident("collision", 10.1, 10.2, 1, 9, text="hero collides with a wall"))
    assert texts(found, 10.4) == ["Hero collides with a wall", "Hero collides with Audi A2 (2)"]
    assert texts(captions(CRASH, BRAKING), 10.4) == ["Hero collides with Audi A2 (2)", "Hero brakes hard at 44 km/h"]


def test_incidents_of_others_are_shown_where_they_are_near() -> None:
    found = captions(FAR)
    assert texts(found, 10.0, is_near(0.0, 0.0)) == []
    assert texts(found, 10.0, is_near(460.0, 10.0)) == ["Crossbike (3) collides with pedestrian 0004 (4)"]


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
        ("vehicle.mercedes.sprinter", "Mercedes Sprinter"),
        ("vehicle.bmw.grandtourer", "BMW Grandtourer"),
        ("vehicle.harley-davidson.low_rider", "Harley-Davidson Low Rider"),
        ("walker.pedestrian.0004", "pedestrian 0004"),
        ("static.prop.trafficcone01", "Prop Trafficcone01"),
        ("vehicle", "vehicle"),
    ],
)
def test_names_read_well(type_id: str, name: str) -> None:
    assert readable_name(type_id) == name
