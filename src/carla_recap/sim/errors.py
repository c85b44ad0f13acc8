"""What can go wrong in a simulation.

SimError
├── SpawnError     an actor cannot appear: an unknown blueprint, or an occupied place
└── DeadActor      an actor was asked for something after it had been destroyed
"""

from __future__ import annotations

from carla_recap.errors import RecapError


class SimError(RecapError):
    """Something that the simulation was asked for cannot be done."""


class SpawnError(SimError):
    """An actor cannot appear."""


class DeadActor(SimError):
    """An actor was asked for something after it had been destroyed."""
