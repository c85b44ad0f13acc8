"""All that may stand or move on a road, as boxes: vehicles, walkers and things."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.actor import Prop
from carla_recap.sim.traffic.autopilot.sight import Boxes, join

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.actors.registry import ActorRegistry
    from carla_recap.sim.physics.walkers import Walkers

    Flags = NDArray[np.bool_]

_VEHICLES_AHEAD: Final = 1.0  # s: for so long the vehicles of others are expected to go straight on
_WALKERS_AHEAD: Final = 1.5  # s: and walkers
_NOWHERE: Final = np.inf  # m: where those are taken to be who are carried by others, and whom all pass through
_AROUND_WALKERS: Final = 0.3  # m
_WALKING: Final = 0.1  # m/s
_EVERY: Final = 1.0  # s: so often things are looked for


class Surroundings:
    """Knows where everything in a world is.

    Args:
        registry: The actors.
    """

    def __init__(self, registry: ActorRegistry) -> None:
        self._registry = registry
        self._things = _boxes([])
        self._due = 0.0
        self._actors = 0

    def boxes(self, driven: Flags) -> Boxes:
        """Where all is; others than those whom the autopilot drives, also where they will be soon.

        Args:
            driven: Which vehicles it drives, (vehicles,).

        Returns:
            The boxes of the vehicles, in their order, then all others.
        """
        registry, elapsed = self._registry, self._registry.clock.elapsed
        if elapsed >= self._due or len(registry.actors) != self._actors:
            self._due, self._actors = elapsed + _EVERY, len(registry.actors)
            self._things = _boxes([actor for actor in registry.actors.values() if isinstance(actor, Prop) and actor.body])
        vehicles = registry.vehicles
        cars = Boxes(
            np.where(vehicles.carried, _NOWHERE, vehicles.position[:, 0]),
            vehicles.position[:, 1],
            np.radians(vehicles.rotation[:, 1]),
            vehicles.half_length,
            vehicles.half_width,
            vehicles.velocity[:, 0],
            vehicles.velocity[:, 1],
            *vehicles.heights(),
        )
        return join(cars.swept(np.where(driven, 0.0, _VEHICLES_AHEAD)), _people(registry.walkers), self._things)


def _people(walkers: Walkers) -> Boxes:
    velocity_x, velocity_y = walkers.velocity[:, 0], walkers.velocity[:, 1]
    walking = np.hypot(velocity_x, velocity_y) > _WALKING
    return Boxes(
        np.where(walkers.carried, _NOWHERE, walkers.position[:, 0]),
        walkers.position[:, 1],
        np.where(walking, np.arctan2(velocity_y, velocity_x), np.radians(walkers.rotation[:, 1])),
        walkers.half_length + _AROUND_WALKERS,
        walkers.half_width + _AROUND_WALKERS,
        velocity_x,
        velocity_y,
        *walkers.heights(),
    ).swept(np.full(len(walkers), _WALKERS_AHEAD))


def _boxes(things: list[Prop]) -> Boxes:
    rows = []
    for thing in things:
        transform, box = thing.transform, thing.box
        middle = transform.transform(box.location)
        yaw, extent = np.radians(transform.rotation.yaw), box.extent
        rows.append((middle.x, middle.y, yaw, extent.x, extent.y, 0.0, 0.0, *thing.heights()))
    return Boxes(*np.array(rows, np.float64).reshape(-1, 9).T)
