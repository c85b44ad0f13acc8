"""Friction triggers: boxes within which the tyres of vehicles have another friction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import CM
from carla_recap.sim.attributes import number
from carla_recap.sim.episode import Actor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.geometry import Transform

_DEFAULTS: Final = {"friction": 3.5, "extent_x": 1.0, "extent_y": 1.0, "extent_z": 1.0}


class FrictionTrigger(Actor):
    """A box that sets the tyre friction of vehicles when they enter, and restores it when they leave.

    Its attributes are the friction and half the size of the box, in cm.
    """

    _entered: Sequence[Vehicle] = ()

    def update(self, place: Transform) -> None:
        """Set the friction of vehicles that have entered it at a place, and restore that of vehicles that have left."""
        self._set_inside(self._inside(place))

    def _remove_body(self) -> None:
        self.episode.triggers.remove(self)
        self._set_inside(())

    def _set_inside(self, inside: Sequence[Vehicle]) -> None:
        for vehicle in self._entered:
            if vehicle not in inside:
                self._restore(vehicle)
        for vehicle in inside:
            if vehicle not in self._entered:
                self._affect(vehicle)
        self._entered = inside

    @property
    def friction(self) -> float:
        """The friction of the tyres inside."""
        return self._number("friction")

    def _inside(self, place: Transform) -> list[Vehicle]:
        """Return the vehicles whose boxes overlap that of the trigger, by the axes of both boxes."""
        vehicles = self.episode.vehicles
        if not len(vehicles):
            return []
        length, width, height = (self._number(f"extent_{axis}") * CM for axis in "xyz")
        x, y, z = (vehicles.position - (place.location.x, place.location.y, place.location.z)).T
        own, their = np.radians(place.rotation.yaw), np.radians(vehicles.rotation[:, 1])
        cos, sin = np.abs(np.cos(their - own)), np.abs(np.sin(their - own))
        half_length, half_width = vehicles.half_length, vehicles.half_width
        overlaps = (
            (np.abs(np.cos(own) * x + np.sin(own) * y) < length + half_length * cos + half_width * sin)
            & (np.abs(np.cos(own) * y - np.sin(own) * x) < width + half_length * sin + half_width * cos)
            & (np.abs(np.cos(their) * x + np.sin(their) * y) < half_length + length * cos + width * sin)
            & (np.abs(np.cos(their) * y - np.sin(their) * x) < half_width + length * sin + width * cos)
            & (z + vehicles.top > -height)
            & (z + vehicles.bottom < height)
        )
        return [vehicles.actors[row] for row in np.flatnonzero(overlaps)]

    def _number(self, key: str) -> float:
        return number(self.attributes, key, _DEFAULTS[key])

    def _affect(self, vehicle: Vehicle) -> None:
        outside = [wheel.tire_friction for wheel in vehicle.physics_control.wheels]
        self.episode.occupied.setdefault(vehicle.id, (outside, {}))[1][self.id] = self.friction
        _set_friction(vehicle, [self.friction] * len(outside))

    def _restore(self, vehicle: Vehicle) -> None:
        outside, triggers = self.episode.occupied[vehicle.id]
        del triggers[self.id]
        _set_friction(vehicle, [[*triggers.values()][-1]] * len(outside) if triggers else outside)
        if not triggers:
            del self.episode.occupied[vehicle.id]


def _set_friction(vehicle: Vehicle, frictions: list[float]) -> None:
    """Set the friction of each tyre of a vehicle, if it still exists."""
    if not vehicle.is_alive:
        return
    control = vehicle.physics_control
    for wheel, friction in zip(control.wheels, frictions, strict=False):
        wheel.tire_friction = friction
    vehicle.physics_control = control
