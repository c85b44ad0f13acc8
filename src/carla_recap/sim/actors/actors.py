"""Another name for the modules of actors, until all imports are changed."""

from carla_recap.sim.actors.actor import HERO, Actor, Prop, Sensor, Spectator
from carla_recap.sim.actors.actor import attached_transform as upon
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.actors.moving import ALL_DOORS, Vehicle, Walker
from carla_recap.sim.actors.moving import MovingActor as Mover

__all__ = [
    "ALL_DOORS",
    "HERO",
    "Actor",
    "Mover",
    "Prop",
    "Sensor",
    "Sign",
    "Spectator",
    "TrafficLight",
    "Vehicle",
    "Walker",
    "upon",
]
