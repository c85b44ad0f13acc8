"""Vehicles whose velocity is held constant, as CARLA's `enable_constant_velocity` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.sim.geometry import Location, Transform, Vector

if TYPE_CHECKING:
    from carla_recap.sim.actors.actors import Vehicle
    from carla_recap.sim.world import World


class Steadiness:
    """Gives vehicles the velocity back that brakes, tyres and drag have taken in a tick.

    Args:
        world: Where they are.
    """

    def __init__(self, world: World) -> None:
        self._held: dict[Vehicle, Vector] = {}
        world.listeners.append(self)

    def __call__(self) -> None:
        """Act at the end of a tick; see `World.listeners`."""
        for vehicle, velocity in tuple(self._held.items()):
            if vehicle.is_alive:
                _drive(vehicle, velocity)
            else:
                del self._held[vehicle]

    def hold(self, vehicle: Vehicle, velocity: Vector) -> None:
        """Keep the velocity of a vehicle, in its own axes and m/s."""
        self._held[vehicle] = velocity
        _drive(vehicle, velocity)

    def release(self, vehicle: Vehicle) -> None:
        """Let a vehicle go on as it would."""
        self._held.pop(vehicle, None)


def _drive(vehicle: Vehicle, velocity: Vector) -> None:
    turned = Transform(rotation=vehicle.transform.rotation).transform(Location(velocity.x, velocity.y, velocity.z))
    vehicle.set_target_velocity(Vector(turned.x, turned.y, turned.z))
