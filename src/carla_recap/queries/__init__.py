"""CARLA's three queries over any recording, who was there, and what went wrong: typed rows, which `report` shows."""

from carla_recap.queries.actors import Actor, Actors, BoundingBox, actors
from carla_recap.queries.blocked import Blocked, BlockedRow, blocked
from carla_recap.queries.collisions import CollisionRow, Collisions, collisions
from carla_recap.queries.incidents import Incident, Incidents, incidents
from carla_recap.queries.info import Info, InfoRow, info

__all__ = [
    "Actor",
    "Actors",
    "Blocked",
    "BlockedRow",
    "BoundingBox",
    "CollisionRow",
    "Collisions",
    "Incident",
    "Incidents",
    "Info",
    "InfoRow",
    "actors",
    "blocked",
    "collisions",
    "incidents",
    "info",
]
