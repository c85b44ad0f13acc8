"""The errors of the simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from pathlib import Path


class SimError(RecapError):
    """A request to the simulator that is invalid, or cannot be fulfilled."""


class SpawnError(SimError):
    """An actor cannot be spawned."""


class DeadActor(SimError):
    """An actor was used after it had been destroyed."""


class DestinationError(SimError):
    """A recording cannot be written to its destination."""


class MapMissing(SimError):
    """The map of a recording is unavailable."""

    def __init__(self, path: Path, map_name: str, reason: str) -> None:
        super().__init__(path, map_name, reason)
        self.path = path
        self.map_name = map_name
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.path}: is a recording of the map {self.map_name!r}, which cannot be loaded: {self.reason}"
