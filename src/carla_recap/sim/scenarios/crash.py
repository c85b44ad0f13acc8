"""An accident: the hero hits a walker, and then the rear of a van that blocks the lane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.sim.actors.control import VehicleControl, WalkerControl
from carla_recap.sim.actors.moving import Walker
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.scenarios.places import MARGIN, point_on_lane, spawn_on_lane, straight_section

if TYPE_CHECKING:
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.world import World

HERO: Final = "vehicle.tesla.model3"
VAN: Final = "vehicle.mercedes.sprinter"
WALKER: Final = "walker.pedestrian.0004"

START: Final = 5.0  # s: the simulated time at which the hero starts
_TO_WALKER: Final = 70.0  # m, from the hero to the walker
_TO_VAN: Final = 45.0  # m, from the walker to the van
_THROTTLE: Final = 0.6
_CRUISE: Final = 14.0  # m/s
_STEP_OUT: Final = 4.5  # m, from the middle of the lane to where the walker waits
_WALKING_SPEED: Final = 2.0  # m/s, across the street


@dataclass(frozen=True)
class CrashActors:
    """The actors of an accident.

    Attributes:
        hero: The car that hits the walker, then the van.
        walker: The walker, which steps onto the street in front of the hero.
        van: The van, which stands in the lane from the beginning.
    """

    hero: Vehicle
    walker: Walker
    van: Vehicle


class Crash:
    """An accident; a controller of the world.

    The hero, which has a collision sensor, stands until `START`. Set the scenario up before any traffic is
    spawned.

    Args:
        world: The world.

    Attributes:
        actors: The actors.

    Raises:
        SimError: The town has no straight lane of the required length.
        SpawnError: The place of an actor is occupied.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        lane, begin = straight_section(world.town, _TO_WALKER + _TO_VAN)
        hero = spawn_on_lane(world, HERO, lane, begin, "hero")
        van = spawn_on_lane(world, VAN, lane, begin + _TO_WALKER + _TO_VAN, "broken down")
        world.spawn("sensor.other.collision", Transform(), parent=hero)
        van.apply_control(VehicleControl(hand_brake=True))
        point, heading = point_on_lane(lane, begin + _TO_WALKER)
        right = heading + math.pi / 2
        self._across = Vector(-math.cos(right), -math.sin(right), 0.0)
        curb = Location(point.x + _STEP_OUT * math.cos(right), point.y + _STEP_OUT * math.sin(right), point.z + 1.0)
        walker = world.spawn(WALKER, Transform(curb, Rotation(yaw=math.degrees(right) + 180.0)))
        assert isinstance(walker, Walker)
        self.actors = CrashActors(hero, walker, van)
        self._impact = Transform(point, Rotation(yaw=math.degrees(heading)))
        self._is_crossing = False
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""
        hero = self.actors.hero
        if not hero.is_alive or self._world.elapsed < START:
            return
        speed = float(self._world.vehicles.speed[hero.row])
        distance = self._distance(hero)
        # It brakes once the van has stopped it, or when it is beyond where the van should be.
        if distance < -_TO_VAN - MARGIN or (distance < -_TO_VAN / 2 and speed < _CRUISE / 2):
            hero.apply_control(VehicleControl(brake=1.0))
            return
        hero.apply_control(VehicleControl(throttle=_THROTTLE if speed < _CRUISE else 0.0))
        seconds = _STEP_OUT / _WALKING_SPEED
        if not self._is_crossing and 0.0 < distance <= speed * seconds + hero.box.extent.x:
            self._is_crossing = True
            self.actors.walker.apply_control(WalkerControl(self._across, _WALKING_SPEED))

    def _distance(self, hero: Vehicle) -> float:
        """Return the distance along the lane from the hero to the point where the walker crosses, in m."""
        location, ahead = hero.transform.location, self._impact.forward()
        return (self._impact.location.x - location.x) * ahead.x + (self._impact.location.y - location.y) * ahead.y
