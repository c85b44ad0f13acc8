"""Calls about the world around the actors."""

from __future__ import annotations

from carla_recap.server import scenery
from carla_recap.server.client import Client
from carla_recap.server.structs import BoundingBox, EnvironmentObject, LabelledPoint
from carla_recap.server.table import CallError, call
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.physics.drivetrain import GRAVITY
from carla_recap.sim.validation import expect_place


@call
def cast_ray(client: Client, start: Location, end: Location) -> list[LabelledPoint]:
    """What a ray meets on its way, the nearest first."""
    expect_place("the start of a ray", start)
    expect_place("the end of a ray", end)
    return scenery.ray(client.host.world, start, end)


@call
def project_point(client: Client, location: Location, direction: Vector, distance: float) -> tuple[bool, LabelledPoint]:
    """What a place meets first in a direction, within a distance in m; whether there is anything, and what."""
    expect_place("the start of a ray", location)
    length = direction.length()
    if not length:
        raise CallError("project_point: a direction was expected, found none")
    far = distance / length
    end = Location(location.x + direction.x * far, location.y + direction.y * far, location.z + direction.z * far)
    expect_place("the end of a ray", end)
    met = scenery.ray(client.host.world, location, end)
    return (True, met[0]) if met else (False, LabelledPoint(Location(), 0))


@call
def get_all_level_BBs(client: Client, label: int) -> list[BoundingBox]:  # noqa: N802  (CARLA's name)
    """The boxes of what the map has by itself: traffic lights and signs, in the world."""
    return [scenery.box(sign) for sign in scenery.signs(client.host.world, label)]


@call
def get_environment_objects(client: Client, label: int) -> list[EnvironmentObject]:
    """What the map has by itself: traffic lights and signs."""
    return [scenery.environment_object(sign) for sign in scenery.signs(client.host.world, label)]


@call
def get_names_of_all_objects(client: Client) -> list[str]:
    """What the map has by itself: traffic lights and signs."""
    return [scenery.name(sign) for sign in scenery.signs(client.host.world, scenery.ANY)]


@call
def get_imui_gravity(client: Client) -> float:
    """The gravity that IMUs feel, in m/s²."""
    return GRAVITY
