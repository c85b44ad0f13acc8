"""Recorded collisions, as collision sensors of CARLA's own client get them in a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.samples import CRASH
from tests.server.client import Data, sensor
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    import carla

HERO, WALKER = "vehicle.tesla.model3", "walker.pedestrian.0004"
START, IMPACT = 9.5, 12.1  # s
DELTA = 0.05


def test_sensors_on_both_replayed_actors_get_the_recorded_collision(client: carla.Client, world: carla.World) -> None:
    client.replay_file(str(CRASH), START, 0.0, 0, False)
    world.tick()
    begin = world.get_snapshot().timestamp.elapsed_seconds
    actors = world.get_actors()
    (hero,) = (actor for actor in actors.filter(HERO) if actor.attributes["role_name"] == "hero")
    (walker,) = actors.filter(WALKER)
    data = [Data(sensor(world, "other.collision", actor)) for actor in (hero, walker)]
    while world.get_snapshot().timestamp.elapsed_seconds < begin + IMPACT - START + 0.5:
        world.tick()
    events = [each.get(timeout=PATIENCE) for each in data]
    assert [(event.actor.id, event.other_actor.id) for event in events] == [(hero.id, walker.id), (walker.id, hero.id)]
    assert events[0].frame == events[1].frame
    assert events[0].timestamp == pytest.approx(begin + IMPACT - START, abs=3 * DELTA)
    away = walker.get_location() - hero.get_location()
    assert events[1].normal_impulse.dot(away) > 0.0
    client.stop_replayer(False)
