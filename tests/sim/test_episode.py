"""Episodes: the ids of actors, those that are wanted and those that are not, and the events of ticks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.server.actor_records import release_of, sensor_of, stream_of
from carla_recap.server.protocol import RELEASES
from carla_recap.sim.episode import LARGEST_ID, LARGEST_WANTED, ActorIds
from carla_recap.sim.errors import SimError
from tests.sim.flat import at, flat_world, spawn_car


def test_ids_follow_each_other_from_1() -> None:
    ids = ActorIds()
    assert [ids.new() for _ in range(3)] == [1, 2, 3]


def test_an_id_that_is_free_is_given_and_later_ones_are_larger() -> None:
    ids = ActorIds()
    assert (ids.new(234), ids.new()) == (234, 235)


def test_an_id_that_was_given_is_replaced_by_the_next_one() -> None:
    ids = ActorIds()
    assert (ids.new(5), ids.new(5), ids.new(6)) == (5, 6, 7)


def test_an_id_that_was_passed_over_is_free() -> None:
    ids = ActorIds()
    assert [ids.new(wanted) for wanted in (9, 3, 1, 8, 3, None)] == [9, 3, 1, 8, 10, 11]


def test_reserved_ids_are_for_actors_that_want_them() -> None:
    ids = ActorIds()
    ids.reserve(4)
    assert [ids.new(wanted) for wanted in (None, 2, 2, 4)] == [5, 2, 6, 4]


@pytest.mark.parametrize("wanted", [0, -1, LARGEST_WANTED + 1, 2**32 - 1])
def test_ids_out_of_range_are_not_given(wanted: int) -> None:
    ids = ActorIds()
    ids.reserve(wanted)
    assert (ids.new(wanted), ids.new()) == (1, 2)


def test_the_largest_id_can_be_wanted() -> None:
    ids = ActorIds()
    assert (ids.new(LARGEST_WANTED), ids.new(LARGEST_WANTED), ids.new(7)) == (LARGEST_WANTED, LARGEST_WANTED + 1, 7)


def test_streams_have_room_for_the_largest_id() -> None:
    ids = ActorIds()
    ids._next = LARGEST_ID
    world = flat_world()
    sensor = world.spawn("sensor.other.gnss", at(0.0))
    sensor.id = ids.new()
    assert {(sensor_of(stream_of(sensor, each)), release_of(stream_of(sensor, each))) for each in RELEASES} == {
        (LARGEST_ID, each) for each in RELEASES
    }
    with pytest.raises(SimError, match="expected at most 134217728 actors"):
        ids.new()


@given(st.lists(st.none() | st.integers(0, 30)))
def test_no_id_is_given_twice(wanted: list[int | None]) -> None:
    ids, given_before = ActorIds(), set[int]()
    for want in wanted:
        id = ids.new(want)
        assert id not in given_before
        assert id == want or want in (None, 0) or want in given_before
        given_before.add(id)


def test_events_are_pending_until_the_end_of_the_tick() -> None:
    world = flat_world()
    car = spawn_car(world, at(0.0))
    car.set_door(0, True)
    assert world.events.spawned == []
    assert world.episode.pending.spawned[-1] is car
    world.tick()
    assert world.events.spawned[-1] is car
    assert world.events.doors == [(car.id, 0, True)]
    assert world.episode.pending.doors == []


def test_an_episode_that_has_ended_has_no_live_actors() -> None:
    world = flat_world()
    car, spectator = spawn_car(world, at(0.0)), world.spectator
    world.reload()
    assert not car.is_alive
    assert not spectator.is_alive
