"""The actor that the camera follows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from carla_recap import ActorKind, RecapError, Spawn, attributes
from carla_recap.model.records import NO_ACTOR
from carla_recap.replay import Player, choose_followed
from carla_recap.replay.follow import LiveChoice
from tests.replay.conftest import Record
from tests.replay.scripts import pose, spawn, velocity

CAST = [
    spawn(10, "spectator"),
    spawn(11),
    spawn(12),
    spawn(13, "walker.pedestrian.0001"),
    spawn(14, role_name="hero"),
    spawn(15, "static.prop.box"),
]
SENSOR = Spawn(1, ActorKind.SENSOR, type_id="sensor.camera.rgb", attributes=attributes(role_name="hero"))
NO_HERO = [actor for actor in CAST if actor.id != 14]


def frames(cast: list[Any], where: Callable[[int, int], float], count: int = 5) -> list[dict[str, Any]]:
    """Return a recording; `where` gives the x of an actor in a frame."""
    poses = [{"transforms": [pose(actor.id, where(actor.id, n)) for actor in cast]} for n in range(count)]
    return [{"spawned": cast, **poses[0]}, *poses[1:]]


def speeds(**speeds: float) -> Callable[[int, int], float]:
    return lambda id, n: speeds.get(f"id{id}", 0) * n


def test_a_given_actor(record: Record) -> None:
    recording = record({"spawned": CAST})
    assert Player(recording, follow=12).followed == 12
    assert Player(recording, follow="hero").followed == 14


@pytest.mark.parametrize(
    ("cast", "follow", "ignore_hero", "message"),
    [
        (CAST, 16, False, r"no actor 16 to follow; known ids are 14 \(hero\)"),
        ([], 1, False, "known ids are none"),
        (CAST, "ego", False, "found 'ego'"),
        (NO_HERO, "hero", False, "no hero to follow"),
        (CAST, "hero", True, "followed and ignored"),
        (CAST, 14, True, "followed and ignored"),
    ],
)
def test_who_cannot_be_followed(record: Record, cast: list[Any], follow: int | str, ignore_hero: bool, message: str) -> None:
    with pytest.raises(RecapError, match=message):
        Player(record({"spawned": cast}), follow=follow, ignore_hero=ignore_hero)


def slower(script: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return frames with velocities that explain the steps of actor 11 alone."""
    return [frame | {"velocities": [velocity(11, 3), velocity(12, 0)]} for frame in script]


def every_other(script: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return frames with actor 12 in every other one."""
    return [
        frame | {"transforms": [pose for pose in frame["transforms"] if pose[0] != 12 or n % 2 == 0]}
        for n, frame in enumerate(script)
    ]


MOVING = frames(NO_HERO, speeds(id11=100))
COMING_AND_GOING = [
    {"spawned": [spawn(1)], "transforms": [pose(1)]},
    {"spawned": [spawn(2)], "transforms": [pose(1, 100), pose(2)]},
    {"spawned": [spawn(3)], "transforms": [pose(2, 150), pose(1, 200), pose(3)]},
    {"destroyed": [(1,)], "transforms": [pose(2, 300), pose(3, 180)]},
    {"transforms": [pose(2, 450), pose(3, 360)]},
]
DESTROYED = [
    {"spawned": [spawn(1, role_name="hero"), spawn(2)], "transforms": [pose(1), pose(2)]},
    {"destroyed": [(1,)], "transforms": [pose(2)]},
    {"transforms": [pose(2)]},
]
CHOSEN: dict[str, tuple[list[dict[str, Any]], dict[tuple[float, float], int | None]]] = {
    "the hero first": ([{"spawned": CAST, "collisions": [(0, 12, 11, 0, 0)]}], {(0, 9): 14}),
    "the first to collide next, in what is played": (
        [
            {"spawned": NO_HERO, "collisions": [(0, NO_ACTOR, 15, 0, 0)]},
            {"collisions": [(1, NO_ACTOR, 12, 0, 0)]},
            {"collisions": [(2, 11, 12, 0, 0)]},
        ],
        {(0, 9): 12, (2, 9): 11},
    ),
    "the last collision counts": (
        [*MOVING[:3], {**MOVING[3], "collisions": [(1, 12, 15, 0, 0)]}, MOVING[4]],
        {(0, 2.99): 11, (0, 3.0): 12},
    ),
    "the vehicle that moves farthest last": (
        frames(NO_HERO, speeds(id10=900, id11=100, id12=200, id13=300, id15=400)),
        {(0, 9): 12},
    ),
    "by the length of the path": (
        frames(NO_HERO, lambda id, n: n * 30 if id == 11 else n % 2 * 100 if id == 12 else 0),
        {(0, 9): 12},
    ),
    "without jumps": (frames(NO_HERO, lambda id, n: n * 30 if id == 11 else (n > 2) * 1e6 if id == 12 else 0), {(0, 9): 11}),
    "without steps that the velocity does not explain": (
        slower(frames(NO_HERO, lambda id, n: n * 300 if id == 11 else n % 2 * 3000 if id == 12 else 0)),
        {(0, 9): 11},
    ),
    "also in every other frame": (every_other(frames(NO_HERO, speeds(id11=100, id12=300), count=9)), {(0, 9): 12}),
    "a walker if no vehicle moves": (
        frames([actor for actor in NO_HERO if not actor.type_id.startswith("vehicle")], speeds(id13=1, id15=9)),
        {(0, 9): 13},
    ),
    "none if nothing moves": (frames([CAST[0], CAST[-1]], speeds(id10=5)), {(0, 9): None}),
    "those that are present": (COMING_AND_GOING, {(0, 9): 2, (0, 2): 1, (2, 9): 3}),
    "none whose end is the start": (DESTROYED, {(0.5, 9): 1, (1.0, 9): 2}),
    "the last moment counts": (
        frames(NO_HERO, lambda id, n: 100 * n if id == 11 else 400 * (n > 2) if id == 12 else 0),
        {(0, 2.99): 11, (0, 3.0): 12},
    ),
}


@pytest.mark.parametrize("name", CHOSEN)
def test_the_actor_that_is_chosen(record: Record, name: str) -> None:
    script, chosen = CHOSEN[name]
    recording = record(*script)
    assert {part: choose_followed(recording.reader, start=part[0], stop=part[1]) for part in chosen} == chosen
    assert Player(recording).followed == choose_followed(recording.reader)


def test_another_actor_can_be_followed_while_the_hero_is_ignored(record: Record) -> None:
    assert Player(record({"spawned": CAST}), follow=12, ignore_hero=True).followed == 12


def drive(*places: float, **further: Any) -> dict[str, Any]:
    """Return a frame with actors 1, 2, ... at places along x, and further records."""
    return {"transforms": [pose(id, x) for id, x in enumerate(places, 1)], **further}


LIVE: dict[str, tuple[int | str, list[dict[str, Any]], list[int | None]]] = {
    "what moves until there is a hero": (
        "hero",
        [
            drive(0, 0, 0, spawned=[spawn(1), spawn(2, "walker.pedestrian.0001"), spawn(3)]),
            *(drive(0, 100 * n, 50 * n) for n in (1, 2, 3)),
            drive(0, 400, 200, spawned=[spawn(4, role_name="hero")]),
            drive(0, 500, 250),
        ],
        [None, 3, 3, 3, 4, 4],
    ),
    "a hero that is a vehicle": ("hero", [drive(0, 0, spawned=[SENSOR, spawn(2, role_name="hero")]), drive(0, 0)], [2, 2]),
    "another one when it disappears": (
        "hero",
        [
            drive(0, 0, spawned=[spawn(1), spawn(2)]),
            drive(100, 100),
            drive(200, 200, destroyed=[(1,)]),
            *(drive(100 * n, 100 * n) for n in (3, 4)),
        ],
        [None, 1, None, 2, 2],
    ),
    "a parked car where nothing moves": (
        "hero",
        [drive(0, spawned=[spawn(1)]), *(drive(0) for _ in range(5))],
        [None, None, None, 1, 1, 1],
    ),
    "none that is hidden below the roads": (
        "hero",
        [{"transforms": [pose(1, z=-5e4), pose(2)], "spawned": [spawn(1), spawn(2)] * (not n)} for n in range(5)],
        [None, None, None, 2, 2],
    ),
    "the one that is asked for": (
        7,
        [drive(0, spawned=[spawn(1)]), drive(100), drive(200, spawned=[spawn(7)]), drive(300)],
        [None, None, 7, 7],
    ),
}


@pytest.mark.parametrize("name", LIVE)
def test_a_live_view_follows(record: Record, name: str) -> None:
    follow, script, expected = LIVE[name]
    choice = LiveChoice(follow)
    assert [choice.choose(scene) for scene in Player(record(*script)).scenes()] == expected
