"""Calls about traffic lights."""

from __future__ import annotations

from carla_recap.server import scenery
from carla_recap.server.calls.actors import expect
from carla_recap.server.client import Client
from carla_recap.server.structs import BoundingBox
from carla_recap.server.table import call
from carla_recap.sim.actors.actors import TrafficLight


@call
def set_traffic_light_state(client: Client, id: int, state: int) -> None:
    """Have a light show something, until the next change of its group."""
    expect(client, id, TrafficLight).set_state(state)


@call
def set_traffic_light_green_time(client: Client, id: int, seconds: float) -> None:
    """How long a light is green."""
    expect(client, id, TrafficLight).green_time = seconds


@call
def set_traffic_light_yellow_time(client: Client, id: int, seconds: float) -> None:
    """How long a light is yellow."""
    expect(client, id, TrafficLight).yellow_time = seconds


@call
def set_traffic_light_red_time(client: Client, id: int, seconds: float) -> None:
    """How long all lights of a group are red after a light."""
    expect(client, id, TrafficLight).red_time = seconds


@call
def freeze_traffic_light(client: Client, id: int, freeze: bool) -> None:
    """Stop the time of a light's group, or let it go on."""
    expect(client, id, TrafficLight).freeze(freeze)


@call
def freeze_all_traffic_lights(client: Client, frozen: bool) -> None:
    """Stop the time of all lights, or let it go on."""
    client.host.world.signals.freeze_all(frozen)


@call
def reset_traffic_light_group(client: Client, id: int) -> None:
    """Let the group of a light begin its cycle again."""
    expect(client, id, TrafficLight).reset_group()


@call
def reset_all_traffic_lights(client: Client) -> None:
    """Let all groups begin their cycles again."""
    client.host.world.signals.reset_all()


@call
def get_group_traffic_lights(client: Client, id: int) -> list[int]:
    """The lights that take turns with a light, itself included."""
    return [light.id for light in expect(client, id, TrafficLight).group]


@call
def get_light_boxes(client: Client, id: int) -> list[BoundingBox]:
    """The boxes around the lamps of a light, in the world."""
    return [scenery.box(expect(client, id, TrafficLight))]
