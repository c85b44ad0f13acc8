"""Who had an id when, what a text calls it, and what is no actor."""

from __future__ import annotations

import math

import pytest

from carla_recap.model.frame import Frame
from carla_recap.model.lives import STATIC_OBJECT, ActorLife, ActorLives, BoundingBox
from carla_recap.model.records import NO_ACTOR, Spawn, attributes

CAR = Spawn(7, 1, 100.0, 200.0, 300.0, type_id="vehicle.a", attributes=attributes(role_name="hero"))
WALKER = Spawn(7, 2, type_id="walker.b")
CAMERA = Spawn(8, 5, type_id="sensor.c")


def lives_of(*frames: dict[str, object], seconds: float = 1.0) -> ActorLives:
    """Return the actors of frames of a second each, or of others."""
    lives = ActorLives()
    for number, records in enumerate(frames):
        lives.add(Frame(number, number + 1, number * seconds, seconds, []).replace(**records).packets, number * seconds)
    return lives


def test_an_id_that_is_used_again_belongs_to_the_latest_actor() -> None:
    lives = lives_of({}, {"spawned": [CAR]}, {"destroyed": [(7,)]}, {}, {"spawned": [WALKER]})
    found = [lives.at(7, time) for time in (0.0, 1.0, 3.9, 4.0, 9.0)]
    assert [life and life.type_id for life in found] == ["vehicle.a"] * 3 + ["walker.b"] * 2
    assert [(life.spawned_at, life.destroyed_at, life.end) for life in lives] == [(1.0, 2.0, 2.0), (4.0, None, math.inf)]
    assert lives.at(9, 1.0) is None
    assert lives.reuses() == {7: [4.0]}
    assert (lives.ids(), lives.ids("vehicle"), lives.ids("sensor", "walker"), lives.ids("sensor")) == ([7], [7], [7], [])


def test_an_actor_ends_where_another_one_gets_its_id() -> None:
    lives = lives_of({"spawned": [CAR]}, {}, {"spawned": [WALKER]}, {}, {"destroyed": [(7,)]})
    assert [(life.type_id, life.spawned_at, life.end) for life in lives] == [("vehicle.a", 0.0, 2.0), ("walker.b", 2.0, 4.0)]


def test_parents_and_boxes_belong_to_the_present_actor() -> None:
    box = (8, 10.0, 20.0, 30.0, 100.0, 50.0, 25.0)
    lives = lives_of(
        {"parented": [(8, 1)]},
        {"spawned": [CAR, CAMERA], "parented": [(8, 7)], "bounding_boxes": [box]},
        {"parented": [(7, 8)], "bounding_boxes": [(8, *[math.nan] * 6), (7, 0.0, 0.0, 0.0, 100.0, 0.0, 25.0)]},
        {"destroyed": [(8,)]},
        {"parented": [(8, 9)]},
    )
    car, camera = lives
    assert (car.parent, car.attached, car.bounding_box) == (8, False, None)
    assert (camera.parent, camera.attached, camera.destroyed_at) == (7, True, 3.0)
    assert camera.bounding_box == BoundingBox(0.1, -0.2, 0.3, 1.0, 0.5, 0.25)


@pytest.mark.parametrize("seconds", [1.0, 0.0, math.nan])
def test_an_actor_is_attached_whose_parent_is_in_the_frame_of_its_spawn(seconds: float) -> None:
    first, second = {"spawned": [CAR, CAMERA], "parented": [(8, 7)]}, {"parented": [(7, 8)]}
    assert [life.attached for life in lives_of(first, second, seconds=seconds)] == [False, True]


def test_what_a_text_calls_an_actor() -> None:
    lives = ActorLives([ActorLife.of(CAR, 0.0), ActorLife.of(CAMERA, 0.0)])
    assert [lives.name(id, 0.0) for id in (7, 8, 9)] == ["hero", "sensor.c (8)", "actor 9"]
    assert lives.type_ids((8, 9), 0.0) == ("sensor.c", "")
    assert [lives.kind(id, 0.0) for id in (7, 8, 9)] == ["vehicle", "sensor", ""]


def test_static_objects_are_no_actors() -> None:
    """Before CARLA 0.9.13 their id is 0, which an actor may have, too."""
    light = ActorLife.of(Spawn(5, 3, type_id="traffic.traffic_light"), 0.0)
    lives = ActorLives([light, ActorLife.of(Spawn(NO_ACTOR, 1, type_id="vehicle.odd"), 0.0)])
    assert [lives.name(id, 1.0) for id in (NO_ACTOR, 0)] == [STATIC_OBJECT] * 2
    assert [lives.is_fixed(id, 1.0) for id in (NO_ACTOR, 0, 5, 6)] == [True, True, True, False]
    with_zero = ActorLives([ActorLife.of(Spawn(0, 1, type_id="vehicle.zero"), 0.0)])
    assert not with_zero.is_object(0)
    assert with_zero.name(0, 1.0) == "vehicle.zero (0)"
