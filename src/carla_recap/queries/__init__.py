"""CARLA's three queries over any recording, and who was there: typed rows, which `report` shows."""

from carla_recap.queries.actors import Actor, Actors, BoundingBox, actors
from carla_recap.queries.blocked import Blocked, BlockedRow, blocked
from carla_recap.queries.collisions import CollisionRow, Collisions, collisions
from carla_recap.queries.info import Info, InfoRow, info

__all__ = [
    "Actor",
    "Actors",
    "Blocked",
    "BlockedRow",
    "BoundingBox",
    "CollisionRow",
    "Collisions",
    "Info",
    "InfoRow",
    "actors",
    "blocked",
    "collisions",
    "info",
]
