"""Episodes: the ids of actors, those that are wanted and those that are not, and the events of ticks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.server.actor_records import release_of, sensor_of, stream_of
from carla_recap.server.protocol import RELEASES
from carla_recap.sim.episode import LARGEST_ID, LARGEST_WANTED, ActorIds
from carla_recap.sim.errors import SimError
from tests.sim.flat import at, flat_world


@pytest.mark.parametrize(
    ("reserved", "wanted", "given"),
    [
        (0, [None, None, 234, None], [1, 2, 234, 235]),
        (0, [5, 5, 6], [5, 6, 7]),
        (0, [9, 3, 1, 8, 3, None], [9, 3, 1, 8, 10, 11]),
        (4, [None, 2, 2, 4], [5, 2, 6, 4]),
        (0, [LARGEST_WANTED, LARGEST_WANTED, 7], [LARGEST_WANTED, LARGEST_WANTED + 1, 7]),
    ],
)
def test_an_id_that_is_wanted_is_given_once_and_others_follow_the_largest(
    reserved: int, wanted: list[int | None], given: list[int]
) -> None:
    ids = ActorIds()
    ids.reserve(reserved)
    assert [ids.new(want) for want in wanted] == given


@pytest.mark.parametrize("wanted", [0, -1, LARGEST_WANTED + 1, 2**32 - 1])
def test_ids_out_of_range_are_not_given(wanted: int) -> None:
    ids = ActorIds()
    ids.reserve(wanted)
    assert (ids.new(wanted), ids.new()) == (1, 2)


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
