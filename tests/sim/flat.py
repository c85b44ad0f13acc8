"""A plain with a straight road along x, 8 km long, for tests that need room and nothing else; cars and walkers there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.episode import Collision
from carla_recap.sim.geometry import Location, Rotation, Transform
from carla_recap.sim.town.junctions import Junction, Signal, SignalKind
from carla_recap.sim.town.lanes import NO_LANE, Lane
from carla_recap.sim.town.loading import Town
from carla_recap.sim.town.sidewalks import WalkwayGraph
from carla_recap.sim.world import World

LENGTH = 8000.0


def lane(index: int = 0, y: float = 0.0, junction: int | None = None) -> Lane:
    x = np.linspace(0.0, LENGTH, 1601)
    none, beside = np.zeros(len(x)), np.full(len(x), NO_LANE)
    points, own = np.stack((x, none + y, none), axis=1), (index,)
    return Lane(
        index, 1, 0, -1 - index, False, points, x, none, 3.5, none + 14, own, own, beside, beside, junction, "straight"
    )


def light(index: int, lanes: tuple[int, ...], y: float = 3.0) -> Signal:
    place = Transform(Location(100.0, y, 0.0), Rotation(yaw=180.0))
    stops = tuple((lane, 95.0) for lane in lanes)
    return Signal(index, str(index), SignalKind.LIGHT, place, None, 1, str(index), stops, ())


def flat_town(
    *,
    lanes: list[Lane] | None = None,
    signals: Sequence[Signal] = (),
    phases: tuple[tuple[int, ...], ...] = (),
    junctions: Sequence[Junction] = (),
    barriers: Sequence[Any] = (),
    walks: WalkwayGraph | None = None,
) -> Town:
    ways = walks or WalkwayGraph(np.empty((0, 3)), np.empty((0, 2), np.int64), np.empty(0, np.bool_))
    all = [Junction(1, (), (), phases)] if phases else list(junctions)
    return Town("Flat", "", lanes or [lane()], list(signals), all, [], [], ways, list(barriers))


def flat_world(**town: Any) -> World:
    return World(flat_town(**town), seed=1, date=0)


def lit_world() -> World:
    """Return a world with two lights, of which one is green at a time."""
    return flat_world(signals=[light(0, (0,)), light(1, (0,), y=-3.0)], phases=((0,), (1,)))


def at(x: float, y: float = 0.0, yaw: float = 0.0, z: float = 0.0) -> Transform:
    return Transform(Location(x, y, z), Rotation(yaw=yaw))


def spawn_car(
    world: World, place: Transform, name: str = "vehicle.tesla.model3", *, speed: float = 0.0, **attributes: str
) -> Vehicle:
    """Spawn a vehicle that drives ahead at a speed in m/s."""
    actor = world.spawn(name, place, **attributes)
    if speed:
        actor.set_target_velocity(place.forward() * speed)
    return actor


def spawn_walker(world: World, place: Transform, name: str = "walker.pedestrian.0001") -> Walker:
    return world.spawn(name, place)


def collisions(world: World, seconds: float) -> list[Collision]:
    """Run a world for some seconds, and return the collisions."""
    found = []
    for _ in range(round(seconds / 0.05)):
        world.tick()
        found += world.events.collisions
    return found
