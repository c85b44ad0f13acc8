"""Scenarios: an accident, and a breakdown that blocks a lane; places in a town for them, and vehicles spawned there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.lives import HERO
from carla_recap.scene.lamps import LEFT_BLINKER, RIGHT_BLINKER
from carla_recap.sim.actors.moving import Vehicle, VehicleControl, Walker, WalkerControl
from carla_recap.sim.blueprints import COLLISION_SENSOR
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.town.lanes import NO_LANE

if TYPE_CHECKING:
    from carla_recap.sim.town.lanes import Lane
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.world import World

__all__ = ["Blockage", "Crash", "largest_junction", "point_on_lane", "spawn_on_lane", "straight_section"]

_CAR: Final = "vehicle.tesla.model3"
_VAN: Final = "vehicle.mercedes.sprinter"
_WALKER: Final = "walker.pedestrian.0004"
_QUEUE: Final = (_CAR, "vehicle.audi.a2", "vehicle.mini.cooper_s")
_MARGIN: Final = 8.0  # m of lane before the first vehicle, and behind the last one
_STRAIGHT: Final = math.radians(0.1)  # between two points of a lane
_ABOVE: Final = 0.3  # m above the road, where vehicles are spawned


def straight_section(town: Town, length: float, *, single: bool = False) -> tuple[Lane, float]:
    """Return a lane with a straight section, and the distance along it at which the first vehicle stands, in m.

    Args:
        town: The town.
        length: The distance between the first and the last vehicle, in m.
        single: Whether the lane must have no other beside it on which a vehicle could pass.

    Raises:
        SimError: There is no such lane.
    """
    longest = 0.0
    for lane in town.lanes:
        is_single = np.maximum(lane.left, lane.right).max() == NO_LANE
        if lane.junction is not None or (single and not is_single):
            continue
        bends = np.flatnonzero(np.abs(np.diff(lane.heading)) > _STRAIGHT)
        ends = np.concatenate(([0.0], lane.s[bends], [lane.length]))
        widest = int(np.argmax(np.diff(ends)))
        found = float(ends[widest + 1] - ends[widest]) - 2 * _MARGIN
        if found >= length:
            return lane, float(ends[widest]) + _MARGIN
        longest = max(longest, found)
    kind = "straight section without a lane beside it" if single else "straight section"
    raise SimError(f"expected a {kind} of {length:g} m; the longest of {town.name} is {math.floor(longest)} m long")


def largest_junction(town: Town) -> Location:
    """Return the centre of the junction with the most lanes, of those with traffic lights.

    Raises:
        SimError: The town has no junction with traffic lights.
    """
    junctions = [junction for junction in town.junctions if junction.phases]
    if not junctions:
        raise SimError(f"a junction with traffic lights was expected; {town.name} has none")
    junction = max(junctions, key=lambda junction: len(junction.lanes))
    return Location(*np.mean([town.lanes[lane].points.mean(axis=0) for lane in junction.lanes], axis=0).tolist())


def point_on_lane(lane: Lane, s: float) -> tuple[Location, float]:
    """Return the point at a distance along a lane in m, and the direction of travel there in radians."""
    x, y, z = (float(np.interp(s, lane.s, lane.points[:, axis])) for axis in range(3))
    return Location(x, y, z), float(np.interp(s, lane.s, lane.heading))


def spawn_on_lane(world: World, blueprint: str, lane: Lane, s: float, role_name: str = "") -> Vehicle:
    """Spawn a vehicle that stands on a lane, at a distance along it in m.

    Raises:
        SpawnError: The place is occupied.
    """
    place, heading = point_on_lane(lane, s)
    place.z += _ABOVE
    vehicle = world.spawn(blueprint, Transform(place, Rotation(yaw=math.degrees(heading))), role_name=role_name)
    assert isinstance(vehicle, Vehicle)
    return vehicle


START: Final = 5.0  # s: the simulated time at which the hero starts
_TO_WALKER: Final = 70.0  # m, from the hero to the walker
_TO_VAN: Final = 45.0  # m, from the walker to the van
_THROTTLE: Final = 0.67  # at most
_CRUISE: Final = 14.25  # m/s, at which it would no longer press the throttle; it holds half a metre per second less
_STEP_OUT: Final = 4.5  # m, from the middle of the lane to where the walker waits
_WALKING_SPEED: Final = 2.0  # m/s, across the street


class Crash:
    """An accident; a controller of the world.

    The hero, which has a collision sensor, stands until `START`. Set the scenario up before any traffic is
    spawned.

    Attributes:
        hero: The car that hits the walker, then the van.
        walker: The walker, which steps onto the street in front of the hero.
        van: The van, which stands in the lane from the beginning.

    Raises:
        SimError: The town has no straight lane of the required length.
        SpawnError: The place of an actor is occupied.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        lane, begin = straight_section(world.town, _TO_WALKER + _TO_VAN)
        self.hero = spawn_on_lane(world, _CAR, lane, begin, HERO)
        self.van = spawn_on_lane(world, _VAN, lane, begin + _TO_WALKER + _TO_VAN, "broken down")
        world.spawn(COLLISION_SENSOR, Transform(), parent=self.hero)
        self.van.apply_control(VehicleControl(hand_brake=True))
        point, heading = point_on_lane(lane, begin + _TO_WALKER)
        right = heading + math.pi / 2
        self._across = Vector(-math.cos(right), -math.sin(right), 0.0)
        curb = Location(point.x + _STEP_OUT * math.cos(right), point.y + _STEP_OUT * math.sin(right), point.z + 1.0)
        walker = world.spawn(_WALKER, Transform(curb, Rotation(yaw=math.degrees(right) + 180.0)))
        assert isinstance(walker, Walker)
        self.walker = walker
        self._impact = Transform(point, Rotation(yaw=math.degrees(heading)))
        self._is_crossing = False
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""
        hero = self.hero
        if not hero.is_alive or self._world.elapsed < START:
            return
        speed = float(self._world.vehicles.speed[hero.row])
        distance = self._distance(hero)
        # It brakes once the van has stopped it, or when it is beyond where the van should be.
        if distance < -_TO_VAN - _MARGIN or (distance < -_TO_VAN / 2 and speed < _CRUISE / 2):
            hero.apply_control(VehicleControl(brake=1.0))
            return
        hero.apply_control(VehicleControl(throttle=min(max(_CRUISE - speed, 0.0), _THROTTLE)))
        seconds = _STEP_OUT / _WALKING_SPEED
        if not self._is_crossing and 0.0 < distance <= speed * seconds + hero.box.extent.x:
            self._is_crossing = True
            self.walker.apply_control(WalkerControl(self._across, _WALKING_SPEED))

    def _distance(self, hero: Vehicle) -> float:
        """Return the distance along the lane from the hero to the point where the walker crosses, in m."""
        location, ahead = hero.transform.location, self._impact.forward()
        return (self._impact.location.x - location.x) * ahead.x + (self._impact.location.y - location.y) * ahead.y


BREAKDOWN: Final = 5.0  # s: the simulated time at which the van brakes
_SPACING: Final = 14.0  # m, between vehicles at the beginning
_RUN: Final = 60.0  # m that the van covers at most
_BRAKE: Final = 0.4
_HAZARD_LIGHTS: Final = LEFT_BLINKER | RIGHT_BLINKER


class Blockage:
    """A breakdown; a controller of the world.

    All vehicles drive by autopilot; at `BREAKDOWN` the van stops with its hazard lights on and stays. The scenario has to be
    set up before any traffic is spawned.

    Attributes:
        van: The van that breaks down.
        queue: The vehicles that stop behind it, the nearest first, which is the hero.

    Raises:
        SimError: The town has no straight lane of the required length without another lane beside it.
        SpawnError: The place of a vehicle is occupied.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        lane, begin = straight_section(world.town, len(_QUEUE) * _SPACING + _RUN, single=True)
        self.van = spawn_on_lane(world, _VAN, lane, begin + len(_QUEUE) * _SPACING, "broken down")
        self.queue = tuple(
            spawn_on_lane(world, model, lane, begin + (len(_QUEUE) - number) * _SPACING, "autopilot" if number > 1 else HERO)
            for number, model in enumerate(_QUEUE, 1)
        )
        world.spawn(COLLISION_SENSOR, Transform(), parent=self.queue[0])
        for vehicle in (self.van, *self.queue):
            vehicle.set_autopilot()
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""
        van = self.van
        if van.is_alive and self._world.elapsed >= BREAKDOWN:
            van.set_autopilot(False)
            van.apply_control(VehicleControl(brake=_BRAKE))
            van.light_state = _HAZARD_LIGHTS
