"""Controllers, and those of an episode's traffic: the autopilot and the pedestrian navigation, made when first used."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np

    from carla_recap.sim.actors.registry import ActorRegistry
    from carla_recap.sim.traffic.autopilot import Autopilot
    from carla_recap.sim.traffic.pedestrians import PedestrianNavigation


class Controller(Protocol):
    """Something that acts at the beginning of each tick."""

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""


class Traffic:
    """The controllers of an episode's traffic.

    Args:
        registry: The actors.
        random: The source of all randomness.
        controllers: The controllers of the world, to which these are added when they are made.
    """

    def __init__(self, registry: ActorRegistry, random: np.random.Generator, controllers: list[Controller]) -> None:
        self._registry = registry
        self._random = random
        self._controllers = controllers

    @cached_property
    def autopilot(self) -> Autopilot:
        """The autopilot."""
        from carla_recap.sim.traffic.autopilot import Autopilot

        autopilot = Autopilot(self._registry, self._random)
        self._controllers.append(autopilot)
        return autopilot

    @cached_property
    def pedestrians(self) -> PedestrianNavigation:
        """The pedestrian navigation."""
        from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

        pedestrians = PedestrianNavigation(self._registry, self._random)
        self._controllers.append(pedestrians)
        return pedestrians

    def start_autopilot(self) -> None:
        """Make sure that there is an autopilot."""
        _ = self.autopilot

    def end(self) -> None:
        """Take the controllers out of those of the world."""
        mine = [vars(self).get(name) for name in ("autopilot", "pedestrians")]
        self._controllers[:] = [controller for controller in self._controllers if controller not in mine]
