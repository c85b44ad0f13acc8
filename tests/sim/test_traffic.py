"""Traffic at random."""

from __future__ import annotations

import pytest

from carla_recap.records import ActorKind
from carla_recap.sim import World, load_town
from carla_recap.sim.errors import SimError
from carla_recap.sim.traffic import populate

pytest.importorskip("carla", reason="the extra `carla` is not installed")


@pytest.fixture(scope="module")
def town():
    return load_town()


def test_vehicles_drive_and_walkers_stroll(town):
    world = World(town, seed=5, date=0)
    cast = populate(world, 8, 4, hero=True)
    assert [actor.kind for actor in cast] == [ActorKind.VEHICLE] * 8 + [ActorKind.WALKER] * 4
    assert [actor.is_hero for actor in cast] == [True] + [False] * 11
    (sensor,) = (actor for actor in world.actors.values() if actor.kind == ActorKind.SENSOR)
    assert sensor.parent is cast[0]
    before = [actor.transform.location for actor in cast]
    world.run(20)
    gone = [actor.transform.location.distance(place) for actor, place in zip(cast, before, strict=True)]
    assert sum(way > 5 for way in gone[:8]) >= 6
    assert sum(way > 2 for way in gone[8:]) >= 3


def test_walkers_that_arrive_go_on(town):
    world = World(town, seed=5, date=0)
    (walker,) = populate(world, 0, 1)
    walker.destination = None
    world.run(2)
    assert walker.destination is not None


def test_the_seed_says_who_appears_and_where(town):
    def cast(seed):
        return [(actor.type_id, actor.transform.location.x) for actor in populate(World(town, seed=seed, date=0), 5, 5)]

    assert cast(1) == cast(1) != cast(2)


def test_no_more_than_there_is_room_for(town):
    with pytest.raises(SimError, match=r"Brickfield has room for \d+ more vehicles, 100000 were expected"):
        populate(World(town, date=0), 100_000, 0)
