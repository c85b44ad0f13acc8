"""What the tests of real clients share: places, spawning, driving."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import carla

if TYPE_CHECKING:
    from collections.abc import Iterable


def spawn(world: carla.World, blueprint: str, place: carla.Transform, **attributes: str) -> carla.Actor:
    """Spawn an actor."""
    found = world.get_blueprint_library().find(blueprint)
    for name, value in attributes.items():
        found.set_attribute(name, value)
    return world.spawn_actor(found, place)


def straight(world: carla.World, length: float) -> carla.Transform:
    """Return a spawn point with a straight lane of a length in m before it."""
    roads = world.get_map()
    for point in roads.get_spawn_points():
        waypoint, yaw = roads.get_waypoint(point.location), point.rotation.yaw
        ahead = [waypoint.next(distance) for distance in range(5, int(length) + 1, 5)]
        turns = [math.remainder(found[0].transform.rotation.yaw - yaw, 360.0) if found else 180.0 for found in ahead]
        if all(abs(turn) < 1.0 for turn in turns):
            return point
    raise AssertionError(f"no lane is straight for {length} m")


def ahead(place: carla.Transform, distance: float, up: float = 0.0) -> carla.Transform:
    """Return the transform a distance before a place, in m."""
    forward, location = place.get_forward_vector(), place.location
    there = carla.Location(location.x + distance * forward.x, location.y + distance * forward.y, location.z + up)
    return carla.Transform(there, place.rotation)


def speed(actor: carla.Actor) -> float:
    """Return the speed of an actor over the ground, in m/s."""
    velocity = actor.get_velocity()
    return math.hypot(velocity.x, velocity.y)


def drive(world: carla.World, vehicle: carla.Vehicle, ticks: int, throttle: float = 0.6) -> float:
    """Drive straight on for some ticks; returns the distance in m."""
    start = vehicle.get_location()
    vehicle.apply_control(carla.VehicleControl(throttle=throttle))
    for _ in range(ticks):
        world.tick()
    return start.distance_2d(vehicle.get_location())


def destroy(client: carla.Client, actors: Iterable[carla.Actor]) -> None:
    """Destroy actors in a batch, as clients do at their end."""
    answers = client.apply_batch_sync([carla.command.DestroyActor(actor) for actor in actors], True)
    assert [answer.error for answer in answers] == [""] * len(answers)
