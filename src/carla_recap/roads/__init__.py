"""Road maps: OpenDRIVE files as lines to draw, and as networks of lanes."""

from __future__ import annotations

from carla_recap.util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__)
