"""A town without a simulator: roads, signals, traffic and collisions in a plane, to record from and to replay into."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.sim.actors.actors import Actor, Prop, Sensor, Sign, Spectator, TrafficLight, Vehicle, Walker
    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.actors.control import VehicleControl, WalkerControl
    from carla_recap.sim.actors.events import Collision, TickEvents
    from carla_recap.sim.errors import DeadActor, SimError, SpawnError
    from carla_recap.sim.geometry import Box, Location, Rotation, Transform, Vector
    from carla_recap.sim.physics.physics_control import Gear, PhysicsControl, WheelPhysics
    from carla_recap.sim.settings import Settings
    from carla_recap.sim.town.town import Town, load_town
    from carla_recap.sim.weather import PRESETS, Weather
    from carla_recap.sim.world import Controller, World

__all__ = [
    "PRESETS",
    "Actor",
    "Blueprint",
    "BlueprintLibrary",
    "Box",
    "Collision",
    "Controller",
    "DeadActor",
    "Gear",
    "Location",
    "PhysicsControl",
    "Prop",
    "Rotation",
    "Sensor",
    "Settings",
    "Sign",
    "SimError",
    "SpawnError",
    "Spectator",
    "TickEvents",
    "Town",
    "TrafficLight",
    "Transform",
    "Vector",
    "Vehicle",
    "VehicleControl",
    "Walker",
    "WalkerControl",
    "Weather",
    "WheelPhysics",
    "World",
    "load_town",
]

# Reading a town needs no physics engine.
__getattr__, __dir__ = lazily(
    __name__,
    {
        "actors.actors": ("Actor", "Prop", "Sensor", "Sign", "Spectator", "TrafficLight", "Vehicle", "Walker"),
        "actors.blueprints": ("Blueprint", "BlueprintLibrary"),
        "actors.control": ("VehicleControl", "WalkerControl"),
        "errors": ("DeadActor", "SimError", "SpawnError"),
        "actors.events": ("Collision", "TickEvents"),
        "geometry": ("Box", "Location", "Rotation", "Transform", "Vector"),
        "physics.physics_control": ("Gear", "PhysicsControl", "WheelPhysics"),
        "settings": ("Settings",),
        "town.town": ("Town", "load_town"),
        "weather": ("PRESETS", "Weather"),
        "world": ("Controller", "World"),
    },
)
