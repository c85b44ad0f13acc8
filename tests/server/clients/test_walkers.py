"""Walkers that are hit."""

from __future__ import annotations

import carla

from tests.server.clients.calls import ahead, drive, spawn, straight
from tests.waiting import wait_until


def test_a_walker_who_is_hit_lies_on_the_road_and_is_reported(world: carla.World) -> None:
    start = straight(world, 60.0)
    place = ahead(start, 25.0, up=start.location.z + 0.5)
    walker = spawn(world, "walker.pedestrian.0004", place, is_invincible="false")
    car = spawn(world, "vehicle.tesla.model3", start)
    sensor = world.spawn_actor(world.get_blueprint_library().find("sensor.other.collision"), carla.Transform(), car)
    collisions: list[carla.CollisionEvent] = []
    sensor.listen(collisions.append)
    drive(world, car, 100, throttle=1.0)
    wait_until(lambda: collisions)
    assert collisions[0].other_actor.id == walker.id
    rotation = walker.get_transform().rotation
    assert max(abs(rotation.pitch), abs(rotation.roll)) > 45.0
