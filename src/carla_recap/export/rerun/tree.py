"""Where everything is in the tree of entities; `writer` fills it, `blueprint` shows it."""

from __future__ import annotations

from typing import Final

WORLD: Final = "/world"
ACTORS: Final = "/world/actors"
ROADS: Final = "/world/map"
GROUND: Final = "/world/ground"
CHASE: Final = "/world/chase"
CAMERAS: Final = "/world/cameras"
TRAIL: Final = "/world/trail"
LAMPS: Final = "/world/signals"
COLLISIONS: Final = "/world/collisions"

STATES: Final = "/signals"
EVENTS: Final = "/events"
SPEED: Final = "/ego/speed_kmh"
CONTROLS: Final = "/ego/controls"

MAP: Final = "/map"
MAP_ROADS: Final = "/map/roads"
MAP_ACTORS: Final = "/map/actors"
MAP_EDGE: Final = "/map/edge"
MAP_FOLLOWED: Final = "/map/followed"


def actor(id: int) -> str:
    """The box of an actor, in its own axes."""
    return f"{ACTORS}/{id}"


def camera(id: int) -> str:
    """The axes in which the camera that follows an actor stands still."""
    return f"{CAMERAS}/{id}"


def trail(id: int) -> str:
    """Where an actor came from."""
    return f"{TRAIL}/{id}"


def lamp(id: int) -> str:
    """The lamp of a traffic light in the world."""
    return f"{LAMPS}/tl_{id}"


def state(id: int) -> str:
    """The states of a traffic light, as a lane."""
    return f"{STATES}/tl_{id}"
