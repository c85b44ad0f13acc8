"""A staged accident: the hero runs over a walker, and into the rear of a van that blocks the lane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.sim.actors.control import VehicleControl, WalkerControl
from carla_recap.sim.actors.moving import Walker
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.scenarios.places import MARGIN, place_on, spawn_on, straight_stretch

if TYPE_CHECKING:
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.interfaces import ScenarioWorld

HERO: Final = "vehicle.tesla.model3"
VAN: Final = "vehicle.mercedes.sprinter"
WALKER: Final = "walker.pedestrian.0004"

START: Final = 5.0  # s: then the hero drives off
_RUN: Final = 70.0  # m, from the hero to the walker
_REST: Final = 45.0  # m, from the walker to the van
_THROTTLE: Final = 0.6
_CRUISE: Final = 14.0  # m/s
_STEP_OUT: Final = 4.5  # m, from the middle of the lane to where the walker waits
_HURRY: Final = 2.0  # m/s, over the street


@dataclass(frozen=True)
class Cast:
    """Who takes part.

    Attributes:
        hero: Drives, hits the walker, then the van.
        walker: Steps on the street in front of the hero.
        van: Stands in the lane from the beginning.
    """

    hero: Vehicle
    walker: Walker
    van: Vehicle


class Crash:
    """Stages the accident; a controller of the world.

    The hero stands until `START`, with a collision sensor. It has to be staged before any traffic is there.

    Args:
        world: The world.

    Attributes:
        cast: Who takes part.

    Raises:
        SimError: The town has no straight lane that is long enough, or the place is occupied.
    """

    def __init__(self, world: ScenarioWorld) -> None:
        self._world = world
        lane, begin = straight_stretch(world.town, _RUN + _REST)
        hero = spawn_on(world, HERO, lane, begin, "hero")
        van = spawn_on(world, VAN, lane, begin + _RUN + _REST, "broken down")
        world.spawn("sensor.other.collision", Transform(), parent=hero)
        van.apply_control(VehicleControl(hand_brake=True))
        place, heading = place_on(lane, begin + _RUN)
        right = heading + math.pi / 2
        self._across = Vector(-math.cos(right), -math.sin(right), 0.0)
        curb = Location(place.x + _STEP_OUT * math.cos(right), place.y + _STEP_OUT * math.sin(right), place.z + 1.0)
        walker = world.spawn(WALKER, Transform(curb, Rotation(yaw=math.degrees(right) + 180.0)))
        assert isinstance(walker, Walker)
        self.cast = Cast(hero, walker, van)
        self._way = Transform(place, Rotation(yaw=math.degrees(heading)))
        self._walks = False
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act for a tick of so many seconds."""
        hero = self.cast.hero
        if not hero.is_alive or self._world.elapsed < START:
            return
        speed = float(self._world.vehicles.speed[hero.row])
        away = self._distance(hero)
        # It brakes once it has been stopped, or should the van be gone.
        if away < -_REST - MARGIN or (away < -_REST / 2 and speed < _CRUISE / 2):
            hero.apply_control(VehicleControl(brake=1.0))
            return
        hero.apply_control(VehicleControl(throttle=_THROTTLE if speed < _CRUISE else 0.0))
        reach = _STEP_OUT / _HURRY
        if not self._walks and 0.0 < away <= speed * reach + hero.box.extent.x:
            self._walks = True
            self.cast.walker.apply_control(WalkerControl(self._across, _HURRY))

    def _distance(self, hero: Vehicle) -> float:
        """How far the hero is before the walker's way, in m, along the lane."""
        place, ahead = hero.transform.location, self._way.forward()
        return (self._way.location.x - place.x) * ahead.x + (self._way.location.y - place.y) * ahead.y
