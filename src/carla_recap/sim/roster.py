"""Whoever is in a world, ready to be told of tick by tick."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.records import ActorKind
from carla_recap.sim.actors import Mover
from carla_recap.sim.poses import pose
from carla_recap.sim.snapshots import COLUMNS, OTHER_POSES, Lineup

if TYPE_CHECKING:
    from carla_recap.sim.snapshots import States
    from carla_recap.sim.world import World

_WITH_PLACE: Final = (ActorKind.OTHER, ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds of actors whose transforms are told in each frame, as by CARLA 0.9.13 and later."""


class Roster:
    """The actors of a world as long as nobody comes or goes.

    Args:
        world: The world.
        additional_data: See `Lineup`.

    Attributes:
        lineup: Who they are.
    """

    def __init__(self, world: World, *, additional_data: bool) -> None:
        self._holders = {"vehicles": world.vehicles, "walkers": world.walkers, "signals": world.signals}
        actors = [actor for actor in world.actors.values() if actor.kind in _WITH_PLACE]
        self._others = [actor for actor in actors if not isinstance(actor, Mover)]
        self.lineup = Lineup(
            placed=[actor.id for actor in actors],
            vehicles=world.vehicles.id.tolist(),
            walkers=world.walkers.id.tolist(),
            others=[actor.id for actor in self._others],
            lights=[light.id for light in world.traffic_lights],
            additional_data=additional_data,
        )

    def states(self) -> States:
        """Copies of all columns that are told, as they are now."""
        states: States = {(holder, name): getattr(self._holders[holder], name).copy() for holder, name in COLUMNS}
        states[OTHER_POSES] = np.array([pose(actor.transform) for actor in self._others])
        return states
