"""Contacts: which collision records belong together, whose motion they affect, and who has caused them."""

from __future__ import annotations

import math

import pytest

from carla_recap.model.contacts import AT_FAULT, UNKNOWN, Contact, Contacts, Impact
from carla_recap.model.frame import Frame
from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn

Pair = tuple[int, int]
LIVES = {id: ActorLife.of(Spawn(id, 1), 0.0) for id in range(1, 5)}


def collected(*touched: tuple[float, Pair], frames_between: int = 1) -> Contacts:
    """Return the contacts of pairs that touch at some elapsed seconds, each in a frame of its own."""
    contacts = Contacts()
    for order, (elapsed, pair) in enumerate(touched):
        number = order * (frames_between + 1)
        contacts.add(Frame(number, number + 1, elapsed, 0.05, []).replace(collisions=[(0, *pair, 1, 0)]))
    for contact in contacts:
        contact.actors = tuple(LIVES[id] for id in contact.ids)
    return contacts


def test_records_of_a_pair_belong_together_if_less_than_a_second_is_between_them() -> None:
    contacts = collected((1.0, (1, 2)), (1.5, (2, 1)), (2.25, (1, 2)), (3.25, (2, 1)), (3.5, (1, 3)))
    assert [(each.number, each.ids, each.start, each.stop) for each in contacts] == [
        (1, (1, 2), 1.0, 2.25),
        (2, (2, 1), 3.25, 3.25),
        (3, (1, 3), 3.5, 3.5),
    ]
    assert [each.key for each in contacts] == [(0, 1, 2), (6, 2, 1), (8, 1, 3)]
    assert [each.heroes for each in contacts] == [(True, False)] * 3
    assert [each.number for each in contacts.of(LIVES[2], LIVES[1])] == [1, 2]
    assert contacts.of(LIVES[2], LIVES[3]) == []


def test_an_actor_has_no_part_in_contacts_of_one_that_had_its_id_before() -> None:
    contacts, later = collected((1.0, (1, 2))), ActorLife.of(Spawn(2, 1), 1.2)
    frame = Frame(1, 2, 1.2, 0.05, []).replace(spawned=[Spawn(2, 1)], collisions=[(0, 1, 2, 1, 0)])
    contacts.add(frame)
    _, contact = contacts
    contact.actors = LIVES[1], later
    assert [contacts.of(LIVES[1], life) for life in (LIVES[2], later)] == [[next(iter(contacts))], [contact]]
    assert contacts.affected(later, 0.0) == [(1.2, 1.7)]


def test_records_of_adjacent_frames_belong_together_whatever_the_time_between_them() -> None:
    touched = [(1.5 * number, (1, 2)) for number in range(10)]
    assert [(each.number, each.start, each.stop) for each in collected(*touched, frames_between=0)] == [(1, 0.0, 13.5)]
    assert len(list(collected(*touched))) == 10


def test_motion_is_affected_until_half_a_second_after_a_contact() -> None:
    contacts = collected((1.0, (1, 2)), (1.25, (1, 2)), (3.0, (1, 3)))
    assert contacts.affected(LIVES[1], 0.25) == [(0.75, 1.75), (2.75, 3.5)]
    assert contacts.affected(LIVES[2], 0.0) == [(1.0, 1.75)]
    assert contacts.affected(LIVES[4], 0.25) == []


def test_motion_is_affected_between_contacts_with_two_actors_that_follow_each_other() -> None:
    assert collected((1.0, (1, 2)), (1.75, (3, 1)), (1.875, (1, 2))).affected(LIVES[1], 0.0) == [(1.0, 2.375)]


@pytest.mark.parametrize(
    ("speeds", "causes"),
    [
        ((5.0, 0.0), (True, False)),
        ((0.0, 1.5), (False, True)),
        ((AT_FAULT, AT_FAULT - 0.001), (True, False)),
        ((3.0, math.nan), (True, True)),
        ((0.0, 0.0), (False, False)),
    ],
)
def test_who_stands_has_not_caused_a_contact(speeds: tuple[float, float], causes: tuple[bool, bool]) -> None:
    """CARLA's criteria do not count a collision of an actor that is slower than 0.1 m/s."""
    first, second = (UNKNOWN if math.isnan(speed) else (0.0, -speed, 0.0) for speed in speeds)
    contact = Contact(1, (7, 8), (False, False), 3, 1.0, 1.0, Impact(3, 7, 8, velocities=(first, second)))
    assert (contact.is_caused_by(7), contact.is_caused_by(8)) == causes
    assert not contact.is_caused_by(9)


def test_without_an_impact_both_actors_may_have_caused_a_contact() -> None:
    contact = Contact(1, (7, 8), (False, False), 3, 1.0, 1.0)
    assert [contact.is_caused_by(id) for id in (7, 8, 9)] == [True, True, False]
