"""Traffic: vehicles that drive by themselves, and walkers that stroll."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.records import ActorKind
from carla_recap.sim.actors import Vehicle, Walker
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Rotation, Transform

if TYPE_CHECKING:
    from carla_recap.sim.actors import Actor
    from carla_recap.sim.world import World

_TRIES: Final = 20  # places tried for a walker
_OFTEN: Final = 20  # ticks between two looks at who has arrived


def populate(world: World, vehicles: int, walkers: int, *, hero: bool = False) -> list[Actor]:
    """Let vehicles on autopilot and strolling walkers appear, at random.

    Args:
        world: The world; its seed says who appears, and where.
        vehicles: How many vehicles.
        walkers: How many walkers.
        hero: Whether the first vehicle is the hero, with a collision sensor.

    Returns:
        Who has appeared.

    Raises:
        SimError: There is no room for so many.
    """
    drivers, strollers = _vehicles(world, vehicles, hero=hero), _walkers(world, walkers)
    if hero and drivers:
        world.spawn("sensor.other.collision", Transform(), parent=drivers[0])
    world.controllers.append(_Wanderlust(world, strollers))
    return [*drivers, *strollers]


class _Wanderlust:
    """Gives walkers that have arrived another destination."""

    def __init__(self, world: World, walkers: list[Walker]) -> None:
        self._world = world
        self._walkers = walkers

    def step(self, delta: float) -> None:
        """Act for a tick of so many seconds."""
        if self._world.frame % _OFTEN:
            return
        for walker in self._walkers:
            if walker.is_alive and not walker.has_fallen and walker.destination is None:
                walker.destination = self._world.strolling.random_place()


def _vehicles(world: World, count: int, *, hero: bool) -> list[Vehicle]:
    models = [blueprint for blueprint in world.blueprints if blueprint.kind == ActorKind.VEHICLE]
    places = [world.town.spawn_points[place] for place in world.random.permutation(len(world.town.spawn_points))]
    found: list[Vehicle] = []
    for place in places:
        if len(found) == count:
            break
        model = models[int(world.random.integers(len(models)))]
        role = "hero" if hero and not found else "autopilot"
        vehicle = world.try_spawn(model, place.copy(), role_name=role)
        if isinstance(vehicle, Vehicle):
            vehicle.set_autopilot()
            found.append(vehicle)
    if len(found) < count:
        raise SimError(f"{world.town.name} has room for {len(found)} more vehicles, {count} were expected")
    return found


def _walkers(world: World, count: int) -> list[Walker]:
    models = [blueprint for blueprint in world.blueprints if blueprint.kind == ActorKind.WALKER]
    found: list[Walker] = []
    for _ in range(count):
        model = models[int(world.random.integers(len(models)))]
        for _ in range(_TRIES):
            place = world.strolling.random_place()
            walker = world.try_spawn(model, Transform(place, Rotation(yaw=float(world.random.uniform(-180, 180)))))
            if isinstance(walker, Walker):
                walker.destination = world.strolling.random_place()
                found.append(walker)
                break
        else:
            raise SimError(f"{world.town.name} has room for {len(found)} more walkers, {count} were expected")
    return found
