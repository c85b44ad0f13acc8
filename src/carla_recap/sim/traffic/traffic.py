"""The traffic of an episode: what drives the vehicles on autopilot, and the walkers that have destinations."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from carla_recap.sim.traffic.autopilot.autopilot import Autopilot
from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

if TYPE_CHECKING:
    from carla_recap.sim.episode import Episode


class Traffic:
    """Drives an episode's traffic; a controller of the world."""

    def __init__(self, episode: Episode) -> None:
        self._episode = episode

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s; autopilot and navigation are made when they are first needed."""
        if "_autopilot" in vars(self) or self._episode.vehicles.autopilot.any():
            self._autopilot.step(delta)
        if "_pedestrians" in vars(self) or self._episode.walkers.has_destination.any():
            self._pedestrians.step(delta)

    @cached_property
    def _autopilot(self) -> Autopilot:
        return Autopilot(self._episode)

    @cached_property
    def _pedestrians(self) -> PedestrianNavigation:
        return PedestrianNavigation(self._episode)
