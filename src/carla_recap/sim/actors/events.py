"""What happens in a tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carla_recap.sim.actors.actors import Actor, TrafficLight, Vehicle
    from carla_recap.sim.geometry import Location, Vector


@dataclass(frozen=True, slots=True)
class Collision:
    """An actor was pushed.

    Attributes:
        actor1: Whose collision it is: a hero, or who has a collision sensor.
        actor2: What pushed it; None for what is no actor, such as a barrier.
        location: Where.
        impulse: What actor1 got, in N s.
        hero1: Whether actor1 is a hero.
        hero2: Whether actor2 is one.
        number: Collisions of the episode are counted from 0.
    """

    actor1: int
    actor2: int | None
    location: Location
    impulse: Vector
    hero1: bool
    hero2: bool
    number: int


@dataclass(slots=True)
class TickEvents:
    """What happened between the end of the last tick and the end of this one.

    Attributes:
        spawned: Who came, in this order.
        destroyed: The ids of who went.
        parented: Pairs of ids: child and parent.
        collisions: Each pair once.
        physics: Whose physics control was changed.
        light_times: The lights whose times were changed.
        doors: Vehicle, door, and whether it is open now.
    """

    spawned: list[Actor] = field(default_factory=list)
    destroyed: list[int] = field(default_factory=list)
    parented: list[tuple[int, int]] = field(default_factory=list)
    collisions: list[Collision] = field(default_factory=list)
    physics: list[Vehicle] = field(default_factory=list)
    light_times: list[TrafficLight] = field(default_factory=list)
    doors: list[tuple[int, int, bool]] = field(default_factory=list)
