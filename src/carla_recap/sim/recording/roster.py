"""Whoever is in a world, ready to be told of tick by tick."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.records import ActorKind
from carla_recap.sim.actors.actors import Mover
from carla_recap.sim.recording.poses import pose
from carla_recap.sim.recording.snapshots import OTHER_POSES, Lineup, Strip

if TYPE_CHECKING:
    from carla_recap.sim.interfaces import RecordedWorld
    from carla_recap.sim.recording.snapshots import Moment, States

_WITH_PLACE: Final = (ActorKind.OTHER, ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds of actors whose transforms are told in each frame, as by CARLA 0.9.13 and later."""


class Roster:
    """The actors of a world as long as nobody comes or goes.

    Args:
        world: The world.
        additional_data: See `Lineup`.
    """

    def __init__(self, world: RecordedWorld, *, additional_data: bool) -> None:
        actors = [actor for actor in world.actors.values() if actor.kind in _WITH_PLACE]
        self._others = [actor for actor in actors if not isinstance(actor, Mover)]
        self._poses = np.empty((len(self._others), 6))
        self._lineup = Lineup(
            placed=[actor.id for actor in actors],
            vehicles=world.vehicles.id.tolist(),
            walkers=world.walkers.id.tolist(),
            others=[actor.id for actor in self._others],
            lights=[light.id for light in world.traffic_lights],
            additional_data=additional_data,
        )
        holders = {"vehicles": world.vehicles, "walkers": world.walkers, "signals": world.signals}
        self._columns = [(column, holders[column[0]]) for column in self._lineup.columns]

    def strip(self, length: int) -> Strip:
        """An empty strip for so many snapshots of these actors."""
        return Strip(self._lineup, self._states(), length)

    def take(self, strip: Strip, moment: Moment) -> None:
        """Add a snapshot of how things are now to a strip of these actors."""
        strip.add(moment, self._states())

    def _states(self) -> States:
        """All columns that are told; what others than vehicles and walkers have is asked of them one by one."""
        states: States = {column: getattr(holder, column[1]) for column, holder in self._columns}
        for row, actor in zip(self._poses, self._others, strict=True):
            row[:] = pose(actor.transform)
        states[OTHER_POSES] = self._poses
        return states
