"""Scenarios: an accident, and a breakdown that blocks a lane."""

from __future__ import annotations

from carla_recap.sim.scenarios.blockage import Blockage
from carla_recap.sim.scenarios.crash import Crash
from carla_recap.sim.scenarios.places import largest_junction

__all__ = ["Blockage", "Crash", "largest_junction"]
