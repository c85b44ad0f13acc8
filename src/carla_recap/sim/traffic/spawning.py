"""Traffic: vehicles on autopilot, and walkers that find their way by themselves."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

from carla_recap.model.lives import HERO
from carla_recap.model.records import ActorKind
from carla_recap.sim.actors.blueprints import COLLISION_SENSOR
from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Rotation, Transform
from carla_recap.sim.validation import expect_count

if TYPE_CHECKING:
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.geometry import Location
    from carla_recap.sim.world import World

_log: Final = logging.getLogger("carla_recap.traffic")
_TRIES: Final = 20  # places that are tried for a walker
_REACH: Final = 80.0  # m: the distance within which a place counts as near
_DRAWS: Final = 10_000  # random places on sidewalks that are tried to find one that is near


def populate(
    world: World, vehicles: int, walkers: int, *, hero: bool = False, around: Location | None = None
) -> list[Actor]:
    """Spawn vehicles on autopilot and walkers with destinations at random places.

    If there is no room for all walkers, a warning is logged.

    Args:
        world: The world; its seed decides on blueprints and places.
        vehicles: The number of vehicles.
        walkers: The number of walkers.
        hero: Whether the first vehicle is the hero, with a collision sensor.
        around: A location near which all are spawned, and to which the walkers go first; else it is anywhere in the town.

    Returns:
        The vehicles, then the walkers.

    Raises:
        SimError: There is no room for all vehicles, in which case none is left, no sidewalk, or a number is negative.
    """
    expect_count("vehicles", vehicles)
    expect_count("walkers", walkers)
    cars, pedestrians = _vehicles(world, vehicles, around, hero=hero), _walkers(world, walkers, around)
    if hero and cars:
        world.spawn(COLLISION_SENSOR, Transform(), parent=cars[0])
    return [*cars, *pedestrians]


def _is_near(place: Location, around: Location | None) -> bool:
    return around is None or around.distance(place) <= _REACH


def _random_sidewalk_place(world: World, around: Location | None) -> Location:
    """Return a random place on a sidewalk, near a location if one is given.

    Raises:
        SimError: There is no such place.
    """
    for _ in range(_DRAWS):
        if _is_near(place := world.pedestrians.random_place(), around):
            return place
    raise SimError(f"{world.town.name} has no sidewalk within {_REACH:g} m of {around}")


def _vehicles(world: World, count: int, around: Location | None, *, hero: bool) -> list[Vehicle]:
    models = world.blueprints.traffic(ActorKind.VEHICLE)
    if count and not world.town.spawn_points:
        raise SimError(f"{world.town.name} has no place for a vehicle: no lanes for cars that lead anywhere")
    places = [place for place in world.town.spawn_points if _is_near(place.location, around)]
    found: list[Vehicle] = []
    for place in (places[index] for index in world.random.permutation(len(places))):
        if len(found) == count:
            break
        model = models[int(world.random.integers(len(models)))]
        role = HERO if hero and not found else "autopilot"
        vehicle = world.try_spawn(model, place.copy(), role_name=role)
        if isinstance(vehicle, Vehicle):
            vehicle.set_autopilot()
            found.append(vehicle)
    if len(found) < count:
        for vehicle in found:
            vehicle.destroy()
        raise SimError(f"{world.town.name} has room for {len(found)} more vehicles, {count} were expected")
    return found


def _walkers(world: World, count: int, around: Location | None) -> list[Walker]:
    models = world.blueprints.traffic(ActorKind.WALKER)
    found: list[Walker] = []
    if count and not len(world.town.walks.nodes):
        _log.warning("%s has no sidewalks, %d walkers were expected", world.town.name, count)
        return found
    for _ in range(count):
        model = models[int(world.random.integers(len(models)))]
        for _ in range(_TRIES):
            place = _random_sidewalk_place(world, around)
            walker = world.try_spawn(model, Transform(place, Rotation(yaw=float(world.random.uniform(-180, 180)))))
            if isinstance(walker, Walker):
                walker.destination = _random_sidewalk_place(world, around)
                found.append(walker)
                break
        else:
            _log.warning("%s has room for %d more walkers, %d were expected", world.town.name, len(found), count)
            break
    return found
