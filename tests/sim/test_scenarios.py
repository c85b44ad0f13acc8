"""The scenarios: what happens in them, and what queries find in their recordings."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest

import carla_recap
from carla_recap.scene.lamps import LEFT_BLINKER, RIGHT_BLINKER
from carla_recap.sim import Location, World, load_town
from carla_recap.sim.errors import SimError
from carla_recap.sim.scenarios import BREAKDOWN, START, Blockage, Crash, largest_junction, straight_section
from tests.roads.towns import town as map_of
from tests.sim.flat import flat_town

pytest.importorskip("carla", reason="the extra `carla` is not installed")


@pytest.fixture(scope="module")
def town():
    return load_town()


# --- the accident ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crash(town, tmp_path_factory):
    """Return the actors of a crash, the collisions of the world, and the recording."""
    path = tmp_path_factory.mktemp("crash") / "crash.mcap"
    seen = []
    with World(town, date=0) as world:
        actors = Crash(world)
        world.recorder.start(path, additional_data=True, in_process=True)
        for frame in range(1, 1001):
            world.tick()
            seen += [(frame, hit.actor1, hit.actor2, hit.hero1, hit.hero2) for hit in world.events.collisions]
    return actors, seen, path


def test_the_hero_hits_the_walker_and_then_the_van(crash):
    actors, seen, _ = crash
    assert list(dict.fromkeys(hit[1:] for hit in seen)) == [
        (actors.hero.id, actors.walker.id, True, False),
        (actors.hero.id, actors.van.id, True, False),
    ]
    assert seen[0][0] * 0.05 > START
    assert actors.walker.has_fallen


def test_queries_find_the_collisions(crash):
    actors, seen, path = crash
    first = {}
    for frame, *pair in seen:
        first.setdefault(tuple(pair), frame)
    with carla_recap.open_recording(path) as recording:
        rows = [(row.frame, row.id1, row.id2, row.hero1, row.hero2) for row in recording.collisions()]
        assert rows == [(frame, *pair) for pair, frame in first.items()]
        assert [row.id2 for row in recording.collisions("h", "v")] == [actors.van.id]
        assert [row.id2 for row in recording.collisions("h", "w")] == [actors.walker.id]
        stood = {row.id: row.start for row in recording.blocked(30)}
        assert stood.keys() == {1, actors.hero.id, actors.van.id}  # the walker lies on the ground
        assert min(stood[actors.hero.id], stood[actors.van.id]) > rows[1][0] * 0.05


# --- the blocked lane --------------------------------------------------------------------------------------------------


def test_a_van_breaks_down_and_others_queue_behind_it(town):
    world = World(town, date=0)
    world.settings.collisions_of = "all"
    actors = Blockage(world)
    world.run(BREAKDOWN)
    assert world.vehicles.speed.min() > 3
    hits = []
    for _ in range(400):
        world.tick()
        hits += world.events.collisions
    assert not hits
    assert abs(world.vehicles.speed).max() < 0.05
    assert actors.van.light_state == LEFT_BLINKER | RIGHT_BLINKER
    places = [actors.van, *actors.queue]
    gaps = [
        front.transform.location.distance(rear.transform.location) - front.box.extent.x - rear.box.extent.x
        for front, rear in pairwise(places)
    ]
    assert all(0.5 < gap < 5 for gap in gaps)
    assert [car.is_hero for car in actors.queue] == [True, False, False]


def test_the_queue_drives_on_when_the_van_is_destroyed(town):
    world = World(town, date=0)
    actors = Blockage(world)
    world.run(25)
    actors.van.destroy()
    world.run(8)
    assert world.vehicles.speed.min() > 2


# --- where it can be staged --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["Town01", "Town02"])
@pytest.mark.parametrize("scene", [Crash, Blockage])
def test_scenarios_can_be_set_up_in_towns_of_carla(name, scene):
    world = World(load_town(map_of(name)), date=0)
    scene(world)
    world.run(1)


def test_a_town_without_a_straight_street_is_an_error(town):
    with pytest.raises(SimError, match=r"section of 1000 m; the longest of Brickfield is 1\d\d m") as raised:
        straight_section(town, 1000)
    longest = int(re.search("([0-9]+) m long", str(raised.value))[1])
    straight_section(town, longest)
    with pytest.raises(SimError):
        straight_section(town, longest + 1)


def test_the_largest_junction_is_one_with_lights(town):
    assert largest_junction(town).distance(Location(120, -110, 0)) < 3
    with pytest.raises(SimError, match="a junction with traffic lights was expected; Flat has none"):
        largest_junction(flat_town())
