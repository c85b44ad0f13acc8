"""A breakdown: a van stops in a lane where no vehicle can pass it, and those behind it queue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.model.lives import HERO
from carla_recap.scene.lamps import LEFT_BLINKER, RIGHT_BLINKER
from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.geometry import Transform
from carla_recap.sim.scenarios.places import spawn_on_lane, straight_section

if TYPE_CHECKING:
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.world import World

VAN: Final = "vehicle.mercedes.sprinter"
QUEUE: Final = ("vehicle.tesla.model3", "vehicle.audi.a2", "vehicle.mini.cooper_s")

BREAKDOWN: Final = 5.0  # s: the simulated time at which the van brakes
_SPACING: Final = 14.0  # m, between vehicles at the beginning
_RUN: Final = 60.0  # m that the van covers at most
_BRAKE: Final = 0.4
_HAZARD_LIGHTS: Final = LEFT_BLINKER | RIGHT_BLINKER


@dataclass(frozen=True)
class BlockageActors:
    """The actors of a breakdown.

    Attributes:
        van: The van that breaks down.
        queue: The vehicles that stop behind it, the nearest first, which is the hero.
    """

    van: Vehicle
    queue: tuple[Vehicle, ...]


class Blockage:
    """A breakdown; a controller of the world.

    All vehicles drive by autopilot; at `BREAKDOWN` the van stops with its hazard lights on and stays. The scenario has to be
    set up before any traffic is spawned.

    Args:
        world: The world.

    Attributes:
        actors: The actors.

    Raises:
        SimError: The town has no straight lane of the required length without another lane beside it.
        SpawnError: The place of a vehicle is occupied.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        lane, begin = straight_section(world.town, len(QUEUE) * _SPACING + _RUN, single=True)
        van = spawn_on_lane(world, VAN, lane, begin + len(QUEUE) * _SPACING, "broken down")
        queue = tuple(
            spawn_on_lane(world, model, lane, begin + (len(QUEUE) - number) * _SPACING, "autopilot" if number > 1 else HERO)
            for number, model in enumerate(QUEUE, 1)
        )
        world.spawn("sensor.other.collision", Transform(), parent=queue[0])
        for vehicle in (van, *queue):
            vehicle.set_autopilot()
        self.actors = BlockageActors(van, queue)
        world.controllers.append(self)

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""
        van = self.actors.van
        if van.is_alive and self._world.elapsed >= BREAKDOWN:
            van.set_autopilot(False)
            van.apply_control(VehicleControl(brake=_BRAKE))
            van.light_state = _HAZARD_LIGHTS
