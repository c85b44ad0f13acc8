"""A staged stop: a van breaks down in a lane where nobody can pass it, and those behind it queue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.geometry import Transform
from carla_recap.sim.scenarios.places import spawn_on, straight_stretch
from carla_recap.sim.traffic.autopilot.handling import LEFT_BLINKER, RIGHT_BLINKER

if TYPE_CHECKING:
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.interfaces import ScenarioWorld

VAN: Final = "vehicle.mercedes.sprinter"
QUEUE: Final = ("vehicle.tesla.model3", "vehicle.audi.a2", "vehicle.mini.cooper_s")

BREAKDOWN: Final = 5.0  # s: then the van brakes
_APART: Final = 14.0  # m, between vehicles at the beginning
_RUN: Final = 60.0  # m, that the van gets at most
_BRAKE: Final = 0.4
_HAZARD: Final = LEFT_BLINKER | RIGHT_BLINKER


@dataclass(frozen=True)
class Cast:
    """Who takes part.

    Attributes:
        van: Breaks down.
        queue: Who stops behind it, the nearest first, which is the hero.
    """

    van: Vehicle
    queue: tuple[Vehicle, ...]


class Blockage:
    """Stages the stop; a controller of the world.

    All drive by autopilot; at `BREAKDOWN` the van stops with its hazard lights on and stays. It has to be staged before any
    traffic is there.

    Args:
        world: The world.

    Attributes:
        cast: Who takes part.

    Raises:
        SimError: The town has no single straight lane that is long enough, or the place is occupied.
    """

    def __init__(self, world: ScenarioWorld) -> None:
        self._world = world
        lane, begin = straight_stretch(world.town, len(QUEUE) * _APART + _RUN, single=True)
        van = spawn_on(world, VAN, lane, begin + len(QUEUE) * _APART, "broken down")
        queue = tuple(
            spawn_on(world, model, lane, begin + (len(QUEUE) - place) * _APART, "autopilot" if place > 1 else "hero")
            for place, model in enumerate(QUEUE, 1)
        )
        world.spawn("sensor.other.collision", Transform(), parent=queue[0])
        for vehicle in (van, *queue):
            vehicle.set_autopilot()
        self.cast = Cast(van, queue)
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act for a tick of so many seconds."""
        van = self.cast.van
        if van.is_alive and self._world.elapsed >= BREAKDOWN:
            van.set_autopilot(False)
            van.apply_control(VehicleControl(brake=_BRAKE))
            van.light_state = _HAZARD
