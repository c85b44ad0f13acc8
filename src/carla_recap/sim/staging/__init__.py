"""Staged scenes: an accident, and a lane that somebody blocks."""

from __future__ import annotations

from carla_recap.sim.staging.blockage import Blockage
from carla_recap.sim.staging.crash import Crash
from carla_recap.sim.staging.places import largest_junction

__all__ = ["Blockage", "Crash", "largest_junction"]
