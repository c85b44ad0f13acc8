"""The traffic of an episode: what drives the vehicles on autopilot, and the walkers that have destinations."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from carla_recap.sim.traffic.autopilot.autopilot import Autopilot
from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.episode import Episode


class Traffic:
    """The controllers of an episode's traffic.

    Args:
        episode: The episode.
    """

    def __init__(self, episode: Episode) -> None:
        self._episode = episode

    def controllers(self) -> Iterator[Autopilot | PedestrianNavigation]:
        """Yield what has to act in a tick; each is made when it is first needed."""
        if "_autopilot" in vars(self) or self._episode.vehicles.autopilot.any():
            yield self._autopilot
        if "_pedestrians" in vars(self) or self._episode.walkers.has_destination.any():
            yield self._pedestrians

    @cached_property
    def _autopilot(self) -> Autopilot:
        return Autopilot(self._episode)

    @cached_property
    def _pedestrians(self) -> PedestrianNavigation:
        return PedestrianNavigation(self._episode)
