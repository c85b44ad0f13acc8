"""Random traffic."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.model.records import ActorKind
from carla_recap.sim import Location, World, load_town
from carla_recap.sim.errors import SimError
from carla_recap.sim.town.sidewalks import WalkwayGraph
from carla_recap.sim.traffic.spawning import populate
from tests.sim.flat import at, flat_world, lane

pytest.importorskip("carla", reason="the extra `carla` is not installed")


@pytest.fixture(scope="module")
def town():
    return load_town()


def test_vehicles_drive_and_walkers_walk(town):
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


def test_the_seed_determines_actors_and_places(town):
    def cast(seed):
        return [(actor.type_id, actor.transform.location.x) for actor in populate(World(town, seed=seed, date=0), 5, 5)]

    assert cast(1) == cast(1) != cast(2)


def test_more_vehicles_than_there_is_room_for_are_an_error(town):
    world, place = World(town, date=0), Location(120, -110, 0)
    before = len(world.actors)
    for vehicles, around in ((100_000, None), (200, place)):
        with pytest.raises(SimError, match=rf"Brickfield has room for \d+ more vehicles, {vehicles} were expected"):
            populate(world, vehicles, 0, around=around)
    with pytest.raises(SimError, match="Brickfield has no sidewalk within 80 m of"):
        populate(world, 0, 1, around=Location(5000, 0, 0))
    with pytest.raises(SimError, match="Flat has no place for a vehicle: no lanes for cars that lead anywhere"):
        populate(flat_world(lanes=[lane(junction=1)]), 1, 0)
    assert len(world.actors) == before


def test_traffic_around_a_location(town):
    world, place = World(town, seed=5, date=0), Location(120, -110, 0)
    cast = populate(world, 12, 6, around=place)
    assert max(actor.transform.location.distance(place) for actor in cast) < 81
    assert all(walker.destination.distance(place) < 81 for walker in cast[12:])


@pytest.mark.parametrize("counts", [(-1, 0), (0, -1), (float("nan"), 0)])
def test_negative_and_fractional_numbers_are_errors(counts: tuple[int, int]) -> None:
    with pytest.raises(SimError, match="expected 0 or a larger whole number"):
        populate(flat_world(), *counts)


def test_walkers_for_which_there_is_no_room_are_left_out_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    nodes = np.array([(10.0 * number, 5.0, 0.0) for number in range(3)])
    walks = WalkwayGraph(nodes, np.array(((0, 1), (1, 2))), np.zeros(2, np.bool_))
    world = flat_world(walks=walks)
    for number in range(3):
        world.spawn("static.prop.container", at(10.0 * number, 5.0))
    assert len(populate(world, 2, 20)) == 2
    assert len(populate(flat_world(), 2, 5)) == 2
    assert caplog.messages == [
        "Flat has room for 0 more walkers, 20 were expected",
        "Flat has no sidewalks, 5 walkers were expected",
    ]
