"""What a town has by itself, as clients see it: its traffic lights and signs, and what rays meet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server import actor_records
from carla_recap.server.sensors.rays import Boxes
from carla_recap.server.structs import BoundingBox, EnvironmentObject, LabelledPoint
from carla_recap.sim.actors.actors import Mover, Prop, Sign, TrafficLight
from carla_recap.sim.geometry import Location, Vector

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.world import World

    Floats = NDArray[np.float64]

ANY: Final = 255
"""The semantic class that stands for all."""
ROAD, TERRAIN = 1, 10
_LAMPS: Final = Vector(0.2, 0.2, 0.55)  # m: half the size of a light's head
_PLATE: Final = Vector(0.4, 0.05, 0.4)  # m: of a sign
_LAMPS_HEIGHT: Final = 3.0  # m: of its middle above the foot of the pole
_PLATE_HEIGHT: Final = 2.2  # m
_STRIDE: Final = 1.0  # m: between two looks at the ground
_MOST_LOOKS: Final = 20_000


def signs(world: World, label: int) -> list[Sign]:
    """The lights and signs of a semantic class, or all."""
    there = [actor for actor in world.actors.values() if isinstance(actor, Sign)]
    return [sign for sign in there if label in (ANY, actor_records.tag(sign))]


def box(sign: Sign) -> BoundingBox:
    """The box around the lamps or the plate of a sign, in the world."""
    is_light = isinstance(sign, TrafficLight)
    foot, turn = sign.transform.location, sign.transform.rotation
    height = _LAMPS_HEIGHT if is_light else _PLATE_HEIGHT
    return BoundingBox(Location(foot.x, foot.y, foot.z + height), _LAMPS if is_light else _PLATE, turn, sign.id)


def name(sign: Sign) -> str:
    """What a sign is called among the objects of the map."""
    return f"{sign.type_id}_{sign.signal.opendrive_id}"


def environment_object(sign: Sign) -> EnvironmentObject:
    """A sign as an object of the map."""
    return EnvironmentObject(sign.transform, box(sign), sign.id, name(sign), actor_records.tag(sign))


def ray(world: World, start: Location, end: Location) -> list[LabelledPoint]:
    """What a ray meets on its way: vehicles, walkers, props, and the ground, the nearest first; it passes through them."""
    origin, goal = np.array((start.x, start.y, start.z)), np.array((end.x, end.y, end.z))
    reach = float(np.linalg.norm(goal - origin))
    if not reach:
        return []
    direction = (goal - origin) / reach
    met = [*_actors(world, origin, direction, reach), *_ground(world, origin, direction, reach)]
    return [_point(origin + distance * direction, label) for distance, label in sorted(met)]


def _actors(world: World, origin: Floats, direction: Floats, reach: float) -> Iterator[tuple[float, int]]:
    left: list[Actor] = [actor for actor in world.actors.values() if isinstance(actor, (Mover, Prop))]
    while left:
        hits = Boxes(left).cast(origin, direction[None], reach)
        if not len(hits.box):
            return
        actor = left.pop(int(hits.box[0]))
        yield float(hits.distance[0]), actor_records.tag(actor)


def _ground(world: World, origin: Floats, direction: Floats, reach: float) -> Iterator[tuple[float, int]]:
    """Where a ray enters the ground, if it does."""
    at = np.linspace(0.0, reach, min(max(int(reach / _STRIDE), 1), _MOST_LOOKS) + 1)
    x, y, z = (origin + at[:, None] * direction).T
    above = z - world.town.height(x, y)
    through = np.flatnonzero((above[:-1] >= 0) & (above[1:] < 0))
    if len(through):
        i = through[0]
        distance = at[i] + (at[i + 1] - at[i]) * above[i] / (above[i] - above[i + 1])
        yield float(distance), _surface(world, origin + distance * direction)


def _surface(world: World, place: Floats) -> int:
    town = world.town
    x, y = place[:1], place[1:2]
    lane, s = town.nearest_lane(x, y)
    aside = abs(town.project(lane, x, y, s)[1][0])
    return ROAD if aside <= town.lanes[lane[0]].width / 2 else TERRAIN


def _point(place: Floats, label: int) -> LabelledPoint:
    return LabelledPoint(Location(*place.tolist()), label)
