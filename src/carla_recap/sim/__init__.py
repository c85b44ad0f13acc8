"""A town without a simulator: roads, signals, traffic and collisions in a plane, to record from and to replay into."""

from __future__ import annotations

from carla_recap.util.lazy import lazily

# Reading a town needs no physics engine.
__getattr__, __dir__, __all__ = lazily(__name__)
