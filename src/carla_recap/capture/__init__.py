"""Observes any CARLA server as one more of its clients, and records or shows its world.

It needs CARLA's own client library; importing this package without it raises `MissingExtra`.
"""

from __future__ import annotations

from carla_recap.errors import MissingExtra

try:
    import carla  # noqa: F401
except ImportError:
    raise MissingExtra("a capture", "carla") from None

from carla_recap.capture.recording import Captured, capture

__all__ = ["Captured", "capture"]
