from __future__ import annotations

from typing import Any

import pytest

from carla_recap.errors import RecapError
from carla_recap.model.records import NO_ACTOR, Spawn
from carla_recap.output.text import text
from carla_recap.queries.collisions import CollisionRow, collisions
from carla_recap.queries.incidents import IncidentOptions, incidents
from tests.queries.conftest import Make


def spawn(id: int, kind: int, type_id: str) -> Spawn:
    return Spawn(id, kind, 0, 0, 0, 0, 0, 0, 0, type_id)


CAST = [
    spawn(1, 1, "vehicle.hero"),
    spawn(2, 2, "walker.a"),
    spawn(3, 3, "traffic.traffic_light"),
    spawn(4, 4, "traffic.stop"),
    spawn(5, 5, "sensor.camera"),
    spawn(6, 200, "what.ever"),
    spawn(7, 0, "static.prop"),
]


def test_rows(make: Make) -> None:
    moving = {"velocities": [(1, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0), (2, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0)]}
    answer = collisions(make({"spawned": CAST, **moving}, {"collisions": [(9, 1, 2, 1, 0)]}))
    assert answer == [CollisionRow(0.5, 2, "v", 1, "vehicle.hero", True, "w", 2, "walker.a", False, 1, 5.0, 4.0)]


CONTACT, OTHER_WAY = {"collisions": [(0, 1, 2, 0, 0)]}, {"collisions": [(0, 2, 1, 0, 0)]}
TWICE = {"collisions": [(0, 1, 2, 0, 0), (1, 1, 2, 0, 0)]}


@pytest.mark.parametrize("compat", [False, True])
@pytest.mark.parametrize(
    ("frames", "preamble", "rows"),
    [
        ([{"spawned": CAST}, CONTACT, CONTACT, {}, CONTACT, CONTACT, OTHER_WAY], False, [(2, 1), (5, 1), (7, 2)]),
        ([CONTACT, {"spawned": CAST}, CONTACT], False, [(1, 1), (3, 1)]),
        ([[TWICE, TWICE], TWICE], False, [(1, 1)] * 4),
        ([CONTACT, CONTACT], True, [(0, 1)]),
    ],
    ids=["a contact that goes on", "other events bridge no gap", "repetitions within a frame", "before the first frame"],
)
def test_contacts_that_go_on_are_one_row(make: Make, frames: Any, preamble: bool, rows: Any, compat: bool) -> None:
    answer = collisions(make(*frames, preamble=preamble), compat=compat)
    assert [(row.frame, row.id1) for row in answer] == rows


def test_rows_say_which_contact_they_belong_to(make: Make) -> None:
    """Bounces and a second sensor give further rows, as in CARLA; an incident is a whole contact."""
    wall, both = {"collisions": [(0, 1, NO_ACTOR, 1, 0)]}, {"collisions": [(0, 1, 2, 1, 0), (0, 2, 1, 0, 1)]}
    reader = make({"spawned": CAST}, wall, {}, wall, both, {}, both, durations=[0.25] * 7)
    answer = collisions(reader)
    assert [(row.elapsed, row.contact) for row in answer] == [(0.25, 1), (0.75, 1), *[(1.0, 2)] * 2, *[(1.5, 2)] * 2]
    assert answer.contacts == 2
    found = incidents(reader, IncidentOptions(kinds=["collision"]))
    assert [(row.start, row.stop) for row in found] == [(0.25, 0.75), (1.0, 1.5)]
    assert [row.contact and row.contact.number for row in found] == [1, 2]
    assert [row.contact for row in collisions(reader, "w", "a")] == [2, 2]


def test_only_contacts_that_pass_the_filter_go_on(make: Make) -> None:
    """The hero flag is the record's own: the same pair may pass in one frame and not in the other."""
    as_hero, plain = {"collisions": [(0, 1, 2, 1, 0)]}, {"collisions": [(0, 1, 2, 0, 0)]}
    reader = make({"spawned": CAST}, as_hero, plain, as_hero)
    assert [row.frame for row in collisions(reader, "h", "a")] == [2, 4]
    assert [row.frame for row in collisions(reader)] == [2]


@pytest.mark.parametrize(("compat", "letters"), [(False, "vwtoooo"), (True, "vwthaoo")])
def test_letters(make: Make, compat: bool, letters: str) -> None:
    hits = [(0, id, NO_ACTOR, 0, 0) for id in range(1, 8)]
    answer = collisions(make({"spawned": CAST}, {"collisions": hits}), compat=compat)
    assert "".join(row.letter1 for row in answer) == letters
    assert {row.letter2 for row in answer} == {"o"}


def test_what_is_no_actor_is_other(make: Make) -> None:
    reader = make({"spawned": [spawn(NO_ACTOR, 1, "vehicle.odd")]}, {"collisions": [(0, NO_ACTOR, 99, 1, 0)]})
    (row,) = collisions(reader)
    assert (row.letter1, row.type_id1, row.hero1) == ("o", "vehicle.odd", True)
    assert (row.letter2, row.type_id2, row.hero2) == ("o", "", False)


@pytest.mark.parametrize(
    ("sides", "found"),
    [("aa", [1, 2, 3]), ("vw", [1]), ("hw", [1]), ("wh", []), ("ao", [3]), ("wv", [2]), ("ha", [1]), ("th", [])],
)
def test_filters(make: Make, sides: str, found: list[int]) -> None:
    hits = [(1, 1, 2, 1, 0), (2, 2, 1, 0, 0), (3, 1, 4, 0, 0)]
    reader = make({"spawned": CAST}, {"collisions": hits})
    known = {(1, 2): 1, (2, 1): 2, (1, 4): 3}
    assert [known[row.id1, row.id2] for row in collisions(reader, *sides)] == found


def test_carlas_sign_is_a_hero(make: Make) -> None:
    reader = make({"spawned": CAST}, {"collisions": [(0, 4, 1, 0, 0)]})
    assert not collisions(reader, "h", "a")
    assert len(collisions(reader, "h", "a", compat=True)) == 1


@pytest.mark.parametrize("sides", ["xa", "ax", ("", "a"), ("vv", "a")])
def test_unknown_filter(make: Make, sides: tuple[str, str]) -> None:
    reader = make({"collisions": [(0, 1, 2, 0, 0)]})
    with pytest.raises(RecapError, match="no type of a collision's actor"):
        collisions(reader, *sides)
    assert collisions(reader, *sides, compat=True) == []


def test_an_id_that_comes_again(make: Make) -> None:
    hit = {"collisions": [(0, 1, 1, 0, 0)]}
    again = {"spawned": [spawn(1, 2, "walker.b")]}
    reader = make({"spawned": CAST}, {"destroyed": [(1,)]}, again, hit)
    assert [row.type_id1 for row in collisions(reader)] == ["walker.b"]


@pytest.mark.parametrize(("compat", "duration"), [(False, "0.5"), (True, "0")])
def test_the_duration_keeps_its_decimals(make: Make, compat: bool, duration: str) -> None:
    printed = "".join(text(collisions(make({"collisions": [(0, 1, 2, 0, 0)]}, {}), compat=compat)))
    assert printed.endswith(f"\n\nFrames: 2\nDuration: {duration} seconds\n")


def test_speeds_are_found_unless_carlas_answer_or_none_are_asked_for(make: Make) -> None:
    moving = {"velocities": [(1, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0)]}
    reader = make({"spawned": CAST, **moving}, {"collisions": [(9, 1, 3, 1, 0)], **moving})
    assert [row.impact_speed for row in collisions(reader)] == [5.0]
    for options in ({"compat": True}, {"speeds": False}, {"compat": True, "speeds": False}):
        assert [str(row.impact_speed) for row in collisions(reader, **options)] == ["nan"]
