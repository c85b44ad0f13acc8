"""Traffic: vehicles on autopilot, and walkers that find their way by themselves."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, Protocol

from carla_recap.model.lives import HERO
from carla_recap.model.records import ActorKind
from carla_recap.sim.actors.moving import Vehicle, Walker
from carla_recap.sim.actors.spawning import place, try_spawn
from carla_recap.sim.blueprints import COLLISION_SENSOR
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform
from carla_recap.sim.validation import expect_count

if TYPE_CHECKING:
    from carla_recap.sim.episode import Actor, Episode

_log: Final = logging.getLogger("carla_recap.traffic")
_TRIES: Final = 20  # places that are tried for a walker
_REACH: Final = 80.0  # m: the distance within which a place counts as near
_DRAWS: Final = 10_000  # random places on sidewalks that are tried to find one that is near


class _World(Protocol):
    @property
    def episode(self) -> Episode:
        """The episode."""


def populate(
    world: _World, vehicles: int, walkers: int, *, hero: bool = False, around: Location | None = None
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
    episode = world.episode
    cars, pedestrians = _vehicles(episode, vehicles, around, hero=hero), _walkers(episode, walkers, around)
    if hero and cars:
        place(episode, COLLISION_SENSOR, Transform(), cars[0])
    return [*cars, *pedestrians]


def _is_near(place: Location, around: Location | None) -> bool:
    return around is None or around.distance(place) <= _REACH


def _random_sidewalk_place(episode: Episode, around: Location | None) -> Location:
    """Return a random place on a sidewalk, near a location if one is given."""
    nodes = episode.town.walks.nodes
    for _ in range(_DRAWS):
        place = Location(*nodes[int(episode.random.integers(len(nodes)))].tolist())
        if _is_near(place, around):
            return place
    raise SimError(f"{episode.town.name} has no sidewalk within {_REACH:g} m of {around}")


def _vehicles(episode: Episode, count: int, around: Location | None, *, hero: bool) -> list[Vehicle]:
    models = episode.blueprints.traffic(ActorKind.VEHICLE)
    if count and not episode.town.spawn_points:
        raise SimError(f"{episode.town.name} has no place for a vehicle: no lanes for cars that lead anywhere")
    places = [place for place in episode.town.spawn_points if _is_near(place.location, around)]
    found: list[Vehicle] = []
    for at in (places[index] for index in episode.random.permutation(len(places))):
        if len(found) == count:
            break
        model = models[int(episode.random.integers(len(models)))]
        role = HERO if hero and not found else "autopilot"
        vehicle = try_spawn(episode, model, at.copy(), attributes={"role_name": role})
        if isinstance(vehicle, Vehicle):
            vehicle.set_autopilot()
            found.append(vehicle)
    if len(found) < count:
        for vehicle in found:
            vehicle.destroy()
        raise SimError(f"{episode.town.name} has room for {len(found)} more vehicles, {count} were expected")
    return found


def _walkers(episode: Episode, count: int, around: Location | None) -> list[Walker]:
    models = episode.blueprints.traffic(ActorKind.WALKER)
    found: list[Walker] = []
    if count and not len(episode.town.walks.nodes):
        _log.warning("%s has no sidewalks, %d walkers were expected", episode.town.name, count)
        return found
    for _ in range(count):
        model = models[int(episode.random.integers(len(models)))]
        for _ in range(_TRIES):
            at = _random_sidewalk_place(episode, around)
            walker = try_spawn(episode, model, Transform(at, Rotation(yaw=float(episode.random.uniform(-180, 180)))))
            if isinstance(walker, Walker):
                walker.destination = _random_sidewalk_place(episode, around)
                found.append(walker)
                break
        else:
            _log.warning("%s has room for %d more walkers, %d were expected", episode.town.name, len(found), count)
            break
    return found
