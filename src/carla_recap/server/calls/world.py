"""Calls about the town: its traffic lights, its signs as objects of the map, and rays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import GRAVITY
from carla_recap.scene.materials import Tag
from carla_recap.server import actor_records
from carla_recap.server.calls.actors import expect
from carla_recap.server.host import Client
from carla_recap.server.protocol.releases import Label
from carla_recap.server.rpc.registry import CallError, call
from carla_recap.server.rpc.structs import BoxStruct, EnvironmentObject, LabelledPoint
from carla_recap.server.sensors.rays import ActorBoxes, solid_actors
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.validation import expect_place

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.world import World
    from carla_recap.util.arrays import Floats


_ANY: Final = 255
"""The semantic class that stands for all."""
_LAMPS: Final = Vector(0.2, 0.2, 0.55)  # m: half the size of a light's head
_PLATE: Final = Vector(0.4, 0.05, 0.4)  # m: half the size of a sign
_LAMPS_HEIGHT: Final = 3.0  # m, from the foot of the pole to the middle of the head
_PLATE_HEIGHT: Final = 2.2  # m
_STRIDE: Final = 1.0  # m: the distance between two samples of the ground
_MOST_SAMPLES: Final = 20_000


@call
def set_traffic_light_state(client: Client, id: int, state: int) -> None:
    """Set the state of a light until the next change of its group."""
    expect(client, id, TrafficLight).set_state(state)


@call
def set_traffic_light_green_time(client: Client, id: int, seconds: float) -> None:
    """Set the duration of a light's green, in s."""
    expect(client, id, TrafficLight).green_time = seconds


@call
def set_traffic_light_yellow_time(client: Client, id: int, seconds: float) -> None:
    """Set the duration of a light's yellow, in s."""
    expect(client, id, TrafficLight).yellow_time = seconds


@call
def set_traffic_light_red_time(client: Client, id: int, seconds: float) -> None:
    """Set how long all lights of a group are red after a light, in s."""
    expect(client, id, TrafficLight).red_time = seconds


@call
def freeze_traffic_light(client: Client, id: int, freeze: bool) -> None:
    """Freeze the group of a light, or resume it."""
    expect(client, id, TrafficLight).freeze(freeze)


@call
def freeze_all_traffic_lights(client: Client, frozen: bool) -> None:
    """Freeze all lights, or resume them."""
    client.host.world.signals.freeze_all(frozen)


@call
def reset_traffic_light_group(client: Client, id: int) -> None:
    """Restart the cycle of a light's group."""
    expect(client, id, TrafficLight).reset_group()


@call
def reset_all_traffic_lights(client: Client) -> None:
    """Restart the cycles of all groups."""
    client.host.world.signals.reset_all()


@call
def get_group_traffic_lights(client: Client, id: int) -> list[int]:
    """Return the group of a light, itself included."""
    return [light.id for light in expect(client, id, TrafficLight).group]


@call
def get_light_boxes(client: Client, id: int) -> list[BoxStruct]:
    """Return the boxes around the heads of a light, in the world."""
    return [_sign_box(expect(client, id, TrafficLight))]


@call
def cast_ray(client: Client, start: Location, end: Location) -> list[LabelledPoint]:
    """Return the surfaces that a ray meets, the nearest first."""
    expect_place("the start of a ray", start)
    expect_place("the end of a ray", end)
    return _ray(client.host.world, start, end)


@call
def project_point(client: Client, location: Location, direction: Vector, distance: float) -> tuple[bool, LabelledPoint]:
    """Return whether a ray in a direction meets a surface within a distance in m, and the first one."""
    expect_place("the start of a ray", location)
    length = direction.length()
    if not length:
        raise CallError("project_point: expected a direction, found none")
    far = distance / length
    end = Location(location.x + direction.x * far, location.y + direction.y * far, location.z + direction.z * far)
    expect_place("the end of a ray", end)
    met = _ray(client.host.world, location, end)
    return (True, met[0]) if met else (False, LabelledPoint(Location(), Label(0)))


@call
def get_all_level_BBs(client: Client, label: Label) -> list[BoxStruct]:  # noqa: N802  (CARLA's name)
    """Return the boxes of the map's objects, which are traffic lights and signs, in the world."""
    return [_sign_box(sign) for sign in _signs(client.host.world, label)]


@call
def get_environment_objects(client: Client, label: Label) -> list[EnvironmentObject]:
    """Return the map's objects, which are traffic lights and signs."""
    return [
        EnvironmentObject(sign.transform, _sign_box(sign), sign.id, _sign_name(sign), Label(actor_records.tag(sign)))
        for sign in _signs(client.host.world, label)
    ]


@call
def get_names_of_all_objects(client: Client) -> list[str]:
    """Return the names of the map's objects, which are traffic lights and signs."""
    return [_sign_name(sign) for sign in _signs(client.host.world, _ANY)]


@call
def get_imui_gravity(client: Client) -> float:
    """Return the gravity that IMUs measure, in m/s²."""
    return GRAVITY


def _signs(world: World, label: int) -> list[Sign]:
    """Return the lights and signs of a semantic class, or all."""
    signs = [actor for actor in world.actors.values() if isinstance(actor, Sign)]
    return [sign for sign in signs if label in (_ANY, actor_records.tag(sign))]


def _sign_box(sign: Sign) -> BoxStruct:
    """Return the box around the head of a light or the plate of a sign, in the world."""
    is_light = isinstance(sign, TrafficLight)
    foot, rotation = sign.transform.location, sign.transform.rotation
    height = _LAMPS_HEIGHT if is_light else _PLATE_HEIGHT
    return BoxStruct(Location(foot.x, foot.y, foot.z + height), _LAMPS if is_light else _PLATE, rotation, sign.id)


def _sign_name(sign: Sign) -> str:
    """Return the name of a sign among the objects of the map."""
    return f"{sign.type_id}_{sign.signal.opendrive_id}"


def _ray(world: World, start: Location, end: Location) -> list[LabelledPoint]:
    """Return where a ray passes through vehicles, walkers, props and the ground, the nearest first."""
    origin, goal = np.array((start.x, start.y, start.z)), np.array((end.x, end.y, end.z))
    reach = float(np.linalg.norm(goal - origin))
    if not reach:
        return []
    direction = (goal - origin) / reach
    actors = solid_actors(world.actors.values())
    found = ActorBoxes(actors).pierce(origin, direction[None], reach)
    of_actors = zip(found.distance.tolist(), (actor_records.tag(actors[box]) for box in found.box.tolist()), strict=True)
    hits = sorted([*of_actors, *_ground_hits(world, origin, direction, reach)])
    return [LabelledPoint(Location(*(origin + distance * direction).tolist()), Label(label)) for distance, label in hits]


def _ground_hits(world: World, origin: Floats, direction: Floats, reach: float) -> Iterator[tuple[float, int]]:
    """Yield where a ray enters the ground, if it does."""
    samples = np.linspace(0.0, reach, min(max(int(reach / _STRIDE), 1), _MOST_SAMPLES) + 1)
    x, y, z = (origin + samples[:, None] * direction).T
    above = z[:-1] - world.town.height(x[:-1], y[:-1], z[:-1])
    beyond = z[1:] - world.town.height(x[1:], y[1:], z[:-1])  # of the same level, where roads are above each other
    through = np.flatnonzero((above >= 0) & (beyond < 0))
    if len(through):
        i = through[0]
        distance = samples[i] + (samples[i + 1] - samples[i]) * above[i] / (above[i] - beyond[i])
        x, y, z = (origin + distance * direction)[:, None]
        yield float(distance), Tag.ROADS if world.town.on_road(x, y, z)[0] else Tag.TERRAIN
