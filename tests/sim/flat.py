"""A plain with a straight road along x, 8 km long, for tests that need room and nothing else; cars and walkers there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.geometry import Location, Rotation, Transform
from carla_recap.sim.town.junctions import Junction, Signal, SignalKind
from carla_recap.sim.town.lanes import NO_LANE, Lane
from carla_recap.sim.town.loading import Town
from carla_recap.sim.town.sidewalks import WalkwayGraph
from carla_recap.sim.world import World

if TYPE_CHECKING:
    from carla_recap.sim.episode import Collision

LENGTH = 8000.0


def lane(index: int = 0, y: float = 0.0, junction: int | None = None) -> Lane:
    x = np.linspace(0.0, LENGTH, 1601)
    points = np.stack((x, np.full(len(x), y), np.zeros(len(x))), axis=1)
    return Lane(
        index=index,
        road_id=1,
        section=0,
        lane_id=-1 - index,
        points=points,
        s=x,
        heading=np.zeros(len(x)),
        width=3.5,
        limits=np.full(len(x), 14.0),
        successors=(index,),
        predecessors=(index,),
        left=np.full(len(x), NO_LANE),
        right=np.full(len(x), NO_LANE),
        junction=junction,
        turn="straight",
        reverse=False,
    )


def light(index: int, lanes: tuple[int, ...], y: float = 3.0) -> Signal:
    place = Transform(Location(100.0, y, 0.0), Rotation(yaw=180.0))
    stops = tuple((lane, 95.0) for lane in lanes)
    return Signal(index, str(index), SignalKind.LIGHT, place, None, 1, str(index), stops, ())


def flat_town(
    *,
    lanes: list[Lane] | None = None,
    signals: list[Signal] | None = None,
    phases: tuple[tuple[int, ...], ...] = (),
    barriers: list[Any] | None = None,
    walks: WalkwayGraph | None = None,
) -> Town:
    nowhere = WalkwayGraph(np.empty((0, 3)), np.empty((0, 2), np.int64), np.empty(0, np.bool_))
    return Town(
        name="Flat",
        opendrive="",
        lanes=lanes or [lane()],
        signals=signals or [],
        junctions=[Junction(1, (), (), phases)] if phases else [],
        sidewalks=[],
        crossings=[],
        walks=walks or nowhere,
        barriers=barriers or [],
    )


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
    assert isinstance(actor, Vehicle)
    if speed:
        actor.set_target_velocity(place.forward() * speed)
    return actor


def spawn_walker(world: World, place: Transform, name: str = "walker.pedestrian.0001") -> Walker:
    actor = world.spawn(name, place)
    assert isinstance(actor, Walker)
    return actor


def collisions(world: World, seconds: float) -> list[Collision]:
    """Run a world for some seconds, and return the collisions."""
    found = []
    for _ in range(round(seconds / 0.05)):
        world.tick()
        found += world.events.collisions
    return found
