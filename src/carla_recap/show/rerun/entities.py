"""The paths of entities: the writers fill them, the blueprint shows them."""

from __future__ import annotations

from typing import Final

import rerun as rr

WORLD: Final = "/world"
ACTORS: Final = "/world/actors"
ROADS: Final = "/world/map"
GROUND: Final = "/world/ground"
GHOSTS: Final = "/world/ghost"
CHASE: Final = "/world/chase"
CAMERAS: Final = "/world/cameras"
TRAIL: Final = "/world/trail"
COLLISIONS: Final = "/world/collisions"
SKY: Final = "/world/sky"
AHEAD: Final = "/world/ahead"
SENSORS: Final = "/world/sensors"

STATES: Final = "/signals"
EVENTS: Final = "/events"
INCIDENTS: Final = "/incidents"
VERDICTS: Final = "/verdicts"
EGO: Final = "/ego"
SPEED: Final = "/ego/speed_kmh"
ACCELERATION: Final = "/ego/acceleration"
GAP: Final = "/ego/distances/gap"
HEADWAY: Final = "/ego/distances/headway"
TIME_TO_COLLISION: Final = "/ego/times/time_to_collision"
TIME_HEADWAY: Final = "/ego/times/time_headway"
DISTANCES: Final = "/ego/distances"
TIMES: Final = "/ego/times"
CONTROLS: Final = "/ego/controls"
PEDALS: Final = "/ego/pedals"
LIGHT_AHEAD: Final = "/ego/light_ahead"

MAP: Final = "/map"
MAP_ROADS: Final = "/map/roads"
MAP_BORDERS: Final = "/map/borders"
MAP_ACTORS: Final = "/map/actors"
MAP_GHOSTS: Final = "/map/ghosts"
MAP_EDGE: Final = "/map/edge"
MAP_FOLLOWED: Final = "/map/followed"


def actor(id: int) -> str:
    """Return the path of an actor: its box, in its own axes."""
    return f"{ACTORS}/{id}"


def verdict(rule: str) -> str:
    """Return the path of the states of a rule."""
    return f"{VERDICTS}/{rr.escape_entity_path_part(rule)}"


def lamps(id: int, kind: str) -> str:
    """Return the path of the lamps of an actor of a kind, in its axes."""
    return f"{ACTORS}/{id}/lamps/{kind.lower()}"


def camera(id: int) -> str:
    """Return the path of the axes in which the camera that follows an actor is fixed."""
    return f"{CAMERAS}/{id}"


def trail(id: int) -> str:
    """Return the path of the trail behind an actor."""
    return f"{TRAIL}/{id}"


def state(id: int) -> str:
    """Return the path of the states of a traffic light, shown as a lane of a timeline."""
    return f"{STATES}/tl_{id}"


def sensor(id: str, kind: str = "") -> str:
    """Return the path of a sensor, in its own axes, or that of a kind of its data."""
    path = f"{SENSORS}/{rr.escape_entity_path_part(id)}"
    return f"{path}/{rr.escape_entity_path_part(kind)}" if kind else path
