"""What can go wrong in a simulation.

SimError
├── SpawnError     an actor cannot appear: an unknown blueprint, or an occupied place
├── DeadActor      an actor was asked for something after it had been destroyed
└── MapMissing     a recording is of a map that is not to be had
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from pathlib import Path


class SimError(RecapError):
    """Something that the simulation was asked for cannot be done."""


class SpawnError(SimError):
    """An actor cannot appear."""


class DeadActor(SimError):
    """An actor was asked for something after it had been destroyed."""


class MapMissing(SimError):
    """A recording is of a map that is not to be had.

    Args:
        path: The recording.
        map_name: The map, as it is told there.
        reason: Why it is not to be had.
    """

    def __init__(self, path: Path, map_name: str, reason: str) -> None:
        super().__init__(path, map_name, reason)
        self.path = path
        self.map_name = map_name
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.path}: is a recording of the map {self.map_name!r}, which cannot be loaded: {self.reason}"
