"""A town without a simulator: roads, signals, traffic and collisions in a plane, to record from and to replay into."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.sim.actors.actor import Actor, Collision, Prop, Sensor, Spectator
    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.actors.lights import Sign, TrafficLight
    from carla_recap.sim.actors.moving import Vehicle, VehicleControl, Walker, WalkerControl
    from carla_recap.sim.actors.registry import TickEvents
    from carla_recap.sim.errors import DeadActor, SimError, SpawnError
    from carla_recap.sim.geometry import Box, Location, Rotation, Transform, Vector
    from carla_recap.sim.physics.physics_control import Gear, PhysicsControl, WheelPhysics
    from carla_recap.sim.settings import PRESETS, Settings, Weather
    from carla_recap.sim.town.loading import Town, load_town
    from carla_recap.sim.traffic.controllers import Controller
    from carla_recap.sim.world import World

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
        "actors.actor": ("Actor", "Collision", "Prop", "Sensor", "Spectator"),
        "actors.blueprints": ("Blueprint", "BlueprintLibrary"),
        "actors.lights": ("Sign", "TrafficLight"),
        "actors.moving": ("Vehicle", "VehicleControl", "Walker", "WalkerControl"),
        "actors.registry": ("TickEvents",),
        "errors": ("DeadActor", "SimError", "SpawnError"),
        "geometry": ("Box", "Location", "Rotation", "Transform", "Vector"),
        "physics.physics_control": ("Gear", "PhysicsControl", "WheelPhysics"),
        "settings": ("PRESETS", "Settings", "Weather"),
        "town.loading": ("Town", "load_town"),
        "traffic.controllers": ("Controller",),
        "world": ("World",),
    },
)
