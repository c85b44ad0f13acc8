"""The staged accident."""

from __future__ import annotations

import pytest

from carla_recap import open_recording
from carla_recap.sim import World, load_town
from carla_recap.sim.errors import SimError
from carla_recap.sim.staging import START, Crash, _stage

pytest.importorskip("carla", reason="the extra `carla` is not installed")


@pytest.fixture(scope="module")
def town():
    return load_town()


def test_a_crash_is_recorded_as_it_was_staged(town, tmp_path):
    seen = []
    with World(town, date=0) as world:
        cast = Crash(world).cast
        world.start_recorder(tmp_path / "crash.mcap", additional_data=True)
        while world.elapsed < 50:
            world.tick()
            seen += [(world.elapsed, hit.actor1, hit.actor2) for hit in world.events.collisions]
    first = {}
    for time, *pair in seen:
        first.setdefault(tuple(pair), time)
    assert list(first) == [(cast.hero.id, cast.walker.id), (cast.hero.id, cast.van.id)]
    with open_recording(tmp_path / "crash.mcap") as recording:
        rows = [(row.elapsed, row.id1, row.id2, row.hero1) for row in recording.collisions()]
        assert rows == [(pytest.approx(time, abs=0.051), *pair, True) for pair, time in first.items()]
        assert START < rows[0][0] < rows[1][0]
        stood = {row.id: row.start for row in recording.blocked(30)}
        assert {cast.hero.id, cast.van.id, cast.walker.id} <= stood.keys()
        assert stood[cast.van.id] > rows[1][0]


def test_a_town_without_a_straight_street_has_no_stage(town):
    with pytest.raises(SimError, match="a straight lane of 131 m was expected"):
        _stage([lane for lane in town.lanes if lane.length < 60])
