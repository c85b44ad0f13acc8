"""Places in a town for scenarios, and vehicles spawned there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform

if TYPE_CHECKING:
    from carla_recap.sim.town.lanes import Lane
    from carla_recap.sim.town.town import Town
    from carla_recap.sim.world import World

MARGIN: Final = 8.0  # m of lane before the first vehicle, and behind the last one
_STRAIGHT: Final = math.radians(0.1)  # between two points of a lane
_ABOVE: Final = 0.3  # m above the road, where vehicles are spawned


def straight_section(town: Town, length: float, *, single: bool = False) -> tuple[Lane, float]:
    """Return a lane with a straight section, and the distance along it at which the first vehicle stands, in m.

    Args:
        town: The town.
        length: The distance between the first and the last vehicle, in m.
        single: Whether the lane must have no other beside it on which a vehicle could pass.

    Raises:
        SimError: There is no such lane.
    """
    length += 2 * MARGIN
    for lane in town.lanes:
        if lane.junction is not None or lane.length < length or (single and (lane.left, lane.right) != (None, None)):
            continue
        bends = np.flatnonzero(np.abs(np.diff(lane.heading)) > _STRAIGHT)
        ends = np.concatenate(([0.0], lane.s[bends], [lane.length]))
        widest = int(np.argmax(np.diff(ends)))
        if ends[widest + 1] - ends[widest] >= length:
            return lane, float(ends[widest]) + MARGIN
    raise SimError(f"a straight lane of {length:g} m was expected to stage it on; {town.name} has none")


def largest_junction(town: Town) -> Location:
    """Return the centre of the junction with the most lanes, of those with traffic lights.

    Raises:
        SimError: The town has no junction with traffic lights.
    """
    junctions = [junction for junction in town.junctions if junction.phases]
    if not junctions:
        raise SimError(f"a junction with traffic lights was expected; {town.name} has none")
    junction = max(junctions, key=lambda junction: len(junction.lanes))
    return Location(*np.mean([town.lanes[lane].points.mean(axis=0) for lane in junction.lanes], axis=0).tolist())


def point_on_lane(lane: Lane, s: float) -> tuple[Location, float]:
    """Return the point at a distance along a lane in m, and the direction of travel there in radians."""
    x, y, z = (float(np.interp(s, lane.s, lane.points[:, axis])) for axis in range(3))
    return Location(x, y, z), float(np.interp(s, lane.s, lane.heading))


def spawn_on_lane(world: World, blueprint: str, lane: Lane, s: float, role_name: str = "") -> Vehicle:
    """Spawn a vehicle that stands on a lane, at a distance along it in m.

    Raises:
        SpawnError: The place is occupied.
    """
    place, heading = point_on_lane(lane, s)
    place.z += _ABOVE
    vehicle = world.spawn(blueprint, Transform(place, Rotation(yaw=math.degrees(heading))), role_name=role_name)
    assert isinstance(vehicle, Vehicle)
    return vehicle
