"""Traffic: the autopilot, pedestrian navigation, and random vehicles and walkers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.sim.traffic.spawning import populate

__all__ = ["populate"]

__getattr__, __dir__ = lazily(__name__, {"spawning": ("populate",)})
