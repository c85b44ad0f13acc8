"""Traffic: the autopilot, pedestrian navigation, and random vehicles and walkers."""

from __future__ import annotations

from carla_recap.util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__)
